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

from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import BoolArray, FloatArray, RoadState, Vehicle
from dynamics.traffic.assumptions import Assumptions
from dynamics.traffic.occupancy import Surroundings
from dynamics.traffic.permits import footprint
from shield.certificate.alongside import Alongside
from shield.certificate.clauses.duties import Sight, in_reach, others_of
from shield.certificate.clauses.footprint import Footprint
from shield.certificate.clauses.room import margins
from shield.certificate.clauses.separation import Duty
from shield.certificate.clauses.together import Around, Ground, judged
from shield.certificate.manoeuvres import Candidates
from shield.config import ShieldConfig

__all__ = ["NOTHING", "ROUNDING", "Binding", "Clearance", "Surveyor", "least_bad"]


ROUNDING = 1e-6
"""What rounding may take from a plan that was verified a frame before [m]."""
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
        self.ignored = np.zeros(0, dtype=bool) if ignored is None else ignored
        self.scene, self.config, self.visible = scene, config, visible
        if owned is None:
            owned = np.arange(scene.road.centers.size) == scene.road.lane_at(float(scene.ego_road[RoadState.R]))
        self.owned = np.asarray(owned, dtype=bool)
        if around is None:
            ego = float(scene.ego_road[RoadState.S])
            around = Surroundings(scene.others, scene.others_road, scene.road, config.assumptions, scene.dt, None, ego)
        self.around, road, b, a = around, scene.road, config.buffer, config.assumptions
        length, width = float(scene.ego[Vehicle.LENGTH]), float(scene.ego[Vehicle.WIDTH])
        # What the ego's buffered footprint, and its body, need beyond a straight road's rectangle.
        growth, bare = (0.0, 0.0), (0.0, 0.0)
        if road.bends is not None:
            growth = road.bends.growth(length + 2 * b.longitudinal, width + 2 * b.lateral)
            bare = road.bends.growth(length, width)
        self.growth, self.bare = growth, bare
        self._size = Footprint(0.5 * length + b.longitudinal, 0.5 * width + b.lateral, length, width, *growth, *bare)
        m = len(scene.others)
        perception, blind = float(config.perception_range), bool(a.blind_merge)
        self._ground = Ground(road.centers, float(road.width), a.lean, perception, road.bends is not None, blind)
        self._duty, sight = _duty(a, scene.dt), _sight(a, scene.dt, float(road.width))
        self.seen = footprint(scene.ego, b.longitudinal, b.lateral)
        self._visible = np.zeros(road.centers.size, dtype=np.intp) if visible is None else np.asarray(visible, np.intp)
        in_sight = self._visible
        if visible is None:
            offset = np.abs(road.centers - scene.ego_road[RoadState.R])
            in_sight = np.where(offset <= a.visible_distance, np.iinfo(np.intp).max, 0)
        self.others = others_of(
            around.others,
            around.states,
            around.bodies,
            scene.ego_road,
            self._size,
            self.seen,
            self.owned,
            np.zeros(m, dtype=bool) if followers is None else followers,
            np.zeros((0, 0), dtype=bool) if coming is None else coming,
            in_sight,
            -1 if stored is None else stored,
            sight,
            road.centers,
        )
        rows = around.others, around.states, around.stretches, around.bodies, around.motion
        self._around = Around(*rows, around.front(2), self.others)
        self._alongside = Alongside(scene, config, around)

    def without(self, ignored: BoolArray) -> Surveyor:
        """The same for whom some vehicles are not there, (m,) bool."""
        other = copy(self)
        other.ignored = ignored
        return other

    def relevant(self, distance: float, followers: bool = True) -> Any:
        """Rows of those who can come into reach of an ego that travels at most `distance` [m].

        Dropping the rest cannot change any verdict: nobody ahead comes to a place further back than its least one.
        Without `followers`, those behind are left out altogether.
        """
        return in_reach(self.others, (distance, self._ground.perception), followers)

    def clearance(self, paths: FloatArray, candidates: Candidates, hold: int = 0, parts: bool = False) -> Clearance:
        """Margin of each path against the worst case of the others.

        Parameters
        ----------
        paths : road states of the ego after frames 1..K, (n, K, 4).
        candidates : what the paths were rolled out from.
        hold : frames for which the others are *expected* to keep their speed (a forecast, not a bound).
        parts : whether the parts of the margins are wanted.
        """
        separations, rows, reached, room = judged(
            paths,
            candidates.lanes,
            candidates.fails,
            self.scene.ego_road,
            self._size,
            self._around,
            self.owned,
            self._visible,
            self.ignored,
            self._ground,
            self._duty if hold == 0 else self._duty._replace(hold=hold),
        )
        slipping = np.empty((len(paths), 0))
        if len(self._alongside) and hold == 0:
            slipping = self._alongside.separations(paths, self._size)
            if self.ignored.any():
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

    def _close_gaps(self, paths: FloatArray, margin: FloatArray) -> None:
        """Nothing leads through where the map has no lane: `margin` (n,) is -inf there."""
        gaps = self.scene.road.gaps
        if gaps is not None:
            margin[gaps.met(paths) & ~np.isnan(margin)] = -np.inf


@lru_cache(maxsize=16)
def _duty(a: Assumptions, dt: float) -> Duty:
    frames = _frames(a.reaction_time, dt)
    return Duty(a.visible_distance, frames, a.acceleration, a.follower_braking, a.max_speed, a.power, 0, dt)


@lru_cache(maxsize=16)
def _sight(a: Assumptions, dt: float, width: float) -> Sight:
    frames = _frames(a.reaction_time, dt), _frames(a.settle_time, dt)
    return Sight(a.visible_distance, _GAINS, *frames, bool(a.blind_merge), width)


def _frames(time: float, dt: float) -> int:
    return int(np.ceil(time / dt - 1e-9))


def least_bad(result: Clearance) -> int:
    """The trajectory to take when none verifies: the one that stays clear longest, then the largest margin."""
    margin = np.nan_to_num(result.margin, nan=-np.inf)
    return int(np.lexsort((margin, result.clear))[-1])
