"""Candidate trajectories against occupancy: a margin in metres, not a boolean.

Notation
--------
Road frame. The ego's footprint is inflated by the buffer along and across its heading psi; its half extents
along and across the road are

    h_s = (L/2 + b_lon) |cos psi| + (W/2 + b_lat) |sin psi|
    h_r = (L/2 + b_lon) |sin psi| + (W/2 + b_lat) |cos psi|

The separation from a rectangle is the greater of the longitudinal and the lateral gap, negative when both
overlap. The margin of a trajectory is the least separation over all frames and vehicles.

Who owes what (Responsibility-Sensitive Safety): a vehicle behind whose way the ego is already in must keep its
distance; one behind in a lane that the ego *enters* is the ego's business until it can have reacted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.prediction import Occupancy, predict_occupancy
from dynamics.scene import Scene
from dynamics.state import FloatArray, RoadState, Vehicle
from shield.config import ShieldConfig

__all__ = ["Clearance", "clearance", "relevant"]


@dataclass(frozen=True, slots=True)
class Clearance:
    """Result for n trajectories.

    Attributes
    ----------
    margin : least separation beyond the buffer, (n,) [m]; +inf with nobody in reach.
    vehicle : row of the scene's others that is nearest in that sense, (n,); -1 with nobody in reach.
    """

    margin: FloatArray
    vehicle: Any


def relevant(scene: Scene, config: ShieldConfig, distance: float, duration: float) -> Any:
    """Rows of the others that can come into reach of an ego that travels at most `distance` [m] in `duration` [s].

    Dropping the rest cannot change any verdict: nobody ahead moves backwards further than that, and nobody
    behind accelerates harder than assumed.
    """
    ego, others = scene.ego_road, scene.others_road
    ds = others[:, RoadState.S] - ego[RoadState.S]
    v = others[:, RoadState.SPEED]
    bodies = scene.ego[Vehicle.LENGTH] + scene.others[:, Vehicle.LENGTH] + 4.0
    size = bodies + config.buffer.longitudinal
    ahead = ds - size + np.minimum(v, 0.0) * duration
    a = config.assumptions.acceleration
    behind = -ds - size - np.maximum(v, 0.0) * duration - 0.5 * a * duration * (duration + scene.dt)
    near = (ahead <= distance) & (behind <= 0.0) & (np.abs(ds) <= config.perception_range)
    return np.flatnonzero(near)


def clearance(
    scene: Scene,
    config: ShieldConfig,
    paths: FloatArray,
    lanes: Any,
    rows: Any,
    hold: int = 0,
    visible: Any = None,
    record: list[Occupancy] | None = None,
) -> Clearance:
    """Margin of each path against the worst case of the others.

    Parameters
    ----------
    paths : road states of the ego after frames 1..K, (n, K, 4).
    lanes : lane index that each path heads for first, (n,).
    rows : which of the scene's others to look at (from `relevant`).
    hold : frames for which the others are *expected* to keep their speed (a forecast, not a bound).
    visible : frames for which the ego has been visible in each lane already, (lanes,); none by default.
    record : if given, the occupancy is appended to it.
    """
    n, frames, _ = paths.shape
    if rows.size == 0:
        return Clearance(np.full(n, np.inf), np.full(n, -1))
    assumptions, road = config.assumptions, scene.road
    others, states = scene.others[rows], scene.others_road[rows]
    occ = predict_occupancy(others, states, road, assumptions, frames, scene.dt, hold)
    if record is not None:
        record.append(occ)
    s, r, psi = (paths[..., i] for i in (RoadState.S, RoadState.R, RoadState.HEADING))
    cos, sin = np.abs(np.cos(psi)), np.abs(np.sin(psi))
    lon = 0.5 * scene.ego[Vehicle.LENGTH] + config.buffer.longitudinal
    lat = 0.5 * scene.ego[Vehicle.WIDTH] + config.buffer.lateral
    half_s, half_r = lon * cos + lat * sin, lon * sin + lat * cos

    # Lateral extent per path: a vehicle two lanes over may enter the lane that the ego is about to enter.
    low, high = occ.low[None, :], occ.high[None, :]
    home = np.repeat(occ.lane[None, :], n, axis=0)
    ego_s, ego_r = scene.ego_road[RoadState.S], scene.ego_road[RoadState.R]
    if assumptions.blind_merge and hold == 0:
        goal = road.centers[lanes]
        hidden = np.abs(ego_r - goal) > assumptions.visible_distance
        if hidden.any():
            side = np.sign(goal - ego_r)
            far = (side[:, None] * (road.centers[occ.lane][None, :] - goal[:, None])) > 0
            far &= side[:, None] * (road.centers[occ.lane] - goal[:, None]) < 1.5 * road.width
            far &= hidden[:, None]
            home = np.where(far, np.asarray(lanes)[:, None], home)
            half = 0.5 * others[:, Vehicle.WIDTH]
            low = np.where(far, np.minimum(low, goal[:, None] - half), low)
            high = np.where(far, np.maximum(high, goal[:, None] + half), high)

    # Behind the ego and in its way already: it owes the ego its braking.
    behind = states[:, RoadState.S] < ego_s - 0.5 * scene.ego[Vehicle.LENGTH]
    body = 0.5 * (
        scene.ego[Vehicle.WIDTH] * abs(np.cos(scene.ego_road[RoadState.HEADING]))
        + scene.ego[Vehicle.LENGTH] * abs(np.sin(scene.ego_road[RoadState.HEADING]))
    )
    owes = behind & (occ.low < ego_r + body) & (occ.high > ego_r - body)

    gap_r = np.maximum(low[:, :, None] - (r + half_r)[:, None, :], (r - half_r)[:, None, :] - high[:, :, None])
    gap_s = occ.rear[None] - (s + half_s)[:, None, :]
    mine = np.flatnonzero(behind & ~owes)
    if mine.size:
        front = _follower_front(scene, config, occ, mine, home[:, mine], paths, hold, visible)
        gap_s[:, mine] = np.maximum(gap_s[:, mine], (s - half_s)[:, None, :] - front)
    separation = np.maximum(gap_r, gap_s)
    separation[:, owes] = np.inf
    least = separation.min(axis=2)
    worst = least.argmin(axis=1)
    return Clearance(least[np.arange(n), worst], rows[worst])


def _follower_front(
    scene: Scene,
    config: ShieldConfig,
    occ: Occupancy,
    mine: Any,
    home: Any,
    paths: FloatArray,
    hold: int,
    visible: Any,
) -> FloatArray:
    """Greatest front (n, len(mine), K) of vehicles behind: they accelerate until they owe braking."""
    assumptions, dt = config.assumptions, scene.dt
    frames = paths.shape[1]
    r = paths[..., RoadState.R]
    center = scene.road.centers[home]
    seen = np.abs(r[:, None, :] - center[:, :, None]) <= assumptions.visible_distance
    first = np.where(seen.any(axis=2), seen.argmax(axis=2) + 1, frames)
    reaction = int(np.ceil(assumptions.reaction_time / dt - 1e-9))
    react = first + reaction
    if visible is not None:
        already = np.asarray(visible)[home]
        react = np.where(already > 0, np.maximum(reaction + 1 - already, 0), react)
    k, turn = np.arange(frames), react[:, :, None]
    gain = assumptions.acceleration * dt * np.maximum(np.minimum(k, turn) - hold, 0)
    loss = assumptions.follower_braking * dt * np.maximum(k - turn, 0)
    v0 = occ.state[mine, RoadState.SPEED][None, :, None]
    top = np.minimum(v0 + gain, np.maximum(v0, assumptions.max_speed))
    v = np.maximum(top - loss, 0.0)
    front = (occ.state[mine, RoadState.S] + occ.reach[mine])[None, :, None] + np.cumsum(v, axis=2) * dt
    # Where the ego has come to rest at the last frame, its follower may still be doing so.
    last = v[..., -1]
    rest = last**2 / (2 * assumptions.follower_braking) + 0.5 * last * dt
    front[..., -1] += np.where(paths[:, -1, RoadState.SPEED] < 0.5, 1.0, 0.0)[:, None] * rest
    return front
