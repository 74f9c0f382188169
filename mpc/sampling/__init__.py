"""Planners that sample: the Cross-Entropy Method and its relatives."""
