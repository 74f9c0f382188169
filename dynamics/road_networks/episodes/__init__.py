"""Whole episodes on highway-env's road networks, many at once: resets, observations, rewards and ends, compiled."""
