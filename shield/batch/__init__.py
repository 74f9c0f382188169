"""The shield of many environments at once, compiled: memory, scene and procedure are arrays."""
