r"""The ego's own frame: where a vehicle is and where it points does not change how it moves.

Notation
--------
A state holds one position p, any number of vectors w (velocity, heading, …) and plain numbers; q = (c, s) is the unit
vector of the heading and R = [[c, -s], [s, c]]. The *body-frame* state z of a state x about itself is

    z = (0, R' w_1, R' w_2, …, numbers),        R' q = (1, 0),

and a body-frame state z+ is, in the world again, x+ = (p + R z_p, R z_w, numbers). A function of z alone, taken back
that way, is equivariant under every rigid motion of the plane (SE(2)).

Every function takes numpy arrays and torch tensors alike; shapes are (..., d).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.errors import ConfigError

__all__ = ["Layout"]


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a state are geometry.

    Attributes
    ----------
    position : columns of x and y [m].
    heading : columns of the heading's cosine and sine.
    vectors : column pairs of further world-frame vectors, such as the velocity.
    """

    position: tuple[int, int] = (0, 1)
    heading: tuple[int, int] = (4, 5)
    vectors: tuple[tuple[int, int], ...] = ((2, 3),)

    def __post_init__(self) -> None:
        pairs = [self.position, self.heading, *self.vectors]
        columns = [column for pair in pairs for column in pair]
        if any(len(pair) != 2 for pair in pairs) or len(set(columns)) != len(columns) or min(columns) < 0:
            raise ConfigError(f"a layout has pairs of columns, each column once and none negative; got {pairs}")

    def check(self, state_dim: int) -> None:
        """Refuse a layout that needs more columns than a state has.

        Raises
        ------
        ConfigError
            If it does.
        """
        highest = max(max(pair) for pair in (self.position, self.heading, *self.vectors))
        if highest >= state_dim:
            raise ConfigError(f"the layout names column {highest}; states have columns 0 to {state_dim - 1}")

    @classmethod
    def of(cls, position: Sequence[int], heading: Sequence[int], vectors: Sequence[Sequence[int]]) -> Layout:
        """From lists, as a JSON file has them."""
        pairs = [(int(a), int(b)) for a, b in vectors]
        return cls((int(position[0]), int(position[1])), (int(heading[0]), int(heading[1])), tuple(pairs))

    def unit_heading(self, x: Any) -> Any:
        """The state with its heading scaled to length 1 (a heading of length 0 has no direction: NaN)."""
        c, s = self.heading
        return _replace(x, {c: _cos(x, c, s), s: _cos(x, s, c)})

    def to_body(self, x: Any) -> Any:
        """z of a state about itself."""
        c, s = (_cos(x, *pair) for pair in (self.heading, self.heading[::-1]))
        zero = 0 * c
        out = {self.position[0]: zero, self.position[1]: zero, self.heading[0]: zero + 1, self.heading[1]: zero}
        for a, b in self.vectors:
            out[a], out[b] = c * x[..., a] + s * x[..., b], c * x[..., b] - s * x[..., a]
        return _replace(x, out)

    def about(self, x: Any, other: Any) -> Any:
        """`other` in the body frame of x: position relative, vectors and heading turned."""
        c, s = (_cos(x, *pair) for pair in (self.heading, self.heading[::-1]))
        out = {}
        for a, b in (self.position, self.heading, *self.vectors):
            w, v = other[..., a], other[..., b]
            if (a, b) == self.position:
                w, v = w - x[..., a], v - x[..., b]
            out[a], out[b] = c * w + s * v, c * v - s * w
        return _replace(other, out)

    def to_world(self, x: Any, z: Any) -> Any:
        """A body-frame state z in the world, the frame being that of the state x; the inverse of `about`."""
        c, s = (_cos(x, *pair) for pair in (self.heading, self.heading[::-1]))
        out = {}
        for a, b in (self.position, self.heading, *self.vectors):
            w, v = c * z[..., a] - s * z[..., b], s * z[..., a] + c * z[..., b]
            if (a, b) == self.position:
                w, v = w + x[..., a], v + x[..., b]
            out[a], out[b] = w, v
        return _replace(z, out)

    def rotation(self, x: Any) -> Any:
        """The linear part of `to_world` as a matrix (d, d), for one state x (d,); numpy."""
        c, s = (float(_cos(x, *pair)) for pair in (self.heading, self.heading[::-1]))
        out = np.eye(len(x))
        for a, b in (self.position, self.heading, *self.vectors):
            out[np.ix_((a, b), (a, b))] = ((c, -s), (s, c))
        return out


def _cos(x: Any, a: int, b: int) -> Any:
    return x[..., a] / (x[..., a] ** 2 + x[..., b] ** 2) ** 0.5


def _replace(x: Any, columns: dict[int, Any]) -> Any:
    """A new array with some columns replaced; no writing in place, for the sake of gradients."""
    parts = [columns.get(i, x[..., i]) for i in range(x.shape[-1])]
    if isinstance(x, np.ndarray):
        return np.stack(parts, axis=-1)
    import torch

    return torch.stack(parts, dim=-1)
