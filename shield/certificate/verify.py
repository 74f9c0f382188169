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

import math
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, RoadState, Vehicle
from dynamics.traffic.mobil import gains
from dynamics.traffic.occupancy import Surroundings
from dynamics.traffic.permits import apart, footprint
from shield.certificate.alongside import Alongside
from shield.certificate.kernels import (
    TOUCH,
    Others,
    in_reach,
    least_separations,
    margins,
    newcomers,
    rooms,
    sides_taken,
    still_coming,
    threats,
)
from shield.certificate.manoeuvres import Candidates
from shield.config import ShieldConfig

__all__ = ["NOTHING", "ROUNDING", "Binding", "Clearance", "Surveyor", "least_bad"]


_NO_FOLLOWERS = np.zeros((1, 0)), np.zeros((1, 0), dtype=np.intp), np.zeros((3, 0))
ROUNDING = 1e-6
"""What rounding may take from a plan that was verified a frame before [m]."""
_CORNER = 0.5
"""How far a corner of a vehicle behind may come beside a corner of the ego's buffer [m]."""
_GAINS = 1.0
"""By how much one that enters a lane may be wrong about what it gains by it [m/s^2]."""


@dataclass(frozen=True, slots=True)
class Binding:
    """What a margin comes from.

    Attributes
    ----------
    clause : its name, "" with nobody in reach. vehicle : row among the scene's others, -1 without one.
    """

    clause: str = ""
    vehicle: int = -1


NOTHING = Binding()
"""Nothing binds, or nothing was asked."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """Result for n trajectories.

    Attributes
    ----------
    margin : least separation beyond the buffer, (n,) [m]; +inf with nobody in reach, -inf in a gap of the map.
    clear : frames before the first violation, (n,); all of them without one.
    parts : where asked for, what the margin is the least of, (n, vehicles + 1) [m]: the least separation from each
        vehicle in reach, +inf from one that owes the ego its distance; from each that may slip in alongside; and the
        room in the lane that is stopped in.
    slipping, slippers : the same for those that may slip in alongside.
    separations, rows : least separation from each vehicle in reach (n, len(rows)) [m], and which they are.
    """

    margin: FloatArray
    clear: Any
    parts: FloatArray | None = None
    separations: FloatArray | None = None
    rows: Any = None
    slipping: FloatArray | None = None
    slippers: Any = None

    def binding(self, i: int) -> Binding:
        """The clause that the margin of path `i` comes from, and the vehicle."""
        margin = self.margin[i]
        if np.isneginf(margin):
            return Binding("gap of the map")
        for clause, values, rows in (
            ("separation", self.separations, self.rows),
            ("slip-in", self.slipping, self.slippers),
        ):
            if values is not None and values.shape[1] and values[i].min() <= margin:
                return Binding(clause, int(rows[values[i].argmin()]))
        return Binding("" if np.isposinf(margin) else "room")


class Surveyor:
    """Judges trajectories in one scene; what depends on the scene alone is computed once.

    Parameters
    ----------
    scene : the scene.
    config : buffer, assumptions and perception range.
    visible : frames for which the ego has been visible in each lane already, (lanes,); none by default.
    owned : which lanes the ego owns, (lanes,) bool; the one that it is in by default.
    around : the scene's surroundings, where they have been built already.
    ignored : whom to leave out, (m,) bool; nobody by default.
    followers : who owed the ego its distance in the scene before, (m,) bool; nobody by default.
    coming : who could enter which lane in the scene before, (lanes, m) bool; whoever may now by default.
    stored : the lane in which the stored fail-safe stops; None without one.
    """

    def __init__(
        self,
        scene: Scene,
        config: ShieldConfig,
        visible: Any = None,
        owned: Any = None,
        around: Surroundings | None = None,
        ignored: Any = None,
        followers: Any = None,
        coming: Any = None,
        stored: int | None = None,
    ) -> None:
        self.ignored = ignored
        self.scene, self.config, self.visible = scene, config, visible
        if owned is None:
            owned = np.arange(scene.road.centers.size) == scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        self.owned = np.asarray(owned, dtype=bool)
        if around is None:
            around = Surroundings(scene.others, scene.others_road, scene.road, config.assumptions, scene.dt)
        self.around = around
        ego, states, length = scene.ego_road, scene.others_road, scene.ego[Vehicle.LENGTH]
        bends = scene.road.bends
        b, a = config.buffer, config.assumptions
        # What the ego's buffered footprint, and its body, need beyond a straight road's rectangle.
        self.growth, self.bare = (0.0, 0.0), (0.0, 0.0)
        if bends is not None:
            width = float(scene.ego[Vehicle.WIDTH])
            self.growth = bends.growth(float(length) + 2 * b.longitudinal, width + 2 * b.lateral)
            self.bare = bends.growth(float(length), width)
        lon, lat = 0.5 * float(length) + b.longitudinal, 0.5 * float(scene.ego[Vehicle.WIDTH]) + b.lateral
        self._size_of_ego = np.array([lon, lat, length, scene.ego[Vehicle.WIDTH], *self.growth, *self.bare])
        self._bent = bends is not None
        self._reaction = int(np.ceil(a.reaction_time / scene.dt - 1e-9))
        psi = float(ego[RoadState.HEADING])
        half = lon * abs(math.cos(psi)) + lat * abs(math.sin(psi)) + self.growth[0]
        ahead, turned = states[:, RoadState.S] - ego[RoadState.S], states[:, RoadState.HEADING]
        sizes = scene.others[:, Vehicle.LENGTH], scene.others[:, Vehicle.WIDTH]
        # Who is behind is told from where the body is now: its reach is for wherever it may turn to.
        fronts = 0.5 * (sizes[0] * np.abs(np.cos(turned)) + sizes[1] * np.abs(np.sin(turned)))
        behind = ahead + fronts <= -half
        if followers is not None:
            # One that owes the ego its distance does so still where a corner of it has come beside a corner of the
            # ego's buffer, until it touches it.
            for i in np.flatnonzero(followers & ~behind & (ahead + fronts <= _CORNER - half)):
                seen = footprint(scene.ego, b.longitudinal, b.lateral)
                behind[i] = apart(seen, scene.others[i]) >= 0
        half_r = lon * abs(math.sin(psi)) + lat * abs(math.cos(psi)) + self.growth[1]
        r, centers = float(ego[RoadState.R]), scene.road.centers
        mine = centers[self.owned]
        low, high = around.low[:, None], around.high[:, None]
        held: BoolArray = ((low < mine + TOUCH) & (high > mine - TOUCH)).any(axis=1)
        if followers is not None:
            # The duty lasts until the ego has left the strip of the one that owes it.
            held |= followers & (around.low < r + half_r) & (around.high > r - half_r)
        nobody = np.zeros((centers.size, len(states)), dtype=bool)
        self.others = Others(
            ahead,
            np.minimum(ahead, around.bodies.floor - ego[RoadState.S]),
            around.reach + lon + self.growth[0] + 2.0,
            behind,
            around.low,
            around.high,
            around.lane,
            states[:, RoadState.R].copy(),
            states[:, RoadState.SPEED] * np.sin(turned),
            held,
            nobody,
            nobody,
        )
        if a.blind_merge:
            self.others = self._with_newcomers(coming, -1 if stored is None else stored)
        self._noses = around.front(2, scene.dt).T
        self._alongside = Alongside(scene, config, around)

    def without(self, ignored: BoolArray) -> Surveyor:
        """The same for whom some vehicles are not there, (m,) bool."""
        other = copy(self)
        other.ignored = ignored
        return other

    def _with_newcomers(self, before: Any, stored: int) -> Others:
        """The others, with who may enter which lane."""
        road, dt, a = self.scene.road, self.scene.dt, self.config.assumptions
        around = self.around
        tempted = gains(around.states, around.lane, around.low, around.high, road.centers, a.visible_distance, _GAINS)
        beside, may, turning = newcomers(self.others, tempted, road.centers, float(road.width))
        visible = self.visible
        if visible is None:
            offset = np.abs(road.centers - self.scene.ego_road[RoadState.R])
            visible = np.where(offset <= a.visible_distance, np.iinfo(np.intp).max, 0)
        settled = int(np.ceil(a.settle_time / dt - 1e-9))
        if before is None or before.shape != may.shape:
            before = may
        comes = still_coming(beside, may, turning, before, np.asarray(visible), stored, self._reaction, settled)
        return self.others._replace(beside=beside, comes=comes)

    def relevant(self, distance: float, followers: bool = True) -> Any:
        """Rows of those who can come into reach of an ego that travels at most `distance` [m].

        Dropping the rest cannot change any verdict: nobody ahead comes to a place further back than its least one.
        Without `followers`, those behind are left out altogether.
        """
        return in_reach(self.others, self._limits(distance), followers)

    def _limits(self, distance: float) -> FloatArray:
        return np.array([distance, self.config.perception_range])

    def clearance(self, paths: FloatArray, candidates: Candidates, hold: int = 0, parts: bool = False) -> Clearance:
        """Margin of each path against the worst case of the others.

        Parameters
        ----------
        paths : road states of the ego after frames 1..K, (n, K, 4).
        candidates : what the paths were rolled out from.
        hold : frames for which the others are *expected* to keep their speed (a forecast, not a bound).
        parts : whether the parts of the margins are wanted.
        """
        scene = self.scene
        distance = float(paths[:, -1, RoadState.S].max() - scene.ego_road[RoadState.S])
        rows, owed = self._threats(candidates, paths, distance)
        if self.ignored is not None and self.ignored.any():
            kept = ~self.ignored[rows]
            rows, owed = rows[kept], np.ascontiguousarray(owed[:, kept])
        room = rooms(paths, self._size_of_ego, scene.road.centers, candidates.fails, 0.5 * scene.road.width, self._bent)
        separations, reached = self._separations(paths, rows, owed, candidates, hold)
        slipping = np.empty((len(paths), 0))
        if len(self._alongside) and hold == 0:
            slipping = self._alongside.separations(paths, self._size_of_ego)
            if self.ignored is not None and self.ignored.any():
                slipping[:, self.ignored[self._alongside.rows]] = np.inf
        margin = margins(separations, slipping, room)
        if rows.size == 0:
            margin[~np.isfinite(paths).all(axis=(1, 2))] = np.nan
        self._close_gaps(paths, margin)
        each = np.column_stack([separations, *slipping.T, room]) if parts else None
        return Clearance(margin, reached, each, separations, rows, slipping, self._alongside.rows)

    def of_each(self, result: Clearance, i: int = 0) -> FloatArray:
        """How far path `i` of a result stays from where each vehicle can be, (m,) [m]; +inf out of reach."""
        out = np.full(len(self.scene.others), np.inf)
        if result.separations is not None:
            out[result.rows] = result.separations[i]
        return out

    def _separations(
        self, paths: FloatArray, rows: Any, owed: Any, candidates: Candidates, hold: int
    ) -> tuple[FloatArray, Any]:
        """Least separation of each path from each vehicle of `rows`, (n, len(rows)) [m], and the frames before the
        first violation, (n,)."""
        n, frames, _ = paths.shape
        scene, dt = self.scene, self.scene.dt
        separations, reached = np.empty((n, rows.size)), np.full(n, frames, dtype=np.intp)
        if rows.size == 0:
            return separations, reached
        low, high, home = self._lateral(rows, candidates, paths, bound=hold == 0)
        rear = self.around.rear(frames, dt, hold, rows)
        follows: Any = self.others.behind[rows]
        behind = _NO_FOLLOWERS
        if follows.any():
            behind = (scene.road.centers[home], self._at_once(home), self._followers(rows))
        least_separations(
            paths,
            self._size_of_ego,
            low,
            high,
            rear,
            self.around.reach[rows],
            np.ascontiguousarray(self._noses[:, rows]),
            owed,
            follows,
            *behind,
            self._duty(hold),
            separations,
            reached,
        )
        return separations, reached

    def _close_gaps(self, paths: FloatArray, margin: FloatArray) -> None:
        """Nothing leads through where the map has no lane: `margin` (n,) is -inf there."""
        gaps = self.scene.road.gaps
        if gaps is not None:
            margin[gaps.met(paths) & ~np.isnan(margin)] = -np.inf

    def _at_once(self, home: Any) -> Any:
        """Frames after which vehicles in the lanes `home` react to an ego that they see all the time, or -1 where they
        have not seen it yet."""
        if self.visible is None:
            return np.full(home.shape, -1)
        already = np.asarray(self.visible)[home]
        return np.where(already > 0, np.maximum(self._reaction + 1 - already, 0), -1)

    def _followers(self, rows: Any) -> FloatArray:
        """Speed [m/s], front [m] and stretch of vehicles, (3, len(rows))."""
        out = np.ones((3, rows.size))
        out[0] = self.scene.others_road[rows, RoadState.SPEED]
        out[1] = self.scene.others_road[rows, RoadState.S] + self.around.reach[rows]
        if self.around.stretch is not None:
            out[2] = self.around.stretch[1][rows]
        return out

    def _duty(self, hold: int) -> FloatArray:
        a = self.config.assumptions
        return np.array(
            [
                a.visible_distance,
                self._reaction,
                a.acceleration,
                a.follower_braking,
                a.max_speed,
                hold,
                self.scene.dt,
                a.power,
            ]
        )

    def _threats(self, candidates: Candidates, paths: FloatArray, distance: float) -> tuple[Any, Any]:
        """Rows of those in reach who do not owe the ego their distance on every path, and who of them owes it on which,
        (n, rows) bool; see `threats`."""
        return threats(
            self.others,
            self._limits(distance),
            np.asarray(candidates.lanes, dtype=np.intp),
            np.asarray(candidates.fails, dtype=np.intp),
            self.owned,
            self.scene.road.centers,
            paths,
            self._size_of_ego,
        )

    def _lateral(
        self, rows: Any, candidates: Candidates, paths: FloatArray, bound: bool
    ) -> tuple[FloatArray, FloatArray, Any]:
        """Lateral extent and home lane of each vehicle for each path, (n, len(rows)) or broadcastable to it.

        A vehicle beside a lane that the ego is about to enter may enter it too, its own leader among them, until it can
        see the ego there.
        """
        around = self.around
        a, n, m = self.config.assumptions, len(paths), len(rows)
        if not (a.blind_merge and bound):
            return around.low[rows][None], around.high[rows][None], around.lane[rows][None]
        low, high, home = np.empty((n, m)), np.empty((n, m)), np.empty((n, m), dtype=np.intp)
        road, r = self.scene.road, float(self.scene.ego_road[RoadState.R])
        sides_taken(
            paths,
            np.asarray(candidates.lanes, dtype=np.intp),
            np.asarray(candidates.fails, dtype=np.intp),
            rows,
            self.others,
            road.centers,
            np.array([r, a.visible_distance, road.width, a.lean]),
            low,
            high,
            home,
        )
        return low, high, home


def least_bad(result: Clearance) -> int:
    """The trajectory to take when none verifies: the one that stays clear longest, then the largest margin."""
    margin = np.nan_to_num(result.margin, nan=-np.inf)
    return int(np.lexsort((margin, result.clear))[-1])
