"""`LookaheadPolicy`: drives with exact knowledge of the future, an upper reference for the value of good driving.

On a straight highway nothing is random after the reset. So the compiled copy of highway-env, started from the
simulator's true state, predicts every vehicle exactly for all actions of the ego. The policy searches these futures.
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np

from dynamics.errors import ConfigError
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.layout import HEADING, SPEED, TARGET, TARGET_SPEED, X, Y
from dynamics.highway_simulator.simulator import Simulator
from dynamics.highway_simulator.step_kernels import first_equal_actions
from dynamics.state import FloatArray, IntArray

__all__ = ["LookaheadPolicy"]

_CRASH = -100.0
"""Value added for an episode that ends in a crash."""
_KEY = (X, Y, HEADING, SPEED, TARGET_SPEED)


class LookaheadPolicy:
    """Beam search over meta-actions in the exact future; reads the simulator's true state.

    Parameters
    ----------
    env : `highway-v0` or `highway-fast-v0` with `DiscreteMetaAction`: highway-env's own, or a `CompiledHighwayEnv`.
    depth : number of decisions of the horizon.
    beam : largest number of futures that are kept from each decision to the next.

    Raises
    ------
    ConfigError
        If the compiled highway does not support the environment, or its actions are not meta-actions.

    Examples
    --------
    >>> env = CompiledHighwayEnv("highway-fast-v0")
    >>> obs, _ = env.reset(seed=0)
    >>> action, _ = LookaheadPolicy(env, depth=3, beam=4).predict(obs)
    >>> int(action)
    3
    """

    def __init__(self, env: gym.Env[Any, Any], depth: int = 10, beam: int = 24) -> None:
        if depth < 1 or beam < 1:
            raise ConfigError(f"depth and beam must be at least 1, not {depth} and {beam}")
        self._env, self.depth, self.beam = env, depth, beam
        base = cast(Any, env.unwrapped)
        if type(base.action_type).__name__ != "DiscreteMetaAction":
            raise ConfigError(
                f"look-ahead chooses meta-actions; this environment has {type(base.action_type).__name__}"
            )
        self._actions = int(base.action_space.n)
        if isinstance(base, CompiledHighwayEnv):
            self._pool(base.simulator.scenario.env_id, base.config)
        else:
            self._pool(base.spec.id, base.config)

    def _pool(self, env_id: str, config: Any) -> None:
        self._live = Simulator(env_id, 1, config)
        self._parents: Any = self._futures(env_id, self.beam, config)
        self._children: Any = self._futures(env_id, self.beam * self._actions, config)
        self._spare = np.zeros((self._actions + 1, 2))

    def _futures(self, env_id: str, count: int, config: Any) -> Any:
        """A batch of `count` futures, with `worlds`, `num_envs` and `step_first` of a `Simulator`."""
        return Simulator(env_id, count, config)

    def _copy(self, source: Any, target: Any, rows: Any, to: Any) -> None:
        """Copy some futures into others."""
        for a, b in zip(source.worlds, target.worlds, strict=True):
            b[to] = a[rows]

    def _begin(self, start: Simulator, parents: Any) -> None:
        """Copy the present state into the first future."""
        for a, b in zip(start.worlds, parents.worlds, strict=True):
            b[0] = a[0]

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The first action of the best future; the observation is ignored."""
        return np.asarray(int(self.action_scores(observation).argmax())), state

    def action_scores(self, observation: Any) -> FloatArray:
        """Value of the best future after each action, (actions,): its rewards, and the penalty of a crash."""
        start = self._start()
        parents, children, n = self._parents, self._children, 1
        self._begin(start, parents)
        values, first = np.zeros(1), np.full(1, -1)
        best = np.full(self._actions, -np.inf)
        for level in range(self.depth):
            # Expand every future by every action with a distinct result.
            source, tried = (self._alike(parents, n) == np.arange(self._actions)).nonzero()
            self._copy(parents, children, source, np.arange(len(source)))
            given = np.zeros(children.num_envs, np.int64)
            given[: len(tried)] = tried
            _, reward, terminated, truncated = children.step_first(given, len(tried))
            worth = values[source] + reward[: len(tried)]
            crashed, over = terminated[: len(tried)].copy(), (terminated | truncated)[: len(tried)]
            worth[crashed] += _CRASH + level
            begun = tried if level == 0 else first[source]
            last = level == self.depth - 1
            for i in np.flatnonzero(over | last):
                best[begun[i]] = max(best[begun[i]], worth[i])
            going = np.flatnonzero(~over)
            if last or not len(going):
                break
            kept = self._kept(going, worth, begun)
            self._copy(children, parents, kept, np.arange(len(kept)))
            values, first, n = worth[kept], begun[kept], len(kept)
        found: FloatArray = best[self._alike(start, 1)[0]]
        return found

    def _alike(self, futures: Any, n: int) -> IntArray:
        """For each action the first one with the same result, in each of the first n futures, (n, actions)."""
        first = np.empty((n, self._actions), np.intp)
        first_equal_actions(futures.worlds, self._live.scenario.rules, n, self._spare, first)
        return first

    def _kept(self, going: Any, worth: FloatArray, begun: Any) -> Any:
        """The futures to keep, without duplicates, taking the best of each group in turn."""
        worlds = self._children.worlds
        order = going[np.argsort(-worth[going], kind="stable")]
        keys = np.concatenate(
            [worlds.f[order][:, _KEY, 0], worlds.g[order][:, [TARGET], 0], begun[order][:, None]], axis=1
        )
        _, unique = np.unique(keys, axis=0, return_index=True)
        order = order[np.sort(unique)]
        # A group has one first action, target lane and target speed; its next members follow in later turns.
        groups = np.stack([begun[order], worlds.g[order, TARGET, 0], worlds.f[order, TARGET_SPEED, 0]], axis=1)
        _, group = np.unique(groups, axis=0, return_inverse=True)
        turn = np.zeros(len(order), np.int64)
        for each in range(group.max() + 1):
            members = np.flatnonzero(group == each)
            turn[members] = np.arange(len(members))
        return order[np.argsort(turn, kind="stable")][: self.beam]

    def _start(self) -> Simulator:
        """The simulator's true state now."""
        base = cast(Any, self._env.unwrapped)
        if isinstance(base, CompiledHighwayEnv):
            return base.simulator
        self._live.load(base)
        return self._live
