"""Three certificates: for one road, for a network of roads, and for simulated traffic."""
