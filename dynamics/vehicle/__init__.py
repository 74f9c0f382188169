"""How one vehicle moves: the bicycle, its low-level controllers, its actuators, and rollouts of them."""
