"""The predictive safety filter: problem, program, solvers, result."""
