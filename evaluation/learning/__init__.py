"""Training the reference policies."""
