"""Learned models and data collection for parking, driving, the highway and the roundabout."""
