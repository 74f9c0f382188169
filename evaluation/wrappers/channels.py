"""Channels: columns that are added to a Kinematics observation, with the confidence or the intent of each row.

A channel is added at the end of every row, after highway-env's features; an empty row has 0. Channels compose with each
other and with `SensorNoise`: they are computed from the observation that the sensor returns.
"""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from dynamics.state import BoolArray, FloatArray
from evaluation.names import check_sensor
from evaluation.wrappers.checks import check_number
from evaluation.wrappers.ghosts import in_units
from evaluation.wrappers.sensor_model import SensorModel, get_sensor
from evaluation.wrappers.sensor_noise import SensorNoise
from shield.errors import ConfigError
from shield.perception.certainty import probability_within
from shield.perception.perceiving import ObservationPerception
from shield.perception.scenes import ObservedScenes
from shield.perception.spec import STATE, ObservationSpec

__all__ = ["CHANNELS", "Confidence", "Intent", "TrackedConfidence", "seen_through", "split_sensor"]


class _Channel(gym.ObservationWrapper[Any, Any, Any]):
    """Base class of a channel, which adds one column.

    Attributes
    ----------
    added_features : name of the column. A shield that reads observations uses the environment below this wrapper.
    """

    added_features: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: gym.Env[Any, Any], low: float) -> None:
        super().__init__(env)
        kind: Any = getattr(env.unwrapped, "observation_type", None)
        name, space = type(kind).__name__, env.observation_space
        if name != "KinematicObservation" or not isinstance(space, spaces.Box):
            raise ConfigError(f"{type(self).__name__} adds a column to Kinematics observations, not to {name}")
        missing = [each for each in STATE if each not in kind.features]
        if missing:
            raise ConfigError(
                f"{type(self).__name__} needs x, y, vx and vy; the observation lacks {', '.join(missing)}"
            )
        column = np.full((space.shape[0], 1), 1.0)
        lows, highs = np.column_stack([space.low, low * column]), np.column_stack([space.high, column])
        kind_of = np.float64 if space.dtype == np.float64 else np.float32
        self.observation_space = spaces.Box(lows.astype(kind_of), highs.astype(kind_of), dtype=kind_of)
        self.spec_shown = ObservationSpec(features=tuple(kind.features), rows=int(kind.vehicles_count), ranges={})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and forget past observations."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.spec_shown = ObservationSpec.of(self.unwrapped)
        self._forget()
        return self.observation(observation), info

    def observation(self, observation: Any) -> Any:
        """The observation with the column added."""
        rows = np.asarray(observation)
        there = np.abs(rows[:, : len(self.spec_shown.features)]).max(axis=1) > 0
        column = np.where(there, self._column(rows, there), 0.0)
        return np.column_stack([rows, column]).astype(rows.dtype)

    def _forget(self) -> None:
        """Prepare for a new episode."""

    def _column(self, rows: Any, there: BoolArray) -> FloatArray:
        """Value of the column for each row, (rows,); ignored where no vehicle is `there`."""
        raise NotImplementedError

    def _shown(self, rows: Any) -> FloatArray:
        """x, y, vx and vy of the observation, (rows, 4)."""
        columns = [self.spec_shown.features.index(name) for name in STATE]
        return np.asarray(rows[:, columns], dtype=float)


class Confidence(_Channel):
    """Adds "confidence", exp(-Var(x, y, vx, vy)) of each row.

    Var is the sum over the four features of the population variance of the row's values in the last `window` decisions
    in which it was not empty, in the observation's own units. A row is a place in the observation, not a vehicle: if
    rows are sorted anew, its values change too. A row that has just been filled has 1.

    Parameters
    ----------
    env : an environment of highway-env with a Kinematics observation, wrapped or not.
    window : number of decisions.

    Examples
    --------
    >>> from evaluation.settings import get_setting
    >>> env = Confidence(get_setting("highway-fast").make())
    >>> observation, _ = env.reset(seed=0)
    >>> observation.shape, observation[:, -1].tolist()
    ((5, 6), [1.0, 1.0, 1.0, 1.0, 1.0])
    """

    added_features = ("confidence",)

    def __init__(self, env: gym.Env[Any, Any], window: int = 5) -> None:
        if type(window) is not int or window < 2:
            raise ConfigError(f"window is a whole number of decisions from 2 on, got {window!r}")
        super().__init__(env, low=0.0)
        self._window = window
        self._forget()

    def _forget(self) -> None:
        self._past: deque[tuple[int, FloatArray]] = deque(maxlen=self._window)

    def _column(self, rows: Any, there: BoolArray) -> FloatArray:
        now = int(self.unwrapped.steps)  # type: ignore[attr-defined]
        if self._past and self._past[-1][0] == now:
            self._past.pop()
        self._past.append((now, np.where(there[:, None], self._shown(rows), np.nan)))
        shown = np.stack([each for _, each in self._past])
        known = ~np.isnan(shown)
        n = np.maximum(known.sum(axis=0), 1)
        mean = np.where(known, shown, 0.0).sum(axis=0) / n
        variances = np.where(known, np.square(shown - mean), 0.0).sum(axis=0) / n
        found: FloatArray = np.exp(-variances.sum(axis=1))
        return found


class TrackedConfidence(_Channel):
    """Adds "confidence", a probability for the vehicle in each row.

    It is the probability that the vehicle's centre, at the time of the observation, was at most `distance` from the
    tracker's estimate (`shield.perception.certainty.probability_within`). The ego's row has 1. The tracker is that of
    a shield that reads observations, updated once for each decision. It assumes the noise of the sensor's own model.

    Parameters
    ----------
    env : a straight highway with a Kinematics observation of sorted rows, wrapped or not.
    distance : largest error of the estimate [m].

    Raises
    ------
    ConfigError
        If the rows are shuffled, because rows then have no fixed vehicle.
    """

    added_features = ("confidence",)

    def __init__(self, env: gym.Env[Any, Any], distance: float = 2.0) -> None:
        check_number("distance", distance, above=0.0)
        super().__init__(env, low=0.0)
        if env.unwrapped.observation_type.order != "sorted":  # type: ignore[attr-defined]
            raise ConfigError("TrackedConfidence needs sorted rows: set config['observation']['order'] to 'sorted'")
        self._distance, self._scenes = distance, ObservedScenes(env)

    def _forget(self) -> None:
        self._scenes.check()

    def _column(self, rows: Any, there: BoolArray) -> FloatArray:
        self._scenes.show(rows)
        self._scenes.read()
        # The perception is that of Kinematics: a channel accepts no other observation.
        tracks, column = cast(ObservationPerception, self._scenes.perception).tracks, np.zeros(len(rows))
        seen = tracks.missed == 0
        column[tracks.places[seen].astype(int)] = probability_within(tracks, self._distance)[seen]
        column[0] = 1.0
        return column


class Intent(_Channel):
    """Adds "intent": +1 for motion to the right (vy > 0.3 m/s), -1 to the left (vy < -0.3 m/s), 0 otherwise.

    vy is the feature of that name, converted to m/s in the world frame, without normalisation.

    Parameters
    ----------
    env : an environment of highway-env with a Kinematics observation, wrapped or not.
    threshold : least lateral speed [m/s].
    """

    added_features = ("intent",)

    def __init__(self, env: gym.Env[Any, Any], threshold: float = 0.3) -> None:
        check_number("threshold", threshold, least=0.0)
        super().__init__(env, low=-1.0)
        self._threshold = threshold

    def _column(self, rows: Any, there: BoolArray) -> FloatArray:
        vy = in_units(self.spec_shown, "vy", self._shown(rows)[:, STATE.index("vy")])
        if not self.spec_shown.absolute:
            vy[1:] += vy[0]
        return np.where(np.abs(vy) > self._threshold, np.sign(vy), 0.0)


CHANNELS = {"confidence": Confidence, "tracked-confidence": TrackedConfidence, "intent": Intent}
"""Channels by name, for `--sensor`: "normalised-0.5+confidence+intent"."""


def split_sensor(name: str) -> tuple[SensorModel, tuple[str, ...]]:
    """A sensor and its channels, in order.

    Parameters
    ----------
    name : name of one of `SENSORS`, followed by names of `CHANNELS` with a + before each.

    Raises
    ------
    ConfigError
        With the valid names.
    """
    check_sensor(name)
    sensor, *channels = name.split("+")
    return get_sensor(sensor), tuple(channels)


def seen_through(env: gym.Env[Any, Any], name: str) -> gym.Env[Any, Any]:
    """An environment with a sensor and channels; unchanged for the exact sensor without channels.

    Parameters
    ----------
    env : an environment of highway-env.
    name : as in `split_sensor`.
    """
    model, channels = split_sensor(name)
    if model != SensorModel():
        env = SensorNoise(env, model)
    for each in channels:
        env = CHANNELS[each](env)
    return env
