"""The five figures about the shield's decision, drawn from `evaluation.report.decision_scenes`.

Top views are in the road frame, with the first lane on top. Green: the ego, and what verifies. Violet: reachable
intervals of the others. Red: what does not verify. Orange: the alternative.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from PIL import Image

from dynamics.roads.straight import Road
from dynamics.state import FloatArray, RoadState
from evaluation.report import decision_scenes as scenes
from evaluation.report.decision_scenes import CONFIG, LENGTH, WIDTH, Obligation
from evaluation.report.draw import AREA, GREEN, ORANGE, RED

__all__ = ["FIGURES", "write_figures"]

_DPI, _WIDTH = 110, 7.3
"""Resolution [pixels per inch] and width [inches]: about 800 pixels."""
_COLORS = 96
"""Size of the palette, enough for pictures of flat colours."""


def _hex(color: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


_EGO, _OTHERS, _ANSWER, _FAILS = _hex(GREEN), _hex(AREA), _hex(ORANGE), _hex(RED)
_DISTANCE_COLOR, _INK, _PALE, _ROAD = "#2b7bba", "#1e2228", "#6e747d", "#eeeeec"


_OBLIGATIONS = {
    Obligation.DISTANCE: _DISTANCE_COLOR,
    Obligation.NOT_YET: "#a0522d",
    Obligation.ENTERS: _ANSWER,
    Obligation.NOTHING: _OTHERS,
}


def write_figures(folder: Path) -> list[Path]:
    """Draw all figures as `folder`/NAME.png, and return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, draw in FIGURES.items():
        buffer = BytesIO()
        draw().savefig(buffer, format="png", dpi=_DPI)
        paths.append(folder / f"{name}.png")
        Image.open(buffer).convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE).save(paths[-1], optimize=True)
    return paths


# -- pieces ----------------------------------------------------------------------------------------------


def _figure(height: float, rows: list[float], columns: list[float] | None = None) -> tuple[Figure, Any]:
    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    ratios = {"height_ratios": rows, "width_ratios": columns or [1.0]}
    axes = figure.subplots(len(rows), len(columns or [1.0]), squeeze=False, gridspec_kw=ratios)
    for each in axes.flat:
        each.tick_params(labelsize=8)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _top_view(axes: Any, road: Road, low: float, high: float) -> None:
    """Draw an empty road from s = low to high [m]."""
    side = 0.5 * road.width
    axes.add_patch(Rectangle((low, -side), high - low, road.width * road.centers.size, color=_ROAD, lw=0, zorder=0))
    for i, center in enumerate([*road.centers, road.centers[-1] + road.width]):
        edge = i in (0, road.centers.size)
        axes.plot([low, high], [center - side] * 2, color=_PALE, lw=1.2, ls="-" if edge else (0, (6, 6)), zorder=0.5)
    axes.set(xlim=(low, high), ylim=(road.centers[-1] + side + 0.3, -side - 0.3), aspect="equal")
    axes.set_yticks(road.centers, [f"lane {i}" for i in range(road.centers.size)])
    axes.tick_params(axis="y", length=0)
    axes.spines[["left"]].set_visible(False)


def _outline(state: FloatArray, along: float, across: float) -> FloatArray:
    """Corners (4, 2) of a rectangle of half extents `along`, `across` at a road state (4,)."""
    s, r, heading, _ = state
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    corners: FloatArray = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (along, across) @ turn + (s, r)
    return corners


def _body(axes: Any, state: FloatArray, color: str, text: str = "") -> None:
    axes.add_patch(Polygon(_outline(state, 0.5 * LENGTH, 0.5 * WIDTH), fc=color, ec=_INK, lw=0.7, zorder=3))
    if text:
        axes.text(state[0], state[1], text, ha="center", va="center", color="white", fontsize=7.5, zorder=4)


def _buffered(axes: Any, state: FloatArray, **style: Any) -> None:
    b = CONFIG.buffer
    axes.add_patch(Polygon(_outline(state, 0.5 * LENGTH + b.longitudinal, 0.5 * WIDTH + b.lateral), **style))


def _between(axes: Any, start: tuple[float, float], end: tuple[float, float], color: str = _INK) -> None:
    """Draw a dimension line."""
    arrow = {"arrowstyle": "<->", "color": color, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=arrow, zorder=5)


def _pointed(axes: Any, text: str, to: tuple[float, float], at: tuple[float, float]) -> None:
    """Draw a text, and a thin line from it to a point."""
    line = {"arrowstyle": "-", "lw": 0.7, "color": _INK, "shrinkB": 0}
    axes.annotate(text, to, at, ha="center", va="center", fontsize=9, arrowprops=line, zorder=5)


# -- figures ---------------------------------------------------------------------------------------------


def _tube() -> Figure:
    found = scenes.tube()
    figure, ((top,), (below,)) = _figure(4.3, [1.0, 1.5])
    scene, nearest = found.scene, int(found.gaps.argmin())
    rear, front = found.occupancy.rear[0], found.occupancy.front[0]
    low, high = float(found.occupancy.low[0]), float(found.occupancy.high[0])
    _top_view(top, scene.road, -9.0, 75.0)
    for k in range(0, len(found.path), 3):
        _buffered(top, found.path[k], fc=_EGO, ec=_EGO, alpha=0.13, lw=0, zorder=1)
        _buffered(top, found.path[k], fill=False, ec=_EGO, lw=0.5, alpha=0.8, zorder=1)
    place = (rear[nearest], low), 75.0 - rear[nearest], high - low
    top.add_patch(Rectangle(*place, fc=_OTHERS, ec=_OTHERS, alpha=0.3, lw=1, zorder=2))
    _buffered(top, found.path[nearest], fill=False, ec=_EGO, lw=2.0, zorder=4)
    _body(top, scene.ego_road, _EGO, "ego")
    _body(top, scene.others_road[0], _OTHERS, "leader")
    time = scene.dt * (nearest + 1)
    text = f"where the leader can be at {time:.1f} s"
    top.text(74.0, float(scene.road.centers[1]), text, ha="right", va="center", fontsize=8, color=_INK, zorder=5)
    r = float(found.path[nearest, RoadState.R])
    _between(top, (float(found.front[nearest]), r), (float(rear[nearest]), r))
    middle = 0.5 * float(found.front[nearest] + rear[nearest])
    text = f"margin {found.margin:.1f} m"
    _pointed(top, text, (middle, r), (middle, 8.6))
    top.text(9.0, 8.6, "the ego with its buffer, every third frame", fontsize=8, ha="center", va="center")
    top.set_xlabel("along the road [m]", fontsize=8)
    times = scene.dt * np.arange(1, len(found.path) + 1)
    below.fill_between(times, rear, front, color=_OTHERS, alpha=0.25, lw=0, label="where the leader can be")
    below.plot(times, rear, color=_OTHERS, lw=1.5)
    below.plot(times, found.front, color=_EGO, lw=2, label="the ego's front with its buffer")
    below.axvline(scene.dt, color=_PALE, lw=0.8, ls=":")
    text = "one frame of the proposal,\nthen braking to a stop"
    below.text(scene.dt + 0.04, 64.0, text, fontsize=8, va="center")
    _between(below, (time, float(found.front[nearest])), (time, float(rear[nearest])))
    _pointed(below, f"margin {found.margin:.1f} m", (time, middle), (time - 0.12, 22.0))
    below.set(xlim=(0, times[-1]), ylim=(0, 75))
    below.set_xlabel("time [s]", fontsize=8)
    below.set_ylabel("along the road [m]", fontsize=8)
    below.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def _occupancy() -> Figure:
    found, a = scenes.bounds(), CONFIG.assumptions
    figure, ((left, right),) = _figure(3.6, [1.0], [1.0, 1.0])
    for rear, front in (found.moving, found.queueing):
        color = _OTHERS if rear is found.moving[0] else _DISTANCE_COLOR
        left.fill_between(found.time, rear, front, color=color, alpha=0.22, lw=0)
        left.plot(found.time, rear, color=color, lw=1.5)
        left.plot(found.time, front, color=color, lw=1.5)
    left.axhline(found.stands, color=_INK, lw=0.8, ls=":")
    for text, at, color in (
        (f"one at {found.speeds[0]:g} m/s,\nnobody ahead", (1.05, 66.0), _OTHERS),
        (f"gains {a.acceleration:g} m/s²,\nless when fast", (2.35, 47.0), _INK),
        (f"brakes at {a.comfortable_braking:g} m/s²,\nharder after 3 s", (3.35, 34.0), _INK),
        (f"one at {found.speeds[1]:g} m/s, behind\none that stands", (3.0, 13.0), _DISTANCE_COLOR),
        ("rear of the one that stands", (2.75, 4.0), _INK),
        ("may reverse from there", (2.75, -11.5), _INK),
    ):
        left.text(*at, text, color=color, fontsize=8, ha="center", va="center")
    left.set(xlim=(0, found.time[-1]), ylim=(-16, 75))
    left.set_xlabel("time [s]", fontsize=8)
    left.set_ylabel("body along the road [m]", fontsize=8)
    around = found.around
    _top_view(right, found.across.road, 0.0, 30.0)
    for state, low, high in zip(around.states, around.low, around.high, strict=True):
        right.add_patch(Rectangle((state[0] - 4.0, low), 8.0, high - low, fc=_OTHERS, ec=_OTHERS, alpha=0.3, zorder=2))
        _body(right, state, _OTHERS)
    texts = (10.6, 0.0, "in the middle of its lane"), (19.6, 4.0, "off the middle"), (8.6, 8.4, "across a marking")
    for s, r, text in texts:
        right.text(s, r, text, fontsize=8, va="center")
    right.set_xlabel("along the road [m]", fontsize=8)
    return figure


def _obligations() -> Figure:
    found = scenes.obligation_scene()
    figure, ((axes,),) = _figure(2.1, [1.0])
    low, high = -54.0, 72.0
    _top_view(axes, found.scene.road, low, high)
    width, center = found.scene.road.width, float(found.scene.road.centers[found.goal])
    axes.add_patch(Rectangle((low, center - 0.5 * width), high - low, width, fc=_EGO, alpha=0.1, lw=0, zorder=0.2))
    axes.plot(found.path[:, RoadState.S], found.path[:, RoadState.R], color=_EGO, lw=1.5, zorder=2)
    _buffered(axes, found.path[-1], fill=False, ec=_EGO, lw=1.2, zorder=2)
    _buffered(axes, found.scene.ego_road, fill=False, ec=_EGO, lw=1.2, zorder=2)
    _body(axes, found.scene.ego_road, _EGO, "ego")
    for state, obligation, separation in zip(
        found.scene.others_road, found.obligations, found.separations, strict=True
    ):
        _body(axes, state, _OBLIGATIONS[obligation])
        text = "out of reach" if np.isposinf(separation) else f"{separation:.1f} m"
        text = "does not count" if obligation is Obligation.DISTANCE else text
        side = -1 if obligation is Obligation.ENTERS else 1
        aligned = {"ha": "right" if side < 0 else "left", "va": "center"}
        axes.text(state[0] + side * 3.3, state[1], text, fontsize=8, zorder=4, **aligned)
        if obligation is Obligation.ENTERS:
            arrow = {
                "arrowstyle": "->",
                "color": _OBLIGATIONS[obligation],
                "lw": 1.6,
                "connectionstyle": "arc3,rad=0.25",
            }
            axes.annotate("", (state[0] + 11.0, center), (state[0] + 2.5, state[1]), arrowprops=arrow, zorder=2)
    axes.set_xlabel("along the road [m]", fontsize=8)
    patches = [
        Rectangle((0, 0), 1, 1, fc=color, ec=_INK, lw=0.7, label=obligation.value)
        for obligation, color in _OBLIGATIONS.items()
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return figure


def _cut_in() -> Figure:
    found = scenes.cut_in_scene()
    figure, ((top,), (below,)) = _figure(3.9, [1.0, 2.2])
    _top_view(top, found.shown.road, -16.0, 36.0)
    car, leader = found.shown.others_road
    s, to = float(car[RoadState.S]), float(found.shown.road.centers[0])
    _body(top, car, _OTHERS)
    _body(top, leader, _OTHERS, "leader")
    _buffered(top, found.shown.ego_road, fill=False, ec=_EGO, lw=1.2, zorder=2)
    _body(top, found.shown.ego_road, _EGO, "ego")
    arrow = {"arrowstyle": "->", "color": _OTHERS, "lw": 1.6, "connectionstyle": "arc3,rad=0.2"}
    top.annotate("", (s + 12.0, to), (s + 2.5, float(car[RoadState.R])), arrowprops=arrow, zorder=2)
    top.set_xlabel("along the road, from the slower vehicle [m]", fontsize=8)
    below.axhspan(-5.0, 0.0, color=_FAILS, alpha=0.08, lw=0)
    below.axhline(0.0, color=_FAILS, lw=0.8)
    below.axvline(found.ahead[found.at], color=_PALE, lw=0.8, ls=":")
    for offset, values, color in zip(found.offsets, found.separations, (_EGO, _FAILS), strict=True):
        text = f"the ego {offset:g} m off the middle of its lane" if offset else "the ego in the middle of its lane"
        below.plot(found.ahead, np.where(np.isfinite(values), values, np.nan), lw=2, color=color, label=text)
    for x in (-2.1, 8.0):
        below.text(x, 0.75, "the clause\nasks nothing", fontsize=8, ha="center", va="center")
    below.text(8.9, -0.15, "does not verify", fontsize=8, color=_FAILS, va="center", ha="right")
    below.set(xlim=(-3.0, 9.0), ylim=(-1.75, 1.6))
    below.set_xlabel("the ego's centre ahead of the slower vehicle's [m]", fontsize=8)
    below.set_ylabel("separation [m]", fontsize=8)
    below.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def _search() -> Figure:
    found = scenes.input_search()
    figure, ((axes,),) = _figure(4.2, [1.0])
    verified = (found.margins >= 0).astype(float)
    axes.contourf(found.wheels, found.accelerations, verified, [0.5, 1.5], colors=[_EGO], alpha=0.25)
    axes.contour(found.wheels, found.accelerations, verified, [0.5], colors=[_EGO], linewidths=1)
    axes.text(0.45, -6.0, "verifies", color=_EGO, ha="center", fontsize=9)
    answer = found.decision.executed
    axes.plot(*found.strewn.T[::-1], "o", ms=3.5, color=_PALE, mew=0, label="judged: strewn over what is nearer")
    axes.plot(*found.linearised.T[::-1], "+", ms=7, color=_INK, mew=1, label="judged: linearised here")
    axes.plot([found.proposal[1], answer[1]], [found.proposal[0], answer[0]], color=_ANSWER, lw=1, ls="--", zorder=1)
    axes.plot(*found.proposal[::-1], "o", ms=9, color=_FAILS, label="the proposal: does not verify")
    axes.plot(*answer[::-1], "o", ms=9, color=_ANSWER, label="the answer: the nearest that verifies")
    axes.set_xlabel("front wheel angle [rad]", fontsize=8)
    axes.set_ylabel("acceleration [m/s²]", fontsize=8)
    axes.set(xlim=(found.wheels[0], found.wheels[-1]), ylim=(found.accelerations[0], found.accelerations[-1]))
    figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "tube": _tube,
    "occupancy": _occupancy,
    "duties": _obligations,
    "cut-in": _cut_in,
    "search": _search,
}
"""Functions that draw the figures, by name."""
