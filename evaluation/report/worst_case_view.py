"""Pictures of the worst case on road networks: reachable areas, conflict zones with the ego, and yielding vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from dynamics.road_networks.geometry.layout import ROAD
from dynamics.road_networks.geometry.road_geometry import RoadGeometry
from dynamics.state import FloatArray
from evaluation.measuring.rectangles import polygons
from evaluation.names import FIRST_EVALUATION_SEED
from evaluation.report.plots import picture_path, save_plot
from evaluation.report.proposal import ego_copy
from evaluation.report.reachable_areas import interval_outline
from evaluation.settings import setting_of
from shield import ShieldConfig, ShieldedEnv
from shield.certificate.network.workspace import NetworkPrediction
from shield.decision import Decision
from shield.errors import ConfigError
from shield.filters.network import NetworkFilter

__all__ = ["VIEWED", "draw_worst_cases"]

VIEWED = (
    *("merge-v1", "merge-generic-v0", "roundabout-v1", "roundabout-generic-v0"),
    *("exit-v1", "two-way-v0", "u-turn-v1", "intersection-v0"),
)
_HAVE = f"have {', '.join(VIEWED)}, and others like these"
_EPISODES = 3
"""Number of episodes that are searched for a decision."""
_ACTION = "FASTER"
_WINDOW, _AROUND = (50.0, 29.0), 12.0
"""Least half extents of the picture along x and y, and margin around the path [m]."""
_TIMES = 1.0, 2.0
"""Times ahead at which reachable areas are drawn [s]."""
_FREE_PATH_TIME = 4.0
"""Duration of the ego's path without other vehicles [s]."""
_FREE_PATH_COLOR = "#e0b000"
_LANES, _MAY, _WAITS, _MEETS, _PATH = "#9aa09a", "#8a4fd3", "#2ca02c", "#d62728", "#ff7f0e"


class _View(NamedTuple):
    """A decision, its reachable lane intervals, and the lanes of the road.

    Attributes
    ----------
    env_id : the environment.
    decision : the decision.
    foreseen : reachable lane intervals of the decision.
    geometry : lanes of the road.
    ego : row of the ego, (7,).
    proposed_path : path of the ego without other vehicles, (n, 2) [m].
    dt : duration of a frame [s].
    meetings : conflict zones of that path with vehicles from other roads, with the index of the interval.
    """

    env_id: str
    decision: Decision
    foreseen: NetworkPrediction
    geometry: RoadGeometry
    ego: FloatArray
    proposed_path: FloatArray
    dt: float
    meetings: list[tuple[int, Any]]

    @property
    def vehicles(self) -> set[int]:
        """Indices of the vehicles in a conflict zone."""
        return {int(self.foreseen.vehicles[j]) for j, _ in self.meetings}

    @property
    def waits(self) -> bool:
        """Whether a vehicle in a conflict zone is assumed to wait."""
        return any(self.foreseen.waits[j] for j, _ in self.meetings)


def draw_worst_cases(
    path: str | Path,
    env_ids: Sequence[str] = VIEWED,
    config: ShieldConfig | None = None,
    seed: int = 0,
) -> Path:
    """Draw one decision on each of some road networks, with the policy always FASTER.

    It is a decision in which another vehicle is assumed to wait, and the ego meets the most others. The picture shows:

    - reachable areas of other vehicles after 1 and 2 s, on every route within the assumptions, with their bodies;
    - the verified path, to its standstill;
    - the ego's path without other vehicles;
    - conflict zones of this path with vehicles from other roads: red if the ego has to keep clear of them, green if
      they are assumed to wait.

    Parameters
    ----------
    path : path of the .png file.
    env_ids : environments of highway-env on road networks, with meta-actions.
    config : the shield's settings; by default `ShieldConfig.for_roads(gives_way=True)`.
    seed : seed of the first episode.

    Returns
    -------
    The path.

    Raises
    ------
    ConfigError
        If the file is no .png, there is no environment, or the seeds belong to the evaluation.
    SceneError
        If a road cannot be read.
    """
    import matplotlib.pyplot as plt

    path = picture_path(path)
    if not env_ids:
        raise ConfigError("have at least one road")
    if not 0 <= seed <= FIRST_EVALUATION_SEED - _EPISODES:
        raise ConfigError(f"have a seed from 0 to {FIRST_EVALUATION_SEED - _EPISODES}, not {seed}")
    config = ShieldConfig.for_roads(gives_way=True) if config is None else config
    views = [_find(env_id, config, seed) for env_id in env_ids]
    columns = min(2, len(views))
    rows = -(-len(views) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(7.6 * columns, 4.9 * rows), layout="constrained", squeeze=False)
    for axis in axes.flat[len(views) :]:
        axis.axis("off")
    for axis, view in zip(axes.flat, views, strict=False):
        _draw(axis, view)
    figure.suptitle(
        "purple: where others may be in 1 and 2 s; orange: verified, to a standstill; dashed: where the ego would go\n"
        "red: it keeps clear of others there; green: others are counted on to wait",
        fontsize=9,
    )
    return save_plot(figure, path, dpi=80)


def _find(env_id: str, config: ShieldConfig, seed: int) -> _View:
    """The decision of a few shielded episodes in which a vehicle waits for the ego and the ego meets the most others.

    Without a waiting vehicle only the number of others counts.
    """
    env: Any = ShieldedEnv(setting_of(env_id).make(), config)
    base: Any = env.unwrapped
    if not isinstance(env.filter, NetworkFilter):
        raise ConfigError(f"the worst case is drawn on networks of roads with meta-actions, not of {env_id}; {_HAVE}")
    best: tuple[tuple[bool, int, bool], _View] | None = None
    for each in range(seed, seed + _EPISODES):
        env.reset(seed=each)
        done = False
        while not done:
            actions = base.action_type.actions_indexes
            network_filter = NetworkFilter(base, config)
            decision = network_filter.decide(actions[_ACTION])
            # An unverified decision has no reachable lane intervals.
            if decision.tier.verified:
                view = _view(env_id, base, decision, network_filter.foreseen)
                score = view.waits, len(view.vehicles), decision.overridden
                if best is None or score > best[0]:
                    best = score, view
            *_, terminated, truncated, _ = env.step(actions[_ACTION])
            done = terminated or truncated
    env.close()
    if best is None:
        raise ConfigError(f"no decision of {_EPISODES} episodes of {env_id} is verified; have another seed")
    return best[1]


def _view(env_id: str, base: Any, decision: Decision, foreseen: NetworkPrediction) -> _View:
    v, dt = base.vehicle, 1 / base.config["simulation_frequency"]
    ego = np.array([*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH, 0.0])
    alone = ego_copy(base)
    proposed_path = [alone.position.copy()]
    for _ in range(round(_FREE_PATH_TIME / dt)):
        alone.act()
        alone.step(dt)
        proposed_path.append(alone.position.copy())
    view = _View(env_id, decision, foreseen, RoadGeometry.of(base), ego, np.array(proposed_path), dt, [])
    return view._replace(meetings=_meetings(view))


def _meetings(view: _View) -> list[tuple[int, Any]]:
    """Conflict zones of vehicles from other roads with the ego's path, as polygons with the index of the interval."""
    foreseen, geometry = view.foreseen, view.geometry
    if np.hypot(*np.ptp(view.proposed_path, axis=0)) < 1.0:
        return []
    corridor, found = shapely.LineString(view.proposed_path).buffer(0.5 * view.ego[5] + 0.3, cap_style="flat"), []
    bodies = np.vstack([view.ego[None, :3], foreseen.rows[:, :3]])
    road, *roads = geometry.network.ids[geometry.closest(*bodies.T).lane, ROAD].tolist()
    for j in range(len(foreseen.lanes)):
        if roads[foreseen.vehicles[j]] == road:
            continue  # on the ego's own road
        area = _area(view, j, 0, foreseen.most.shape[1] - 1)
        if area is not None and (zone := area.intersection(corridor)).area > 1.0:
            found.append((j, zone))
    return found


def _area(view: _View, j: int, first: int, last: int) -> Any:
    """Polygon of the reachable interval `j` from frame `first` to `last`; None if it has no place on its lane."""
    outline = interval_outline(view.geometry, view.foreseen, j, first, last)
    if outline is None:
        return None
    area = shapely.Polygon(outline)
    return area if area.is_valid else area.buffer(0)


def _draw(axis: Any, view: _View) -> None:
    foreseen, ego, met = view.foreseen, view.ego, view.vehicles
    for lane in range(len(view.geometry.names)):
        for edge in np.split(view.geometry.outline(lane), 2):
            axis.plot(*edge.T, color=_LANES, linewidth=0.8, zorder=1)
    for time in _TIMES:
        k = min(round(time / view.dt), foreseen.most.shape[1] - 1)
        for j in range(len(foreseen.lanes)):
            _fill(axis, _area(view, j, k, k), _MAY, 0.16)
    for j, zone in view.meetings:
        _fill(axis, zone, _WAITS if foreseen.waits[j] else _MEETS, 0.5, zorder=3)
    for i, row in enumerate(foreseen.rows):
        _body(axis, row, "#4878d0" if i in met else "#8fb3e8")
    _body(axis, ego, "#32c800")
    axis.plot(view.proposed_path[:, 0], view.proposed_path[:, 1], "--", color=_FREE_PATH_COLOR, linewidth=1.5, zorder=5)
    axis.plot(foreseen.path[:, 0], foreseen.path[:, 1], color=_PATH, linewidth=2, zorder=5)
    axis.plot(*foreseen.path[-1, :2], "s", color=_PATH, markersize=5, zorder=5)
    shown = np.vstack([ego[None, :2], foreseen.path[:, :2], view.proposed_path])
    low, high = shown.min(axis=0), shown.max(axis=0)
    (x, y), wide = 0.5 * (low + high), max(1.0, *(0.5 * (high - low) + _AROUND) / _WINDOW)
    axis.set_xlim(x - wide * _WINDOW[0], x + wide * _WINDOW[0])
    axis.set_ylim(y + wide * _WINDOW[1], y - wide * _WINDOW[1])
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    waiting = len({int(foreseen.vehicles[j]) for j in np.flatnonzero(foreseen.waits)})
    done = "held back" if view.decision.overridden else "as proposed"
    meets = f"meets {len(met)} from other roads"
    axis.set_title(
        f"{view.env_id}: {_ACTION} at {ego[3]:.0f} m/s {done}; {meets}, of whom {waiting} counted on to wait",
        fontsize=9,
    )


def _fill(axis: Any, area: Any, color: str, alpha: float, zorder: int = 2) -> None:
    for part in getattr(area, "geoms", [] if area is None else [area]):
        if part.geom_type == "Polygon" and not part.is_empty:
            axis.fill(*part.exterior.xy, color=color, alpha=alpha, linewidth=0, zorder=zorder)


def _body(axis: Any, row: FloatArray, color: str) -> None:
    axis.fill(*polygons(row[None])[0].exterior.xy, facecolor=color, edgecolor="black", linewidth=0.6, zorder=4)
