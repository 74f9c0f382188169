"""Training: fits, rounds of on-policy data, macro-steps, and the drift of predictions."""
