"""The ego's rectangle, with and without its buffer."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import inlined

__all__ = ["Footprint", "reach_across", "reach_along"]


class Footprint(NamedTuple):
    """The ego's footprint [m].

    `along`, `across`: half extents with the buffer; `length`, `width`: of the body; `growth_along`, `growth_across`:
    what a bend adds to the former in the road's frame, and `bare_along`, `bare_across` to half of the latter.
    """

    along: float
    across: float
    length: float
    width: float
    growth_along: float = 0.0
    growth_across: float = 0.0
    bare_along: float = 0.0
    bare_across: float = 0.0


@inlined
def reach_along(size: Footprint, psi: float) -> float:
    """Half of what the footprint with its buffer covers along the road at heading psi [m]."""
    return size.along * abs(math.cos(psi)) + size.across * abs(math.sin(psi)) + size.growth_along


@inlined
def reach_across(size: Footprint, psi: float) -> float:
    """The same across the road [m]."""
    return size.along * abs(math.sin(psi)) + size.across * abs(math.cos(psi)) + size.growth_across
