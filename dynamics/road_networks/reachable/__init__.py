"""Reachable lanes of other vehicles on a road network, and right of way between two vehicles."""
