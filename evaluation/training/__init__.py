"""Training of policies: options, environments, checkpoints, evaluation while it learns."""
