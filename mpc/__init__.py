"""How to choose inputs over a horizon: the predictive safety filter and the planner."""
