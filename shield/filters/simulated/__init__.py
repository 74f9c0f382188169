"""Filters in simulated traffic: the effect of every action follows from the state."""
