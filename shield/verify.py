"""Candidate trajectories against occupancy: a margin in metres, not a boolean.

Notation
--------
Road frame. The ego's footprint is inflated by the buffer along and across its heading psi; its half extents
along and across the road are

    h_s = (L/2 + b_lon) |cos psi| + (W/2 + b_lat) |sin psi|
    h_r = (L/2 + b_lon) |sin psi| + (W/2 + b_lat) |cos psi|

The separation from a rectangle is the greater of the longitudinal and the lateral gap, negative when both
overlap. The margin of a trajectory is the least separation over all frames and vehicles.

Who owes what (Responsibility-Sensitive Safety): a vehicle behind, in a lane that the ego *owns*, must keep its
distance. The ego owns the lane that it starts in, and one that it enters once a plan to stop there has been
verified against those behind: until then they are the ego's business. A plan must also end inside its lane, so
that an ego at rest is in nobody else's way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.prediction import Surroundings
from dynamics.scene import Scene
from dynamics.state import FloatArray, RoadState, Vehicle
from shield.candidates import Candidates
from shield.config import ShieldConfig

__all__ = ["Clearance", "Surveyor", "least_bad"]


_GIVES_WAY = 1.0
"""A vehicle that merges from the far side gives way if its centre is further behind than this [m]."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """Result for n trajectories.

    Attributes
    ----------
    margin : least separation beyond the buffer, (n,) [m]; +inf with nobody in reach.
    clear : frames before the first violation, (n,); all of them without one.
    parts : where asked for, what the margin is the least of, (n, vehicles + 1) [m]: the least separation from each
        vehicle in reach, +inf from one that owes the ego its distance; and the room in the lane that is stopped in.
    """

    margin: FloatArray
    clear: Any
    parts: FloatArray | None = None


class Surveyor:
    """Judges trajectories in one scene; what depends on the scene alone is computed once.

    Parameters
    ----------
    scene : the scene.
    config : buffer, assumptions and perception range.
    visible : frames for which the ego has been visible in each lane already, (lanes,); none by default.
    owned : which lanes the ego owns, (lanes,) bool; the one that it is in by default.
    around : the scene's surroundings, where they have been built already.
    announced : whether the traffic knows of the lane that a path commits to, so that one behind gives way.
    """

    def __init__(
        self,
        scene: Scene,
        config: ShieldConfig,
        visible: Any = None,
        owned: Any = None,
        around: Surroundings | None = None,
        announced: bool = True,
    ) -> None:
        self.announced = announced
        self.scene, self.config, self.visible = scene, config, visible
        if owned is None:
            owned = np.arange(scene.road.centers.size) == scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        self.owned = np.asarray(owned, dtype=bool)
        if around is None:
            around = Surroundings(scene.others, scene.others_road, scene.road, config.assumptions)
        self.around = around
        ego, states, length = scene.ego_road, scene.others_road, scene.ego[Vehicle.LENGTH]
        self._ahead = states[:, RoadState.S] - ego[RoadState.S]
        bends = scene.road.bends
        b = config.buffer
        # What the ego's buffered footprint, and its body, need beyond a straight road's rectangle.
        self.growth, self.bare = (0.0, 0.0), (0.0, 0.0)
        if bends is not None:
            width = float(scene.ego[Vehicle.WIDTH])
            self.growth = bends.growth(float(length) + 2 * b.longitudinal, width + 2 * b.lateral)
            self.bare = bends.growth(float(length), width)
        self._size = around.reach + 0.5 * length + 2.0 + b.longitudinal + self.growth[0]
        self._behind = self._ahead < -0.5 * length

    def relevant(self, distance: float, duration: float, followers: bool = True) -> Any:
        """Rows of those who can come into reach of an ego that travels at most `distance` [m] in `duration` [s].

        Dropping the rest cannot change any verdict: nobody ahead moves backwards further than that, and nobody
        behind accelerates harder than assumed. Without `followers`, those behind are left out altogether.
        """
        v: Any = self.scene.others_road[:, RoadState.SPEED]
        if self.around.stretch is not None:
            v = v * self.around.stretch[1]
        # Written so that a distance that is not a number drops nobody.
        near = ~(self._ahead - self._size + np.minimum(v, 0.0) * duration > distance)
        near &= np.abs(self._ahead) <= self.config.perception_range
        if followers:
            gain: Any = 0.5 * self.config.assumptions.acceleration * duration * (duration + self.scene.dt)
            if self.around.stretch is not None:
                gain = gain * self.around.stretch[1]
            near &= -self._ahead - self._size - np.maximum(v, 0.0) * duration - gain <= 0.0
        else:
            near &= ~self._behind
        return np.flatnonzero(near)

    def clearance(self, paths: FloatArray, candidates: Candidates, hold: int = 0, parts: bool = False) -> Clearance:
        """Margin of each path against the worst case of the others.

        Parameters
        ----------
        paths : road states of the ego after frames 1..K, (n, K, 4).
        candidates : what the paths were rolled out from.
        hold : frames for which the others are *expected* to keep their speed (a forecast, not a bound).
        parts : whether the parts of the margins are wanted.
        """
        n, frames, _ = paths.shape
        scene, config, dt = self.scene, self.config, self.scene.dt
        distance = float(paths[:, -1, RoadState.S].max() - scene.ego_road[RoadState.S])
        rows, owed = self._threats(candidates, distance, frames * dt)
        s, r, psi = paths[..., RoadState.S], paths[..., RoadState.R], paths[..., RoadState.HEADING]
        cos, sin = np.abs(np.cos(psi)), np.abs(np.sin(psi))
        lon = 0.5 * scene.ego[Vehicle.LENGTH] + config.buffer.longitudinal
        lat = 0.5 * scene.ego[Vehicle.WIDTH] + config.buffer.lateral
        half_s, half_r = lon * cos + lat * sin, lon * sin + lat * cos
        end = half_r[:, -1]
        if scene.road.bends is not None:
            half_s, half_r = half_s + self.growth[0], half_r + self.growth[1]
            # In its lane, what lies ahead and behind bends with the road: only the body has to fit.
            end = 0.5 * scene.ego[Vehicle.LENGTH] * sin[:, -1] + lat * cos[:, -1] + self.bare[1]
        room = self._room(candidates, r[:, -1], end)
        inside = np.where(room >= 0, np.inf, room)
        if rows.size == 0:
            margin = np.where(np.isfinite(paths).all(axis=(1, 2)), inside, np.nan)
            return Clearance(margin, np.full(n, frames), room[:, None] if parts else None)
        low, high, home = self._lateral(rows, candidates, r, bound=hold == 0)
        gap = np.maximum(low[:, :, None] - (r + half_r)[:, None, :], (r - half_r)[:, None, :] - high[:, :, None])
        rear = self.around.rear(frames, dt, hold, rows)
        gap_s = rear - (s + half_s)[:, None, :]
        mine, front = None, None
        if owed is not None and self._behind[rows].any():
            mine = np.flatnonzero(self._behind[rows])
            front = self._follower_front(rows[mine], home[:, mine], paths, hold)
            gap_s[:, mine] = np.maximum(gap_s[:, mine], (s - half_s)[:, None, :] - front)
        separation = np.maximum(gap, gap_s)
        if not sin.max() < 0.01:  # Going straight, the coming frame is the next of the path itself.
            ahead = self._coming_frame(paths, mine, low, high, rear, front)
            separation = np.where(ahead < 0, np.minimum(separation, ahead), separation)
        if owed is not None:
            separation = np.where(owed[:, :, None], np.inf, separation)
        least = separation.min(axis=1)
        bad = least < 0
        reached = np.where(bad.any(axis=1), bad.argmax(axis=1), frames)
        of = np.column_stack([separation.min(axis=2), room]) if parts else None
        return Clearance(np.minimum(least.min(axis=1), inside), reached, of)

    def _coming_frame(
        self,
        paths: FloatArray,
        mine: Any,
        low: FloatArray,
        high: FloatArray,
        rear: FloatArray,
        front: FloatArray | None,
    ) -> Any:
        """Separation of the bodies (no buffer) one frame after each frame, at constant velocity, (n, m, K) [m].

        highway-env counts a collision that constant velocity along the *heading* would bring within one frame
        (`RoadObject._is_colliding`), whether or not the steering turns the ego away in time.
        """
        s, r, psi, v = (paths[..., i] for i in RoadState)
        dt, length, width = self.scene.dt, self.scene.ego[Vehicle.LENGTH], self.scene.ego[Vehicle.WIDTH]
        sin, cos = np.sin(psi), np.cos(psi)
        s, r = s + v * cos * dt, r + v * sin * dt
        half_s = 0.5 * (length * np.abs(cos) + width * np.abs(sin)) + self.bare[0]
        half_r = 0.5 * (length * np.abs(sin) + width * np.abs(cos)) + self.bare[1]
        later = np.minimum(np.arange(s.shape[1]) + 1, s.shape[1] - 1)
        gap = np.maximum(low[:, :, None] - (r + half_r)[:, None, :], (r - half_r)[:, None, :] - high[:, :, None])
        gap_s = rear[None][:, :, later] - (s + half_s)[:, None, :]
        if front is not None:
            gap_s[:, mine] = np.maximum(gap_s[:, mine], (s - half_s)[:, None, :] - front[:, :, later])
        separation = np.maximum(gap, gap_s)
        # Nothing is said about the frame after the last: an ego that brakes stands by then.
        separation[..., -1] = np.inf
        return separation

    def _room(self, candidates: Candidates, r: FloatArray, half: FloatArray) -> FloatArray:
        """What is left beside the inflated ego in the lane that it ends in, (n,) [m]; negative where it reaches out."""
        offset = np.abs(r - self.scene.road.centers[candidates.fails])
        return np.asarray(0.5 * self.scene.road.width - offset - half)

    def _threats(self, candidates: Candidates, distance: float, duration: float) -> tuple[Any, Any]:
        """Rows of those in reach who do not owe the ego their braking on every path, and who of them owes it on which,
        (n, rows) bool, or None where nobody does.

        All those behind owe it where the path keeps to lanes that the ego owns: they must not run or move into it.
        Where it enters another lane, those behind in an owned lane that do not touch the new one as well.
        """
        new = ~self.owned
        enters = new[candidates.lanes] | new[candidates.fails]
        if not enters.any():
            return self.relevant(distance, duration, followers=False), None
        rows = self.relevant(distance, duration)
        around, centers = self.around, self.scene.road.centers
        # Which lanes each vehicle touches, (rows, lanes).
        touches = (around.low[rows, None] < centers + 1.0) & (around.high[rows, None] > centers - 1.0)
        entered = np.zeros((candidates.lanes.size, rows.size), dtype=bool)
        for lanes in (candidates.lanes, candidates.fails):
            entered |= new[lanes][:, None] & touches[:, lanes].T
        owned = (touches & self.owned).any(axis=1)
        owed = self._behind[rows] & ((owned & ~entered) | ~enters[:, None])
        kept = ~owed.all(axis=0)
        return rows[kept], owed[:, kept]

    def _lateral(
        self, rows: Any, candidates: Candidates, path: FloatArray, bound: bool
    ) -> tuple[FloatArray, FloatArray, Any]:
        """Lateral extent and home lane of each vehicle for each path, (n, len(rows)) or broadcastable to it.

        A vehicle beside a lane that the ego is about to enter may enter it too, its own leader among them, until it can
        see the ego there. Where an ego that announces it commits to that lane, one behind gives way (highway-env's
        traffic aborts such a lane change); of the lane that the fail-safe would return to nobody knows.
        """
        around = self.around
        low, high = around.low[rows][None, :], around.high[rows][None, :]
        lane = home = around.lane[rows][None, :]
        if not (self.config.assumptions.blind_merge and bound):
            return low, high, home
        centers, width = self.scene.road.centers, self.scene.road.width
        r = self.scene.ego_road[RoadState.R]
        half = 0.5 * self.scene.others[rows, Vehicle.WIDTH]
        returns = candidates.fails != candidates.lanes
        for entered in (candidates.lanes, candidates.fails) if returns.any() else (candidates.lanes,):
            goal = centers[entered][:, None]
            hidden = np.abs(path - goal).max(axis=1) > self.config.assumptions.visible_distance
            hidden |= np.abs(r - goal[:, 0]) > self.config.assumptions.visible_distance
            if not hidden.any():
                continue
            apart = np.abs(centers[lane] - goal)
            far = (apart > 0) & (apart < 1.5 * width) & hidden[:, None]
            if entered is candidates.fails:
                far &= returns[:, None]
            elif self.announced:
                far &= self._ahead[rows] > -_GIVES_WAY
            low = np.where(far, np.minimum(low, goal - half), low)
            high = np.where(far, np.maximum(high, goal + half), high)
            home = np.where(far, entered[:, None], home)
        return low, high, home

    def _follower_front(self, rows: Any, home: Any, paths: FloatArray, hold: int) -> FloatArray:
        """Greatest front (n, len(rows), K) of vehicles behind: they accelerate until they owe braking."""
        assumptions, dt = self.config.assumptions, self.scene.dt
        frames = paths.shape[1]
        center = self.scene.road.centers[home]
        seen = np.abs(paths[:, None, :, RoadState.R] - center[:, :, None]) <= assumptions.visible_distance
        # The duty starts when the ego has come into sight for good; losing sight of it starts the clock again.
        hidden = ~seen
        first = np.where(hidden.any(axis=2), frames - hidden[:, :, ::-1].argmax(axis=2) + 1, 1)
        reaction = int(np.ceil(assumptions.reaction_time / dt - 1e-9))
        react = first + reaction
        if self.visible is not None:
            already = np.asarray(self.visible)[home]
            react = np.where((first == 1) & (already > 0), np.maximum(reaction + 1 - already, 0), react)
        k, turn = np.arange(frames), react[:, :, None]
        gain = assumptions.acceleration * dt * np.maximum(np.minimum(k, turn) - hold, 0)
        loss = assumptions.follower_braking * dt * np.maximum(k - turn, 0)
        v0 = self.scene.others_road[rows, RoadState.SPEED][None, :, None]
        top = np.minimum(v0 + gain, np.maximum(v0, assumptions.max_speed))
        v = np.maximum(top - loss, 0.0)
        start = self.scene.others_road[rows, RoadState.S] + self.around.reach[rows]
        way = np.cumsum(v, axis=2) * dt
        # Where the ego has come to rest at the last frame, its follower may still be doing so.
        last = v[..., -1]
        rest = last**2 / (2 * assumptions.follower_braking) + 0.5 * last * dt
        way[..., -1] += np.where(paths[:, -1, RoadState.SPEED] < 0.5, 1.0, 0.0)[:, None] * rest
        if self.around.stretch is not None:
            way *= self.around.stretch[1][rows][None, :, None]
        return np.asarray(start[None, :, None] + way)


def least_bad(result: Clearance) -> int:
    """The trajectory to take when none verifies: the one that stays clear longest, then the largest margin."""
    margin = np.nan_to_num(result.margin, nan=-np.inf)
    return int(np.lexsort((margin, result.clear))[-1])
