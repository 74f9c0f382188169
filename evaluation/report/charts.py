"""Charts as SVG for pages; CSS classes of the page set the colours, in light and dark mode."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

__all__ = ["Mark", "crosses", "ranges"]

_WIDTH, _HEIGHT = 560, 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 12, 42
_ROW = 26
_KINDS = 10
"""Number of colour classes of marks, `kind-0` to `kind-9`; they repeat for more marks."""
_LETTER = 6.4
"""Width of a letter of a label [px]."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A point with its intervals, or a row with its quantiles.

    Attributes
    ----------
    label : text beside the mark.
    kind : index of its colour.
    x, y : (estimate, low, high); a row has no `y`.
    """

    label: str
    kind: int
    x: tuple[float, float, float]
    y: tuple[float, float, float] = (math.nan, math.nan, math.nan)


def _ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers that span a range."""
    span = max(high - low, 1e-9)
    step = 10.0 ** math.floor(math.log10(span / most))
    step *= next(factor for factor in (1, 2, 5, 10) if span / (step * factor) <= most)
    first = math.floor(low / step + 1e-9) * step
    return [round(first + i * step, 10) for i in range(math.ceil((high - first) / step - 1e-9) + 1)]


def _finite(values: Sequence[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _scale(values: Sequence[float], start: float, end: float) -> tuple[list[float], float, float]:
    """Ticks of an axis, and slope and offset from a value to its position."""
    known = _finite(values) or [0.0, 1.0]
    ticks = _ticks(min(known), max(max(known), min(known) + 1e-6))
    slope = (end - start) / (ticks[-1] - ticks[0])
    return ticks, slope, start - slope * ticks[0]


def _line(x1: float, y1: float, x2: float, y2: float, name: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{name}"/>'


def _text(x: float, y: float, text: str, anchor: str = "middle", name: str = "tick") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" class="{name}">{escape(text)}</text>'


def _picture(height: float, title: str, parts: Sequence[str]) -> str:
    body = "".join(parts)
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height:.0f}" role="img" aria-label="{escape(title)}" class="chart">'
        f"<title>{escape(title)}</title>{body}</svg>"
    )


def crosses(marks: Sequence[Mark], across: str, upward: str) -> str:
    """Chart of points with intervals in both coordinates.

    Parameters
    ----------
    marks : the points.
    across, upward : labels of the axes, with units.

    Returns
    -------
    The SVG element.
    """
    bottom = _HEIGHT - _BOTTOM
    xs, kx, x0 = _scale([v for mark in marks for v in mark.x] + [0.0], _LEFT, _WIDTH - _RIGHT)
    ys, ky, y0 = _scale([v for mark in marks for v in mark.y], bottom, _TOP)
    parts = [_line(kx * x + x0, _TOP, kx * x + x0, bottom, "grid") for x in xs]
    parts += [_line(_LEFT, ky * y + y0, _WIDTH - _RIGHT, ky * y + y0, "grid") for y in ys]
    parts += [_text(kx * x + x0, bottom + 16, f"{x:g}") for x in xs]
    parts += [_text(_LEFT - 6, ky * y + y0 + 4, f"{y:g}", "end") for y in ys]
    parts.append(_text((_LEFT + _WIDTH) / 2, _HEIGHT - 8, across, name="axis"))
    middle = (_TOP + bottom) / 2
    parts.append(f'<g transform="rotate(-90 14 {middle})">{_text(14, middle, upward, name="axis")}</g>')
    for mark in marks:
        kind = f"kind-{mark.kind % _KINDS}"
        x, y = kx * mark.x[0] + x0, ky * mark.y[0] + y0
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        for (low, high), flat in ((mark.x[1:], True), (mark.y[1:], False)):
            if math.isfinite(low) and math.isfinite(high):
                ends = (kx * low + x0, y, kx * high + x0, y) if flat else (x, ky * low + y0, x, ky * high + y0)
                parts.append(_line(*ends, f"bar {kind}"))
        tooltip = f"<title>{escape(mark.label)}: {mark.x[0]:.3g}, {mark.y[0]:.4g}</title>"
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" class="dot {kind}">{tooltip}</circle>')
    return _picture(_HEIGHT, f"{upward} against {across}", parts)


def _shortened(label: str, width: float) -> str:
    """The label, with its middle replaced by an ellipsis if it is too long for `width` [px]."""
    most = int((width - 16.0) / _LETTER)
    half = (most - 1) // 2
    return label if len(label) <= most else f"{label[:half]}…{label[-half:]}"


def ranges(marks: Sequence[Mark], across: str) -> str:
    """Chart with a row for each mark: a line from its lower to its upper end, and its middle.

    Parameters
    ----------
    marks : rows, with (middle, low, high) as `x`.
    across : label of the axis, with its unit.

    Returns
    -------
    The SVG element.
    """
    left = min(16.0 + _LETTER * max(len(mark.label) for mark in marks), 0.6 * _WIDTH)
    height = _TOP + _ROW * len(marks) + _BOTTOM
    bottom = height - _BOTTOM
    xs, k, x0 = _scale([v for mark in marks for v in mark.x] + [0.0], left, _WIDTH - _RIGHT)
    parts = [_line(k * x + x0, _TOP, k * x + x0, bottom, "grid") for x in xs]
    parts += [_text(k * x + x0, bottom + 16, f"{x:g}") for x in xs]
    parts.append(_text(_WIDTH - _RIGHT, height - 8, across, "end", "axis"))
    for i, mark in enumerate(marks):
        y, kind = _TOP + _ROW * (i + 0.5), f"kind-{mark.kind % _KINDS}"
        parts.append(_text(left - 8, y + 4, _shortened(mark.label, left), "end"))
        if np.isfinite(mark.x).all():
            parts.append(_line(k * mark.x[1] + x0, y, k * mark.x[2] + x0, y, f"bar {kind}"))
            parts.append(f'<circle cx="{k * mark.x[0] + x0:.1f}" cy="{y:.1f}" r="4.5" class="dot {kind}"/>')
    return _picture(height, across, parts)
