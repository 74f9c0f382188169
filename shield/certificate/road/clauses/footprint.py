"""The ego's rectangle, with its buffer and without it."""

from __future__ import annotations

import math
from typing import NamedTuple

from dynamics.compiled import kernel_inline

__all__ = ["Footprint", "across_of", "along_of", "reach_across", "reach_along"]


class Footprint(NamedTuple):
    """The ego's footprint [m].

    Attributes
    ----------
    along, across : half extents with the buffer.
    length, width : of the body.
    growth_along, growth_across : additional half extents with the buffer on a curve, in the road's frame.
    body_growth_along, body_growth_across : the same for the body.
    """

    along: float
    across: float
    length: float
    width: float
    growth_along: float = 0.0
    growth_across: float = 0.0
    body_growth_along: float = 0.0
    body_growth_across: float = 0.0


@kernel_inline
def along_of(size: Footprint, sin: float, cos: float) -> float:
    """Half extent of the footprint with its buffer along the road, at a heading of this sine and cosine [m]."""
    return size.along * abs(cos) + size.across * abs(sin) + size.growth_along


@kernel_inline
def across_of(size: Footprint, sin: float, cos: float) -> float:
    """Half extent of the same across the road [m]."""
    return size.along * abs(sin) + size.across * abs(cos) + size.growth_across


@kernel_inline
def reach_along(size: Footprint, psi: float) -> float:
    """`along_of` at heading psi [m]."""
    return along_of(size, math.sin(psi), math.cos(psi))


@kernel_inline
def reach_across(size: Footprint, psi: float) -> float:
    """`across_of` at heading psi [m]."""
    return across_of(size, math.sin(psi), math.cos(psi))
