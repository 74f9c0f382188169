"""Tasks of planners: costs, goals, constraints."""
