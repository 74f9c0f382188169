"""`ShieldedLookaheadPolicy`: beam search over the actions that the shield permits, in the simulator's future."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym

from dynamics.highway_simulator.simulator import Simulator
from mpc.lookahead_policy import LookaheadPolicy
from shield.batch.highways import ShieldedHighways
from shield.batch.observing import reset_memory
from shield.config import ShieldConfig

__all__ = ["ShieldedLookaheadPolicy"]


class ShieldedLookaheadPolicy(LookaheadPolicy):
    """Beam search over proposals to the shield, which decides in each future.

    The certificate restricts the actions, and the look-ahead optimises among them. It reads the simulator's true state.
    It does not read the shield's memory, and begins each search with an empty one.

    Parameters
    ----------
    env, depth, beam : as in `LookaheadPolicy`.
    shield : settings, or the path of a TOML file with them (see `ShieldedHighways`).

    Examples
    --------
    >>> from dynamics.highway_simulator.env import CompiledHighwayEnv
    >>> from shield import ShieldedEnv
    >>> env = CompiledHighwayEnv("highway-fast-v0")
    >>> policy, shielded = ShieldedLookaheadPolicy(env, depth=2, beam=3), ShieldedEnv(env)
    >>> obs, _ = shielded.reset(seed=0)
    >>> int(policy.predict(obs)[0])
    3
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        depth: int = 10,
        beam: int = 24,
        shield: ShieldConfig | str | Path | None = None,
    ) -> None:
        self._shield = ShieldConfig.of(shield)
        super().__init__(env, depth, beam)

    def _futures(self, env_id: str, count: int, config: Any) -> Any:
        return ShieldedHighways(env_id, count, config, self._shield)

    def _copy(self, source: Any, target: Any, rows: Any, to: Any) -> None:
        super()._copy(source, target, rows, to)
        for a, b in zip(source.shields, target.shields, strict=True):
            b[to] = a[rows]

    def _begin(self, start: Simulator, parents: Any) -> None:
        super()._begin(start, parents)
        reset_memory(parents.shields, 0)
