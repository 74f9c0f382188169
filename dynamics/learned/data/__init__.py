"""Training data: transitions, and their collection and storage."""
