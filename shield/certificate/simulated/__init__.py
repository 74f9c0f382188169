"""Certificate for simulated traffic: verification by simulating the other vehicles exactly."""
