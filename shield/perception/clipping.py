"""Check that observations stay within their clipped ranges while the ego drives."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

from shield.errors import ConfigError
from shield.perception.grid_spec import GridSpec, Spec
from shield.perception.unseen import Unseen

__all__ = ["check_ranges"]

_ACROSS = 0.3
"""Greatest lateral speed, as a share of the speed: 11.6 m/s at 40 m/s, with alternating lane changes at 5 Hz."""
_LANE = 2.0
"""Half the width of a lane [m]."""
_SAME = 1e-6
"""Distance from the edge of a range within which a number may stand for any value beyond it, as a share of the
range."""


def check_ranges(spec: Spec, speeds: Sequence[float], centers: Sequence[float]) -> None:
    """Check that clipping hides neither the ego's speed and position nor the others' speeds.

    Parameters
    ----------
    spec : meaning of the observations.
    speeds : possible speeds of the ego: its target speeds and its present one [m/s].
    centers : y of the lane centres [m].

    Raises
    ------
    ConfigError
        If a range is too narrow; the message lists these and the required ranges.
    """
    if not spec.clip:
        return
    narrow = [
        f"{name} {list(spec.ranges[name])} has to reach beyond [{low:g}, {high:g}]"  # type: ignore[index]
        for name, (low, high) in _needed(spec, max(speeds), centers).items()
        if name in spec.features and not _holds(spec, name, low, high)
    ]
    if narrow:
        raise ConfigError(
            "clipping hides values that a scene requires: widen config['observation']['features_range'], or set "
            f"'clip' to False: {'; '.join(narrow)}"
        )


def _needed(spec: Spec, fastest: float, centers: Sequence[float]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of each feature while the ego drives at most `fastest` [m/s]."""
    across, slower = _ACROSS * fastest, max(fastest - Unseen().slowest, 0.0)
    if isinstance(spec, GridSpec):
        return {"vx": (-slower, slower), "vy": (-across, across)}
    first, last = min(centers) - _LANE, max(centers) + _LANE
    apart = 0.0 if spec.absolute else max(centers) - min(centers)
    return {
        "vx": (0.0 if spec.absolute else -slower, fastest),
        "vy": (-across, across),
        "y": (min(first, -apart), max(last, apart)),
        "heading": (-pi / 2, pi / 2),
    }


def _holds(spec: Spec, name: str, low: float, high: float) -> bool:
    """Whether the range of a feature contains the interval from `low` to `high`."""
    ends = spec.ranges.get(name)  # type: ignore[union-attr]
    if ends is None:
        return True
    slack = _SAME * (ends[1] - ends[0])
    return ends[0] + slack < low and high < ends[1] - slack
