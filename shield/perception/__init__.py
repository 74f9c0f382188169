"""Scenes from a policy's observations, instead of the simulator's state."""
