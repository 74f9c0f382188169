"""Sampling planners: the Cross-Entropy Method and its variants."""
