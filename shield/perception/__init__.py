"""Scenes made from what a policy observes, instead of the simulator's state."""
