"""Roads as arc-length paths: lanes, bends, gaps of the map, and reading them from highway-env."""
