"""What a planner has to know of what it plans for: costs, goals, constraints."""
