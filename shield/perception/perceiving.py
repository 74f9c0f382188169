"""`ObservationPerception`: scenes from Kinematics observations."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from dynamics.scenes.scene import EgoControl, Scene
from dynamics.state import BoolArray, FloatArray, RoadState, State
from shield.decision import Guarantee
from shield.perception.bodies import STANDING, bodies, bounded, unseen_bodies
from shield.perception.filters import SCORE_LIMIT
from shield.perception.learned import RESOLUTION, Conformal, Learned, Noise
from shield.perception.perception_settings import PerceptionConfig
from shield.perception.sensor_monitor import SensorMonitor
from shield.perception.sighting import DecodedObservation, decode
from shield.perception.spec import ObservationSpec
from shield.perception.tracking import MotionModels, Tracks, bounds_of, predict_tracks, update_tracks
from shield.perception.unseen import Unseen, UnseenBehind, edges, unseen_ahead
from shield.perception.vanished import VanishedVehicles

__all__ = ["ObservationPerception", "PerceptionConfig"]

_X, _Y, _HEADING, _SPEED = int(State.X), int(State.Y), int(State.HEADING), int(State.SPEED)
_S, _V = int(RoadState.S), int(RoadState.SPEED)
_COLUMNS = len(State)
_NO_VEHICLES = np.zeros((0, 3))
_MISSED_LIMIT = 3
"""Consecutive observations that a vehicle may be missing from, where the sensor is noisy."""


class ObservationPerception:
    """Makes scenes from Kinematics observations, the only source for the traffic.

    The road map and the ego's target command (lane and speed) are known. Sizes are not observed: every body has the
    size `ObservationSpec.body`. An unseen vehicle is assumed in each lane at either edge of sight
    (`shield.perception.unseen`).

    Parameters
    ----------
    spec : meaning of the observations.
    road : the static road map, a `dynamics.roads.straight.StraightRoad`.
    timing : duration of a simulation frame [s], and simulation frames in a decision.
    config : settings.
    learned : what was estimated about the sensor before; None for nothing.

    Attributes
    ----------
    tracks : the tracked vehicles. behind : vehicles that may be unseen behind.
    edges : distance ahead and behind within which every vehicle is seen [m].
    learned : present estimates about the sensor. They outlive `reset` if `PerceptionConfig.carry` is set.
    monitor : test whether the sensor behaves as assumed.
    vanished : vehicles that disappeared in a region where every vehicle is seen.
    """

    def __init__(
        self,
        spec: ObservationSpec,
        road: Any,
        timing: tuple[float, int],
        config: PerceptionConfig | None = None,
        learned: Learned | None = None,
    ) -> None:
        self.spec, self._road, self._timing = spec, road, timing
        self.config = PerceptionConfig() if config is None else config
        self._before = _unlearned(self.config) if learned is None else learned
        self.learned = self._before
        assumed: Any = RESOLUTION if self.config.noise in (None, "estimate") else self.config.noise
        self._assumed_noise = np.maximum(assumed, RESOLUTION)
        self._usual = np.full((2, 4), float(self.config.bound))
        self._watched = self.config.monitor or self.learned.noise is not None or self.learned.conformal is not None
        centers = road.centers + road.origin[1]
        self._motions = MotionModels(
            self.config.lane_keeping,
            manoeuvring=self.config.manoeuvring,
            centers=centers,
            usual_speed=self.config.usual_speed,
        )
        usual = 0 if self.config.noise is None else _MISSED_LIMIT
        self._missed_limit = usual if self.config.missed_limit is None else self.config.missed_limit
        self.reset()

    def reset(self) -> None:
        """Clear everything about the episode; without `PerceptionConfig.carry` also what was learned in it."""
        self.tracks, self.behind, self.monitor = Tracks(), UnseenBehind(), SensorMonitor()
        self.vanished, self._anybody = VanishedVehicles(), False
        if not self.config.carry:
            self.learned = self._before
        self.edges = self.spec.distance, self.spec.distance
        self._egos: deque[tuple[int, FloatArray]] = deque()

    @property
    def ego(self) -> FloatArray:
        """Row of the ego as last seen, (7,)."""
        return self._egos[-1][1]

    @property
    def rating(self) -> tuple[Guarantee, float]:
        """Guarantee and probability level of a certificate for the scene seen last (see `Decision`)."""
        if self.alarmed:
            return Guarantee.NONE, 0.0
        if self.config.noise is not None or self.config.delay:
            return Guarantee.PROBABILISTIC, 0.5 * (1 + math.erf(self.config.bound / math.sqrt(2)))
        # An empty observation shows an empty road, or no vehicle of a full one.
        everybody = min(self.edges) >= self.spec.distance and self._anybody
        return (Guarantee.ALL_SEEN if everybody else Guarantee.ASSUMED), 1.0

    @property
    def alarmed(self) -> bool:
        """Whether the sensor does not behave as assumed, or has lost a vehicle within sight."""
        return len(self.vanished) > 0 or (self.config.monitor and self.monitor.alarmed)

    @property
    def noise(self) -> FloatArray:
        """Standard deviations of the observed x, y [m], vx and vy [m/s], (4,): as configured, or as estimated so
        far."""
        return self._assumed_noise if self.learned.noise is None else self.learned.noise.sigma

    @property
    def bounds(self) -> FloatArray:
        """Distance of the bounds below and above each of x, y, vx and vy, in standard deviations, (2, 4)."""
        if self.alarmed:
            return np.full((2, 4), SCORE_LIMIT)
        if self.learned.conformal is not None:
            return self.learned.conformal.bounds
        return self._usual

    def see(self, observation: Any, frame: int, control: EgoControl) -> Scene:
        """Scene that an observation shows.

        Parameters
        ----------
        observation : of shape `spec.shape`, or flattened.
        frame : index of the simulation frame since the episode began. A second call with the same frame reads no
            observation.
        control : the ego's target command, and the commands available to it.

        Raises
        ------
        SceneError
            If the observation cannot be read.
        """
        if not self._egos or frame != self._egos[-1][0]:
            sighting = decode(self.spec, observation)
            self._observe(sighting, *self._move(sighting, frame))
        return self._scene(control)

    def _move(self, sighting: DecodedObservation, frame: int) -> tuple[FloatArray, float]:
        """Record the ego's present state.

        Returns
        -------
        The ego's row when the observed vehicles were seen, (7,), and the time between that and the previous one [s].
        Both differ from the present where the sensor has a delay.
        """
        egos, dt, before = self._egos, self._timing[0], self._egos[-1] if self._egos else None
        then = self._then() if egos else frame
        row = None if before is None else before[1]
        passed = dt if before is None else (frame - before[0]) * dt
        egos.append((frame, _ego_row(sighting, row, passed, self.spec.body, frame - (before or (0,))[0] > 1)))
        while len(egos) > 1 and egos[1][0] <= frame - self.config.delay:
            egos.popleft()
        return egos[0][1], (egos[0][0] - then) * dt

    def _then(self) -> int:
        """Frame at which the vehicles of the last observation were seen."""
        return self._egos[0][0]

    def _observe(self, sighting: DecodedObservation, then: FloatArray, passed: float) -> None:
        """Update tracks, edges and unseen vehicles with an observation that was made when the ego was at `then`,
        (7,)."""
        states, now, before = sighting.others.copy(), self._egos[-1][1], _cartesian(then)
        if self.spec.absolute:
            states[:, 0] += now[_X]
        else:
            # Relative values refer to the ego's state at the time of the observation.
            states += before
            states[:, 1:] -= sighting.ego[1:]
        last = self.tracks
        if passed or not len(last.ids):
            places, noise = sighting.places if self.spec.sorted else None, np.diag(np.square(self.noise))
            rest = self._missed_limit, places, self._watched
            self.tracks = update_tracks(last, states, noise, passed, self._motions, *rest)
            self._learn()
        self.edges = edges(self.spec, sighting)
        x, _, along, _ = before.tolist()
        lost = new = _NO_VEHICLES
        if self.tracks.ids is not last.ids:
            lost = _around(last, ~np.isin(last.ids, self.tracks.ids), x, passed)
            new = _around(self.tracks, self.tracks.ids >= last.next_id, x)
        self.behind.go_on(self.config.unseen, self.edges[1], along, passed, lost, new)
        self._anybody = self._anybody or len(self.tracks.ids) > 0
        if self.config.noise is None and not self.config.delay:
            # A noisy sensor misses a vehicle now and then: see `PerceptionConfig.missed_limit`.
            gone = lost + np.array([x, 0.0, 0.0])
            self.vanished.go_on(gone, self.tracks.mean[:, :2], x, self.edges, passed)

    def _learn(self) -> None:
        """Update the sensor monitor and the estimates with the innovations of the last observation."""
        surprise = self.tracks.surprise
        if surprise is not None:
            self.monitor = self.monitor.after(self._egos[-1][0], surprise.distances, self._timing[1])
            self.learned = self.learned.after(surprise)

    def _scene(self, control: EgoControl) -> Scene:
        dt, frames = self._timing
        (frame_then, then), (frame, ego) = self._egos[0], self._egos[-1]
        late, road = (frame - frame_then) * dt, self._road
        now = predict_tracks(self.tracks, late, self._motions)
        mean = now.mean
        rows = bounded(mean, *bounds_of(now, self.bounds), self.spec.body, float(ego[_X]))
        blurred = self.config.noise is not None or self.config.delay > 0
        likely = bodies(mean, self.spec.body) if blurred else None
        ids = self.tracks.ids
        ghosts = self._ghosts(road.to_road(then), mean if now is self.tracks else self.tracks.mean)
        if len(ghosts):
            if late:
                ghosts[:, _S] += late * ghosts[:, _V]
            ghost_rows = unseen_bodies(road.to_world(ghosts), self.spec.body)
            rows, ids = np.concatenate([rows, ghost_rows]), np.concatenate([ids, np.full(len(ghosts), -1)])
            likely = None if likely is None else np.concatenate([likely, ghost_rows])
        if len(self.vanished):
            gone = bodies(self.vanished.states(float(ego[_X])), self.spec.body)
            rows, ids = np.concatenate([rows, gone]), np.concatenate([ids, np.full(len(gone), -1)])
        if self.alarmed:
            # No vehicle is identified with an earlier one: earlier knowledge does not narrow its bounds.
            ids = np.full(len(rows), -1)
        return Scene(
            ego=ego,
            others=rows,
            road=road,
            control=control,
            dt=dt,
            frames_per_decision=frames,
            frame=frame,
            ids=ids,
            blurred=blurred,
            likely=likely,
            observed=True,
        )

    def _ghosts(self, ego: FloatArray, mean: FloatArray) -> FloatArray:
        """Road states of vehicles that may be unseen, (n, 4).

        Parameters
        ----------
        ego : the ego's road state, (4,). mean : states of the tracked vehicles in the world frame, (m, 4).
        """
        spec, road, (far, back) = self.spec, self._road, self.edges
        unseen, pool = self.config.unseen, self.behind
        if self.alarmed:
            unseen, pool = Unseen.worst(), UnseenBehind(nearest_unseen=-back)
        behind = pool.states(unseen, road, ego, spec.distance)
        if far >= spec.distance:
            return behind
        seen = road.to_road(bodies(mean, spec.body))
        return np.concatenate([unseen_ahead(spec, far, unseen, road, ego, seen), behind])


def _around(tracks: Tracks, chosen: BoolArray, x: float, passed: float = 0.0) -> FloatArray:
    """Positions and speeds of the chosen tracks, relative to x, (n, 3): distance ahead of x [m], y [m], vx [m/s].

    Parameters
    ----------
    passed : time by which the tracks are extrapolated at constant velocity [s].
    """
    states = tracks.mean[chosen]
    states[:, :2] += passed * states[:, 2:]
    states[:, 0] -= x
    return states[:, :3]


def _unlearned(config: PerceptionConfig) -> Learned:
    """Initial estimates, before the first observation."""
    return Learned(
        Noise() if config.noise == "estimate" else None,
        Conformal.of(config.bound) if config.bounds == "conformal" else None,
    )


def _cartesian(row: FloatArray) -> FloatArray:
    """x, y [m], vx, vy [m/s] of a vehicle row, (4,)."""
    x, y, heading, speed = row[:_COLUMNS].tolist()
    return np.array([x, y, speed * math.cos(heading), speed * math.sin(heading)])


def _ego_row(
    sighting: DecodedObservation, before: FloatArray | None, passed: float, body: tuple[float, float], between: bool
) -> FloatArray:
    """Row of the ego, (7,).

    x is the previous x plus speed times `passed`, because the observed x may be clipped to its range. The mean of both
    speeds is used if frames lie `between` the two observations.
    """
    x, y, vx, vy = sighting.ego.tolist()
    heading, speed = _polar(vx, vy, sighting.heading, 0.0 if before is None else float(before[_HEADING]))
    if before is not None:
        along = float(_cartesian(before)[2])
        x = before[_X] + (0.5 * (along + vx) if between else along) * passed
    elif math.isnan(x):
        x = 0.0
    return np.array([x, y, heading, speed, *body, 0.0])


def _polar(vx: float, vy: float, heading: float, last: float) -> tuple[float, float]:
    """Heading [rad] and speed [m/s] of a velocity; a heading differs from the road's direction by at most a quarter
    turn."""
    size = math.hypot(vx, vy)
    if math.isfinite(heading):
        return heading, math.copysign(size, vx * math.cos(heading) + vy * math.sin(heading)) if size else 0.0
    if size < STANDING:
        return last, math.copysign(size, vx)
    sign = math.copysign(1.0, vx)
    return math.atan2(sign * vy, sign * vx), sign * size
