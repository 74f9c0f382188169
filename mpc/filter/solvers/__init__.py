"""Solvers of the filter's program: backends, warm starts, and the steps from one guess to the next."""
