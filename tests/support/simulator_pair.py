"""highway-env and its compiled copy, driven side by side: an error names the first number that differs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle

from dynamics.highway_simulator import layout
from dynamics.highway_simulator.random import from_generator
from dynamics.highway_simulator.simulator import Simulator
from dynamics.traffic.mixed import WithTrucks

__all__ = [
    "DRIVERS",
    "SMALL",
    "Brisk",
    "Hesitant",
    "Pair",
    "Polite",
    "Quadratic",
    "Truck",
    "drive",
    "same_numbers",
    "wild_action",
]

TOLERANCE = 1e-9
"""How well states agree where the sums of numpy are not known (`Simulator.exact`)."""


def same_numbers(real: Any, mine: Any, exact: bool) -> bool:
    """Whether two numbers, or arrays of them, are the same: to the bit, NaN being NaN, or else to 1e-9."""
    real, mine = np.asarray(real), np.asarray(mine)
    if real.shape != mine.shape:
        return False
    if not exact:
        return bool(np.allclose(real.astype(float), mine.astype(float), rtol=0, atol=TOLERANCE, equal_nan=True))
    same = (real == mine) & (np.signbit(real) == np.signbit(mine)) if real.dtype.kind == "f" else real == mine
    return bool((same | ((real != real) & (mine != mine))).all())


def wild_action(space: gym.Space[Any], rng: np.random.Generator, dtype: Any = np.float32, scale: float = 1.0) -> Any:
    """An action of either space; continuous ones up to `scale`, which the space may not contain."""
    if isinstance(space, gym.spaces.Discrete):
        return int(rng.integers(space.n))
    return rng.uniform(-scale, scale, space.shape).astype(dtype)


class Pair:
    """Environments of highway-env, and a simulator of as many copies.

    Parameters
    ----------
    env_id, config : as of `gym.make`.
    num_envs : how many there are.
    """

    def __init__(self, env_id: str, config: Mapping[str, Any] | None = None, num_envs: int = 1) -> None:
        given = {} if config is None else {"config": dict(config)}
        self.envs = [gym.make(env_id, **given) for _ in range(num_envs)]
        self.simulator = Simulator(env_id, num_envs, config)
        self._start(f"{env_id} {dict(config or {})}")

    @classmethod
    def of(cls, env: gym.Env[Any, Any]) -> Pair:
        """A live environment, and a simulator that starts from its scene."""
        pair = cls.__new__(cls)
        pair.envs, pair.simulator = [env], Simulator.of(env)
        pair._start("live scene")
        pair.compare_states()
        return pair

    def _start(self, name: str) -> None:
        self.name, self.decision = name, 0
        self.seeds: list[int | None] = [None] * len(self.envs)

    def close(self) -> None:
        for env in self.envs:
            env.close()

    def reset(self, seeds: Sequence[int] | None = None) -> None:
        """Reset both, and compare all that there is; without seeds the generators go on."""
        self.decision = 0
        if seeds is not None:
            self.seeds = list(seeds)
        observations = self.simulator.reset(seeds)
        for e, env in enumerate(self.envs):
            observation, _ = env.reset(seed=None if seeds is None else int(seeds[e]))
            self._compare_bodies(e)
            self._same(e, None, "observation", observation, observations[e])
            self._compare_rest(e)

    def step(self, actions: Sequence[Any], again: bool = False) -> list[bool]:
        """A decision of both, compared; whether episodes are over. With `again` they have new ones then."""
        self.decision += 1
        observations, reward, terminated, truncated = self.simulator.step(np.asarray(actions), again=again)
        over = []
        for e, (env, action) in enumerate(zip(self.envs, actions, strict=True)):
            observation, real_reward, end, late, info = env.step(action)
            over.append(bool(end or late))
            if again and over[e]:
                self._same(e, None, "terminal observation", observation, self.simulator.seen.terminal[e])
                observation, _ = env.reset()
            self._compare_bodies(e)
            self._same(e, None, "terminated", bool(end), bool(terminated[e]))
            self._same(e, None, "truncated", bool(late), bool(truncated[e]))
            parts = np.array([float(part) for part in info["rewards"].values()])
            self._same(e, None, "parts of the reward", parts, self.simulator.seen.parts[e])
            self._same(e, None, "reward", float(real_reward), float(reward[e]))
            self._same(e, None, "observation", observation, observations[e])
            self._compare_rest(e)
        return over

    def drive(
        self, decisions: int, rng: np.random.Generator, again: bool = False, beyond: bool = True, **wild: Any
    ) -> int:
        """So many decisions with random actions; how many were made.

        Parameters
        ----------
        beyond : whether to drive on after the end of an episode. wild : of `wild_action`.
        """
        for k in range(decisions):
            actions = [wild_action(env.action_space, rng, **wild) for env in self.envs]
            if any(self.step(actions, again=again)) and not beyond and not again:
                return k + 1
        return decisions

    def compare_states(self) -> None:
        """Compare every body, the clock and the generator of every environment."""
        for e in range(len(self.envs)):
            self._compare_bodies(e)
            self._compare_rest(e)

    def _compare_bodies(self, e: int) -> None:
        base: Any = self.envs[e].unwrapped
        f, g = self.simulator.worlds.f[e], self.simulator.worlds.g[e]
        bodies = [*base.road.vehicles, *base.road.objects]
        self._same(e, None, "number of bodies", len(bodies), f.shape[1])
        for i, body in enumerate(bodies):
            for name, real, mine in _fields(body, f[:, i], g[:, i]):
                self._same(e, i, name, real, mine)

    def _compare_rest(self, e: int) -> None:
        base: Any = self.envs[e].unwrapped
        self._same(e, None, "time", float(base.time), float(self.simulator.worlds.clock[e]))
        self._same(e, None, "generator", from_generator(base.np_random), self.simulator.worlds.rows[e])

    def _same(self, e: int, body: int | None, name: str, real: Any, mine: Any) -> None:
        exact = self.simulator.exact
        if same_numbers(real, mine, exact):
            return
        real, mine = np.asarray(real), np.asarray(mine)
        if real.shape != mine.shape:
            found = f"highway-env has shape {real.shape}, the simulator {mine.shape}"
        else:
            at = next(at for at in np.ndindex(real.shape) if not same_numbers(real[at], mine[at], exact))
            name += str(list(at)) if at else ""
            found = f"highway-env has {_shown(real[at])}, the simulator {_shown(mine[at])}"
        who = "" if body is None else f"vehicle {body}, "
        raise AssertionError(
            f"seed {self.seeds[e]}, copy {e}, decision {self.decision}, {who}{name}: {found}; {self.name}"
        )


def _fields(body: Any, f: Any, g: Any) -> Iterator[tuple[str, Any, Any]]:
    """Name, highway-env's value and the simulator's, of everything that a body has."""
    yield "x", float(body.position[0]), float(f[layout.X])
    yield "y", float(body.position[1]), float(f[layout.Y])
    yield "heading", float(body.heading), float(f[layout.HEADING])
    yield "speed", float(body.speed), float(f[layout.SPEED])
    yield "cosine of the heading", float(np.cos(body.heading)), float(f[layout.COS])
    yield "sine of the heading", float(np.sin(body.heading)), float(f[layout.SIN])
    yield "lane", int(body.lane_index[2]), int(g[layout.LANE])
    yield "crashed", bool(body.crashed), bool(g[layout.CRASHED])
    yield "check_collisions", bool(body.check_collisions), bool(g[layout.CHECKS])
    if hasattr(body, "action"):
        # Of a body that stands still or drives straight ahead one may have the other's zero.
        yield "steering", float(body.action["steering"]) + 0.0, float(f[layout.STEERING]) + 0.0
        yield "acceleration", float(body.action["acceleration"]) + 0.0, float(f[layout.ACCELERATION]) + 0.0
        yield "has an impact", body.impact is not None, bool(g[layout.IMPACTED])
        if body.impact is not None:
            yield "impact", np.asarray(body.impact), f[[layout.IMPACT_X, layout.IMPACT_Y]]
    if hasattr(body, "target_lane_index"):
        yield "target lane", int(body.target_lane_index[2]), int(g[layout.TARGET])
        yield "target speed", float(body.target_speed), float(f[layout.TARGET_SPEED])
    if hasattr(body, "timer"):
        yield "timer", float(body.timer), float(f[layout.TIMER])


def _shown(value: Any) -> str:
    number = np.asarray(value).item()
    return f"{number!r} ({number.hex()})" if isinstance(number, float) else repr(number)


class Truck(IDMVehicle):
    """Long, wide and slow."""

    LENGTH, WIDTH, MAX_SPEED, ACC_MAX, COMFORT_ACC_MAX = 12.0, 2.5, 24.0, 3.0, 1.5


class Polite(IDMVehicle):
    """Counts the gains and losses of other vehicles."""

    POLITENESS, LANE_CHANGE_MIN_ACC_GAIN, LANE_CHANGE_MAX_BRAKING_IMPOSED = 0.7, 0.05, 4.0


class Hesitant(IDMVehicle):
    """Thinks about its lane at other times than once a second."""

    LANE_CHANGE_DELAY = 2.3


class Quadratic(IDMVehicle):
    """An exponent that numpy has a product for."""

    DELTA_RANGE = (2.0, 2.0)


class Brisk(LinearVehicle):
    """Linear, with other constants."""

    LENGTH, TIME_WANTED, DISTANCE_WANTED, POLITENESS, ACC_MAX = 4.0, 1.2, 7.0, -0.3, 9.0


DRIVERS = (
    *(f"highway_env.vehicle.behavior.{name}Vehicle" for name in ("IDM", "Linear", "Aggressive", "Defensive")),
    *(f"{kind.__module__}.{kind.__name__}" for kind in (Truck, Polite, Hesitant, Quadratic, Brisk, WithTrucks)),
)
"""Paths of traffic: highway-env's, and classes that change only constants."""


SMALL: dict[str, Any] = {"vehicles_count": 6, "lanes_count": 3, "vehicles_density": 2.0}
"""A road that takes no time."""


def drive(
    config: dict[str, Any],
    seeds: Sequence[int] = (0, 1),
    decisions: int = 15,
    env_id: str = "highway-fast-v0",
    **wild: Any,
) -> None:
    """Compare so many decisions of an episode for each seed; those after its end too."""
    pair = Pair(env_id, {**SMALL, **config})
    for seed in seeds:
        pair.reset([seed])
        pair.drive(decisions, np.random.default_rng(seed), **wild)
    pair.close()
