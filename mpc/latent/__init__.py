"""Drivers that plan in the latent space of a world model."""
