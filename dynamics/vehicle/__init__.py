"""Motion of one vehicle: the bicycle model, its low-level controllers, its actuators, and rollouts of them."""
