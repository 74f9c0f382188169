"""Three certificates: one road, a network of roads, and simulated traffic."""
