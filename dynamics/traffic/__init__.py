"""Assumptions about other vehicles, their reachable places, and the rules of the road."""
