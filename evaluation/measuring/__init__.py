"""Measurement of episodes: metrics, intervals, attribution."""
