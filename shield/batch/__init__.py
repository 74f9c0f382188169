"""Shield of many environments at once, compiled: memory, scene and decision pipeline are arrays."""
