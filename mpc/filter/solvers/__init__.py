"""How the filter solves it: the solvers, what they start from, and the steps from one guess to the next."""
