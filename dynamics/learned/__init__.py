"""Learned dynamics, x + dt (A(x, u) x + B(x, u) u): models, data, training and files."""
