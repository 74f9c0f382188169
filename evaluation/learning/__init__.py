"""Learning: algorithms, recipes of the reference policies, fast environments, and saved models."""
