"""Doors for traffic that is simulated: what every action leads to follows from the state."""
