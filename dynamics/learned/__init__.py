"""Dynamics that are learned from data: x + dt (A(x, u) x + B(x, u) u), its data, its training and its files."""
