"""Falsification and rare events: search for the worst episode, and estimation of small crash probabilities."""
