"""Frames of a live highway-env on a road network, compiled."""
