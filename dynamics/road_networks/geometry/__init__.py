"""Lanes of a road network: positions, footprints, conflict zones and routes."""
