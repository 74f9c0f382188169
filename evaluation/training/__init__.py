"""Training of policies: options, environments, checkpoints, and evaluation during training."""
