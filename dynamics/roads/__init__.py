"""Roads as arc-length paths: lanes, bends, gaps of the map, and a reader of highway-env's networks."""
