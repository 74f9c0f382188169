"""`Shield(policy)`: a drop-in for an SB3 model's `predict` that filters its actions."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dynamics.scenes.scene import SceneReader
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.doors.discrete_action import action_index
from shield.doors.input_door import InputDoor, refuse_lots
from shield.doors.ranking import order_from_scores, ranking_of
from shield.errors import ConfigError, PolicyError
from shield.procedures.decide import Core, read
from shield.procedures.meta_actions_only import MetaActionsOnly
from shield.procedures.screen import RuleAlone, Wish
from shield.procedures.warm_up import warm_up

__all__ = ["Shield"]

_log = logging.getLogger(__name__)


class Shield:
    """Wraps a policy; `predict` returns its action where that verifies, and an alternative otherwise.

    The shield reads the simulator's true state: the observation alone does not show who drives behind.

    Parameters
    ----------
    policy : an SB3 or sb3-contrib model, a bare `BasePolicy`, or any object with SB3's `predict()`.
    env : the environment(s) that the actions are meant for: a Gymnasium environment or a VecEnv. Without it the
        environment that the model carries is used.
    config : settings, or the path of a TOML file; by default `ShieldConfig.for_meta_actions()`, for throttle and
        steering `ShieldConfig()`.

    Raises
    ------
    PolicyError
        If `policy` has no `predict`.
    ConfigError
        If there is no environment to read the scene from, its actions are neither meta-actions nor continuous, or
        it is a parking lot and they are not continuous, or cannot brake; or if the settings cannot be read.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> class Faster:
    ...     def predict(self, obs, state=None, episode_start=None, deterministic=False):
    ...         return 3, state
    >>> env = gym.make("highway-fast-v0")
    >>> obs, _ = env.reset(seed=0)
    >>> shielded = Shield(Faster(), env=env)
    >>> action, _ = shielded.predict(obs)
    >>> shielded.last_decision.proposed
    3
    """

    def __init__(self, policy: Any, env: Any = None, config: ShieldConfig | str | Path | None = None) -> None:
        if not callable(getattr(policy, "predict", None)):
            raise PolicyError(
                f"{type(policy).__name__} has no predict(); pass an SB3 model, a BasePolicy, or an "
                "object with predict(obs, state, episode_start, deterministic)"
            )
        self.policy = policy
        if env is None:
            env = policy.get_env() if callable(getattr(policy, "get_env", None)) else None
        if env is None:
            raise ConfigError(
                "Shield needs the environment to read the scene from: pass Shield(policy, env=env), "
                "or load the model with its environment, PPO.load(path, env=env)"
            )
        self._env = env
        bases = _base_environments(env)
        kinds = {type(getattr(base, "action_type", None)).__name__ for base in bases}
        if len(kinds) != 1 or not kinds <= {"DiscreteMetaAction", "ContinuousAction"}:
            raise ConfigError(
                f"Shield filters DiscreteMetaAction or ContinuousAction; this environment has "
                f"{', '.join(sorted(kinds))}. "
                'Pass config={"action": {"type": "DiscreteMetaAction"}} to gym.make'
            )
        if kinds != {"ContinuousAction"}:
            refuse_lots(bases)
        self._readers = [SceneReader(base) for base in bases]
        self._doors: list[InputDoor] = []
        if kinds == {"ContinuousAction"}:
            self.config = ShieldConfig.of(config)
            self._doors = [InputDoor(base, self.config, agent=True) for base in bases]
            self._cores: list[Core[Any]] = [door.core for door in self._doors]
        else:
            self.config = ShieldConfig.of(config, ShieldConfig.for_meta_actions())
            alone = self.config.mode in ("distance", "rss", "ttc")
            procedure: Any = (RuleAlone if alone else MetaActionsOnly)(self.config)
            self._cores = [Core(procedure) for _ in bases]
        warm_up()
        self._roads: list[Any] = [None] * len(bases)
        self.last_decisions: list[Decision] = []

    @property
    def last_decision(self) -> Decision | None:
        """The decision of the last `predict` (of the first environment, where there are several)."""
        return self.last_decisions[0] if self.last_decisions else None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "policy":
            raise AttributeError(name)
        return getattr(self.policy, name)

    def reset(self) -> None:
        """Forget everything; done by itself when an environment starts a new episode."""
        for core in self._cores:
            core.reset()
        self.last_decisions = []

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """SB3's `predict`, with the actions filtered.

        Parameters
        ----------
        observation : one observation, or a batch with one row per environment.
        state, episode_start, deterministic : passed through to the policy.

        Returns
        -------
        The action (same shape as the policy's) and the policy's state.

        Raises
        ------
        ConfigError
            If a batch has not one row per environment.
        """
        reason: Reason | None = None
        proposals: Any
        size = self._doors[0].actuators.size if self._doors else 1
        try:
            proposals, state = self.policy.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except Exception:
            _log.exception("the policy raised; the fallback acts")
            # A policy that breaks must not take the car with it: the record says that it did.
            space, seen = self._env.observation_space, observation
            if isinstance(seen, dict) and seen:
                key = next(iter(seen))
                space, seen = space[key], seen[key]
            batched = np.ndim(seen) > len(space.shape or ()) or hasattr(self._env, "single_action_space")
            shape = (len(self._cores),) if batched else ()
            proposals = np.full((*shape, size) if self._doors else shape, np.nan)
            reason = Reason.POLICY_FAILED
        flat = np.asarray(proposals).reshape(-1)
        if flat.size != len(self._cores) * size:
            raise ConfigError(
                f"the policy returned {flat.size / size:g} actions for {len(self._cores)} environments; a batch "
                "needs one row per environment"
            )
        if self._doors:
            return self._predict_inputs(np.asarray(proposals), reason), state
        if reason is None and flat.dtype.kind == "f" and not np.isfinite(flat).all():
            reason = Reason.POLICY_FAILED
        ranking = _Ranking(self.policy, observation)
        self.last_decisions = [self._decide(i, p, ranking, reason) for i, p in enumerate(flat)]
        executed = np.array([d.executed for d in self.last_decisions], dtype=np.int64)
        return executed.reshape(np.shape(proposals)), state

    def _predict_inputs(self, proposals: Any, reason: Reason | None) -> Any:
        """Filter continuous actions; where all of them verify, what is returned is the policy's own array."""
        rows = proposals.reshape(len(self._doors), -1)
        self.last_decisions = []
        for door, reader, row in zip(self._doors, self._readers, rows, strict=True):
            i = len(self.last_decisions)
            if reader.road is not self._roads[i]:
                self._roads[i] = reader.road
                door.reset()
            decision = door.decide(row)
            if reason is not None and decision.reason is Reason.BAD_ACTION:
                decision = replace(decision, reason=reason)
            self.last_decisions.append(decision)
        if not any(d.overridden for d in self.last_decisions):
            return proposals
        # Whole numbers cannot hold what was verified.
        kind = proposals.dtype if proposals.dtype.kind == "f" else np.dtype(np.float32)
        executed = [np.asarray(d.executed, dtype=kind).reshape(-1) for d in self.last_decisions]
        return np.stack(executed).reshape(proposals.shape)

    def _decide(self, i: int, proposal: Any, ranking: _Ranking, reason: Reason | None) -> Decision:
        core, reader = self._cores[i], self._readers[i]
        start, proposed, labels = perf_counter(), action_index(proposal), reader.actions
        if self.config.mode == "none":
            return Decision(proposal, proposal if proposed < 0 else proposed, Reason.NONE, Tier.OFF, np.nan, 0.0)
        if reader.road is not self._roads[i]:
            self._roads[i] = reader.road
            core.reset()
        wish = Wish(proposed, labels, lambda: ranking.order(i, proposed, len(labels)))
        decision = core.decide(read(reader), wish)
        if reason is not None and decision.reason is Reason.BAD_ACTION:
            decision = replace(decision, reason=reason)
        shown = proposal if proposed < 0 else proposed
        return replace(decision, proposed=shown, latency=perf_counter() - start)


class _Ranking:
    """The policy's order of preference for one batch of observations, asked for at most once."""

    def __init__(self, policy: Any, observation: Any) -> None:
        self._policy, self._observation = policy, observation
        self._scores: Any = None

    def order(self, row: int, proposed: int, actions: int) -> list[int] | None:
        if self._scores is None:
            self._scores = (ranking_of(self._policy, self._observation),)
        scores = self._scores[0]
        if scores is None or np.atleast_2d(scores).shape[1] != actions:
            return None
        return order_from_scores(np.atleast_2d(scores)[row], proposed)


def _base_environments(env: Any) -> list[Any]:
    """The highway-env environments inside `env`, innermost."""
    if not hasattr(env, "num_envs"):
        return [env.unwrapped]
    inner = getattr(env, "envs", None)
    if inner is not None:
        return [e.unwrapped for e in inner]
    raise ConfigError(
        f"{type(env).__name__} keeps its environments in other processes, where Shield cannot read "
        "the scene; put the shield inside instead: SubprocVecEnv([lambda: ShieldedEnv(gym.make(...))])"
    )
