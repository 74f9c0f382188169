"""The ego's body frame: the motion of a vehicle does not depend on its position and heading.

Notation
--------
A state contains one position p, any number of vectors w (velocity, heading, …) and plain numbers; q = (c, s) is the
unit vector of the heading and R = [[c, -s], [s, c]]. The *body-frame* state z of a state x about itself is

    z = (0, R' w_1, R' w_2, …, numbers),        R' q = (1, 0),

and a body-frame state z+ is, in the world again, x+ = (p + R z_p, R z_w, numbers). A function of z alone, transformed
back that way, is equivariant under every rigid motion of the plane (SE(2)).

All functions take numpy arrays and torch tensors; shapes are (..., d).
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
    """The columns of a state that are positions, headings and vectors.

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
        """Check that a state has all columns of the layout.

        Raises
        ------
        ConfigError
            If it has not.
        """
        highest = max(max(pair) for pair in (self.position, self.heading, *self.vectors))
        if highest >= state_dim:
            raise ConfigError(f"the layout names column {highest}; states have columns 0 to {state_dim - 1}")

    @classmethod
    def of(cls, position: Sequence[int], heading: Sequence[int], vectors: Sequence[Sequence[int]]) -> Layout:
        """From lists, as in a JSON file."""
        pairs = [(int(a), int(b)) for a, b in vectors]
        return cls((int(position[0]), int(position[1])), (int(heading[0]), int(heading[1])), tuple(pairs))

    def unit_heading(self, x: Any) -> Any:
        """The state with its heading scaled to length 1 (a heading of length 0 has no direction: NaN)."""
        c, s = self._direction(x)
        parts = [c if i == self.heading[0] else s if i == self.heading[1] else x[..., i : i + 1] for i in _columns(x)]
        return _join(x, parts)

    def to_body(self, x: Any) -> Any:
        """z of a state about itself."""
        return self.about(x, x)

    def about(self, x: Any, other: Any) -> Any:
        """`other` in the body frame of x: position relative, vectors and heading turned."""
        c, s = self._direction(x)
        return self._turn(other, c, -s, before=x)

    def to_world(self, x: Any, z: Any) -> Any:
        """A body-frame state z in the world frame, for the body frame of state x; the inverse of `about`."""
        c, s = self._direction(x)
        return self._turn(z, c, s, after=x)

    def _direction(self, x: Any) -> tuple[Any, Any]:
        """Cosine and sine of the heading, (..., 1)."""
        c, s = (x[..., i : i + 1] for i in self.heading)
        length = (c * c + s * s) ** 0.5
        return c / length, s / length

    def _turn(self, x: Any, c: Any, s: Any, before: Any = None, after: Any = None) -> Any:
        """Rotate all vectors. The position is taken relative to that of `before`, or added to that of `after`."""
        pairs = (self.position, self.heading, *self.vectors)
        first, second = (x[..., [pair[i] for pair in pairs]] for i in (0, 1))
        if before is not None:
            shift = [before[..., i : i + 1] for i in self.position]
            first, second = (
                _join(x, [p[..., :1] - q, p[..., 1:]]) for p, q in zip((first, second), shift, strict=True)
            )
        first, second = c * first - s * second, s * first + c * second
        if after is not None:
            shift = [after[..., i : i + 1] for i in self.position]
            first, second = (
                _join(x, [p[..., :1] + q, p[..., 1:]]) for p, q in zip((first, second), shift, strict=True)
            )
        source = {column: (i, part) for part in (0, 1) for i, column in enumerate(pair[part] for pair in pairs)}
        count = len(pairs)
        order = [source[i][1] * count + source[i][0] if i in source else 2 * count + i for i in _columns(x)]
        return _join(x, [first, second, x])[..., order]

    def rotation(self, x: Any) -> Any:
        """The linear part of `to_world` as a matrix (d, d), for one state x (d,); numpy."""
        c, s = (float(part[0]) for part in self._direction(x))
        out = np.eye(len(x))
        for a, b in (self.position, self.heading, *self.vectors):
            out[np.ix_((a, b), (a, b))] = ((c, -s), (s, c))
        return out


def _columns(x: Any) -> range:
    return range(x.shape[-1])


def _join(x: Any, parts: list[Any]) -> Any:
    """Concatenate along the last axis, in the library of x; without in-place writes, for gradients."""
    if isinstance(x, np.ndarray):
        return np.concatenate(parts, axis=-1)
    import torch

    return torch.cat(parts, dim=-1)
