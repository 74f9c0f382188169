"""The filter's program: one problem, linearised, in the form for each solver."""
