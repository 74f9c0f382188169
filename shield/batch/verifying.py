"""Candidates judged one after another: each tracks a target for some frames, and then brakes to a stop."""

from __future__ import annotations

import math

from dynamics.compiled import uncounted
from dynamics.state import BoolArray, FloatArray
from dynamics.vehicle.controllers import KP_SPEED
from dynamics.vehicle.rollout_kernels import roll_stop
from shield.batch.arrays import Room, Scene
from shield.batch.law import NOBODY, Law
from shield.certificate.clauses.footprint import reach_across, reach_along
from shield.certificate.clauses.together import SEPARATION_BINDS, judge

__all__ = ["frames_of", "verify"]


@uncounted
def frames_of(law: Law, v: float, most: float, commit: int) -> int:
    """Frames after which every candidate stands that commits, at speed `v`, to `most` at the most [m/s]; see
    `shield.certificate.manoeuvres.brake_candidates`."""
    numbers = law.numbers
    decay = 1 - KP_SPEED * numbers.dt if commit == 1 else numbers.decay
    top = max(v, most + (v - most) * decay, 0.0)
    return commit + math.ceil(top / (numbers.braking * numbers.dt)) + 1


@uncounted
def _touches(state: FloatArray, rear: float, j: int, scene: Scene) -> bool:
    """Whether the ego's buffer overlaps for sure with where vehicle `j` can be, whose body is no further back than
    `rear` [m]."""
    s, r, foot, others = state[0], state[1], scene.foot, scene.around.others
    half = reach_across(foot, state[2])
    beside = others.low[j] - (r + half) < 0 and (r - half) - others.high[j] < 0
    return beside and rear - (s + reach_along(foot, state[2])) < 0


@uncounted
def verify(
    scene: Scene, law: Law, n: int, commit: int, frames: int, hold: int, ignored: BoolArray, first: int, room: Room
) -> int:
    """Judge the first `n` candidates of the room; where `first` is 1, none after one that verifies, and of those before
    it only that they do not.

    Parameters
    ----------
    commit, frames : of commitment to the target, and in all. hold, ignored : see `judge`.

    Returns
    -------
    The first candidate that verifies, or -1.
    """
    plans, path, found, behind = room.plans, room.path[:, :frames], NOBODY, scene.around.others.behind
    suspect, reached = NOBODY, 0
    if first > 0 and hold == 0 and room.suspect[0] != NOBODY and room.desk.done[0, room.suspect[0]] >= frames:
        suspect, reached = room.suspect[0], room.suspect[1]
    if frames > room.path.shape[1]:
        # Faster than there is room for: nothing is verified.
        for i in range(n):
            plans.margins[i], plans.clear[i], plans.clauses[i], plans.vehicles[i] = -math.inf, 0, 0, NOBODY
        room.desk.found[0] = 0
        return NOBODY
    for i in range(n):
        lane, fail = plans.lanes[i : i + 1], plans.fails[i : i + 1]
        goal, last_goal = law.centers[lane[0]], law.centers[fail[0]]
        braking, dt, speed = law.numbers.braking, law.numbers.dt, plans.speeds[i]
        begin, struck = 0, False
        if suspect != NOBODY:
            # Whoever was in the way of the last one is asked first, while the path is being rolled.
            for f in range(reached, frames - 1):
                roll_stop(scene.state, goal, last_goal, speed, commit, braking, law.table, dt, path[0], begin, f + 1)
                begin = f + 1
                if _touches(path[0, f], room.desk.rears[0, suspect, f], suspect, scene):
                    struck = True
                    break
        if struck:
            plans.margins[i] = -math.inf
            continue
        roll_stop(scene.state, goal, last_goal, speed, commit, braking, law.table, dt, path[0], begin, frames)
        margin, clear, clause, vehicle = judge(
            path,
            lane,
            fail,
            scene.state,
            scene.foot,
            scene.settings,
            law.table,
            hold,
            scene.ground,
            ignored,
            scene.around,
            scene.slipping,
            room.desk,
        )
        plans.margins[i], plans.clear[i], plans.clauses[i], plans.vehicles[i] = margin, clear, clause, vehicle
        if margin >= 0 and found == NOBODY:
            found = i
            if first > 0:
                return found
        if first > 0 and clause == SEPARATION_BINDS and margin < 0 and hold == 0 and not behind[vehicle]:
            suspect, reached = vehicle, clear
            room.suspect[0], room.suspect[1] = vehicle, clear
    return found
