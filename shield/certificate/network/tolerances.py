"""Least margins of a path on a road network that count as clear."""

from __future__ import annotations

__all__ = ["CLEAR", "NEW_PATH_MARGIN"]

CLEAR = -1e-6
"""Least margin of a path that counts as clear [m]; a smaller one is more than a rounding error."""
NEW_PATH_MARGIN = -1e-9
"""Least margin of a newly chosen path [m]. The difference to `CLEAR` is a budget for rounding and for the tolerances of
`shield.certificate.network.monitor`. They reduce the margin of a path frame by frame, and add up."""
