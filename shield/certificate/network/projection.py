"""Projection of the ego's footprint to the lanes of a network, frame by frame along a path."""

from __future__ import annotations

import math

from dynamics.compiled import kernel_no_refcount
from dynamics.highway_simulator.layout import LANE_LENGTH
from dynamics.road_networks.geometry.footprints import LanePoint, Rectangle, extent_of
from dynamics.road_networks.geometry.lanes import NetworkLanes, heading_at, local, on_lane, unrolled
from dynamics.road_networks.reachable.strips import is_dead_end, steepness
from dynamics.state import FloatArray
from shield.certificate.network.workspace import CandidateRollout, EgoExtents, NetworkContext, NetworkVehicles

__all__ = ["FAR_OFF", "project_path"]

FAR_OFF = 1e6
"""Stands for the least s of a body that is not near the lane [m]."""
_WITH = 0.9
"""Cosine of the greatest angle between the ego's heading and a lane's at which the ego counts as driving in that
lane."""
_NEAR = 6.0
"""Least distance from a lane's centre line, beyond the ego's half diagonal, within which the ego is projected to it
[m]."""


@kernel_no_refcount
def _box(
    lanes: NetworkLanes, lane: int, at: LanePoint, pose: tuple[float, float, float], body: EgoExtents, box: FloatArray
) -> None:
    """Write the extents of the ego's footprint along and across a lane to `box`, (4,) [m].

    They cover the body with its buffer, and the body alone moved straight on by the coming frame's distance:
    highway-env counts a collision that constant velocities would cause within that frame. `pose` is the cosine and the
    sine of the heading, and that distance [m].
    """
    cos, sin, way = pose
    wide = extent_of(lanes, lane, at, Rectangle(0.0, cos, sin, body.along, body.across))
    body_extent = extent_of(lanes, lane, at, Rectangle(way, cos, sin, body.length, body.width))
    box[0], box[1] = min(wide.first, body_extent.first), max(wide.last, body_extent.last)
    box[2], box[3] = min(wide.low, body_extent.low), max(wide.high, body_extent.high)


@kernel_no_refcount
def project_path(
    road: NetworkContext,
    body: EgoExtents,
    others: NetworkVehicles,
    path: FloatArray,
    count: int,
    rollout: CandidateRollout,
) -> None:
    """Project the ego with its buffer to the lanes of the other vehicles, at the first `count` places of a path (K, 4).

    Parameters
    ----------
    body : extents of the ego. path : x, y [m], heading [rad], speed [m/s] at each place.
    rollout : written: `seen`, `met`, `rears`, and `boxes`. A box is the least and greatest s, then the least and
        greatest r; its first number is `FAR_OFF` where no body on that lane can come near the ego.
    """
    lanes, circles, boxes, seen, met, rears = (
        road.lanes,
        road.circles,
        rollout.boxes,
        rollout.seen,
        rollout.met,
        rollout.rears,
    )
    half = math.hypot(body.along, body.across)
    for lane in others.lanes:
        met[lane, 0], met[lane, 1], rears[lane, 0], rears[lane, 1] = count, -1, FAR_OFF, FAR_OFF
    for k in range(count):
        x, y, heading = path[k, 0], path[k, 1], path[k, 2]
        pose = math.cos(heading), math.sin(heading), path[k, 3] * road.period
        for lane in others.lanes:
            box, row, reach = boxes[lane, k], lanes.rows[lane], half + max(others.rooms[lane], _NEAR)
            reach += road.ways.overruns[lane]
            box[0], seen[lane, k] = FAR_OFF, False
            # Both s and r may be off by the reach, and on a sine r changes with s.
            far = circles[lane, 2] + reach * (1 + math.hypot(1.0, steepness(lanes, lane)))
            dx, dy = x - circles[lane, 0], y - circles[lane, 1]
            # Vehicles drive on beyond the end of a lane that leads nowhere.
            endless = is_dead_end(road.ways.after, lane)
            if not endless and dx * dx + dy * dy > far * far:
                continue
            s, r = local(lanes, lane, x, y)
            at = LanePoint(x, y, unrolled(lanes, lane, s), r)
            if abs(r) > reach or at.s < -reach or not (endless or at.s <= row[LANE_LENGTH] + reach):
                continue
            _box(lanes, lane, at, pose, body, box)
            if k == 0 or k == count - 1:
                body_extent = Rectangle(0.0, pose[0], pose[1], body.length, body.width)
                rears[lane, 0 if k == 0 else 1] = extent_of(lanes, lane, at, body_extent).first
            met[lane, 0], met[lane, 1] = min(met[lane, 0], k), k
            if abs(r) <= body.visible and on_lane(lanes.rows, lane, s, 0.0, 0.0):
                aim = heading_at(lanes, lane, min(max(s, 0.0), row[LANE_LENGTH]))
                seen[lane, k] = math.cos(heading - aim) >= _WITH
