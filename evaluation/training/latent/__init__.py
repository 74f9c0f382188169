"""Training of latent drivers on frames."""
