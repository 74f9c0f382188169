"""`Shield(policy)`: a drop-in for an SB3 model's `predict` that filters its actions."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynamics.deprecation import warn_of_former_name
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Verification
from shield.environments import base_environments, frames_of
from shield.errors import ConfigError
from shield.filters.discrete_action import action_index
from shield.filters.inputs import InputFilter
from shield.filters.meta_actions import MetaActionFilter
from shield.filters.simulated.inputs import SimulatedInputFilter
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter
from shield.filters.supervision import Command, Supervision
from shield.perception.environment_free import EnvironmentFreeScenes
from shield.perception.known import Known
from shield.perception.perceiving import PerceptionConfig
from shield.perception.unwrapping import undo_vec_wrappers
from shield.wrappers.action_rows import ActionRows, as_numbers
from shield.wrappers.action_type import action_type_name
from shield.wrappers.defaults import ChosenSettings, SettingsContext, as_settings, choose_settings
from shield.wrappers.failure_limit import ActionWarning, FailureLimit
from shield.wrappers.filter_choice import Filter, filter_for
from shield.wrappers.known_environments import prior_maps
from shield.wrappers.policy_adapters import as_policy, refuse_misfits
from shield.wrappers.ranking import Ranking
from shield.wrappers.report import Statistics, ViolationCount, report
from shield.wrappers.stale_environment import StaleEnvironmentCheck
from shield.wrappers.warm_filters import warm_up_filter
from shield.wrappers.wrapped_policy import WrappedPolicy

__all__ = ["Shield"]

_log = logging.getLogger(__name__)


class _PolicyOutput(NamedTuple):
    """A policy's output: its actions and its state; the reason and the cause of a failure."""

    actions: Any
    state: Any
    reason: Reason | None
    cause: str = ""


class Shield(WrappedPolicy):
    """Wraps a policy; `predict` returns its action if that verifies, and an alternative otherwise.

    The shield reads the simulator's true state unless `perception` is set: observations do not show vehicles behind. It
    also supervises each simulation frame between two calls of `predict`, as `ShieldedEnv` does, because a meta-action
    lasts for many frames.

    Parameters
    ----------
    policy : an SB3 or sb3-contrib model, a bare `BasePolicy`, any object with SB3's `predict()`, a `torch.nn.Module`
        (scores of the actions, or continuous ones), or a function of the observation.
    env : the environment(s) that the actions are for: a Gymnasium environment or a VecEnv. By default the environment
        of the model; `predict` raises if another one is driven. A VecEnv of other processes requires
        `perception="observation"` and `frames=False`; it is queried once for its configuration.
    config : settings, the path of a TOML file, "simulated" or "worst-case"; the default as of `ShieldedEnv`. In the
        worst case, meta-actions without `frames` have `ShieldConfig.for_meta_actions()`.
    frames : whether the frames between two decisions are supervised. Without supervision `Shield` changes nothing but
        the result of `predict`, and its assumptions have to hold for seconds ahead. With
        `ShieldConfig.simulated_traffic()` it simulates the traffic instead; meta-actions then need no supervision.
    perception : source of the scenes. "simulator": its true state. "observation": the observations that `predict` gets
        only, for the traffic (Kinematics, grids; meta-actions, a highway), and the environment's observations at the
        frames between. A `PerceptionConfig` has the settings of the latter.
    known : prior map of the environment, or of each of several. Then the observations that `predict` gets are the only
        other source, and `env` may be None. It requires "observation" with `frames=False`; highways in other processes
        are queried for it (`Known.of`). Each `predict` counts as the next decision; `episode_start`, or `reset()`,
        marks the beginning of an episode.

    Raises
    ------
    PolicyError
        If `policy` is none of these, or was made for other observations or actions.
    ConfigError
        If there is no highway-env environment to read the scene from, or it is shielded already. If its actions are
        neither meta-actions nor continuous. If it is a parking lot with other actions than continuous ones, or with
        actions that cannot brake. If the settings cannot be read.
    SceneError
        If its road is not supported.

    Attributes
    ----------
    decisions : the decisions of the last `predict` about the actions alone, one for each environment.
    frame_decisions : those about the frames since, a list for each environment. Both together are `last_decisions`.

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

    def __init__(
        self,
        policy: Any,
        env: Any = None,
        config: ShieldConfig | str | Path | None = None,
        frames: bool = True,
        perception: str | PerceptionConfig = "simulator",
        known: Known | Sequence[Known] | None = None,
    ) -> None:
        if env is None:
            env = policy.get_env() if callable(getattr(policy, "get_env", None)) else None
        if env is None and known is None:
            raise ConfigError(
                "Shield needs the environment to read the scene from: pass Shield(policy, env=env), "
                "or load the model with its environment, PPO.load(path, env=env)"
            )
        self._env = env
        self._known = prior_maps(env, known, frames, perception)
        self.policy = as_policy(policy, env)
        self._frames = frames
        self._filters: list[Filter]
        self._bases: list[Any]
        if self._known:
            self._bases, self._inputs = [None] * len(self._known), False
        else:
            self._bases = base_environments(env, "Shield")
            self._inputs = action_type_name(self._bases, "Shield") == "ContinuousAction"
        refuse_misfits(self.policy, env)
        self._given, self._perception = as_settings(config), perception
        n, self._recording = len(self._bases), False
        self._chosen = [self._settings(i) for i in range(n)]
        if self._known:
            settings = perception if isinstance(perception, PerceptionConfig) else None
            scenes = [EnvironmentFreeScenes(one, settings) for one in self._known]
            self._filters = [MetaActionFilter(None, self.config, frames=False, scenes=each) for each in scenes]
            warm_up_filter(self._filters[0])
        else:
            self._filters = [self._made(i) for i in range(n)]
        self._roads: list[Any] = [None] * n
        self._decided = [0] * n
        self._failure_limits = [FailureLimit(self.config.failure_limit) for _ in self._bases]
        self._action_warning = ActionWarning()
        self._alive = [StaleEnvironmentCheck(base) for base in self._bases if base is not None]
        self._supervisions: list[Supervision | None] = [None] * n
        self._counted = [ViolationCount(action_filter) for action_filter in self._filters]
        self._statistics = Statistics()
        self.decisions: list[Decision] = []
        self.frame_decisions: list[list[Decision]] = [[] for _ in range(n)]

    def _settings(self, i: int) -> ChosenSettings:
        """The given settings, or the default for environment `i`."""
        observes = bool(self._known) or self._perception != "simulator"
        return choose_settings(self._given, SettingsContext(self._bases[i], self._inputs, self._frames, observes))

    def _made(self, i: int) -> Filter:
        """The filter for environment `i` with its chosen settings."""
        chosen = self._chosen[i]
        action_filter = filter_for(
            getattr(self._env, "envs", [self._env])[i],
            chosen.config,
            inputs=self._inputs,
            frames=self._frames,
            perception=self._perception,
        )
        # Last, because the filter's own refusals apply with frames too.
        if chosen.config.simulates and self._inputs and not self._frames:
            raise ConfigError(
                "Assumptions.simulated_traffic() verifies throttle and steering at every frame: frames=True"
            )
        warm_up_filter(action_filter)
        if self._recording:
            action_filter.record()
        if i == 0:
            chosen.announce()
        return action_filter

    def record(self) -> None:
        """Keep in each later decision the data for films and overlays, as with `ShieldConfig.record`."""
        self._recording = True
        for action_filter in self._filters:
            action_filter.record()

    @property
    def filters(self) -> tuple[Filter, ...]:
        """The filter of each environment; its class determines the kind of verification."""
        return tuple(self._filters)

    @property
    def doors(self) -> tuple[Filter, ...]:
        """The former name of `filters`."""
        warn_of_former_name("Shield.doors", "write Shield.filters")
        return self.filters

    @property
    def config(self) -> ShieldConfig:
        """The settings (of the first environment, if there are several)."""
        return self._chosen[0].config

    @property
    def verification(self) -> Verification:
        """What actions are verified against (in the first environment, if there are several)."""
        return self._chosen[0].verification

    @property
    def promise(self) -> str:
        """Meaning of the verification, in a sentence."""
        return self._chosen[0].promise

    @property
    def last_decisions(self) -> list[Decision]:
        """The record of the step since the last `predict`, of each environment: the decision and its frames so far
        (`Decision.with_frames`)."""
        return [each.with_frames(self.frame_decisions[i]) for i, each in enumerate(self.decisions)]

    @property
    def last_decision(self) -> Decision | None:
        """The record of the first environment in `last_decisions`, from which `report()` is read; None before the first
        `predict`."""
        return self.last_decisions[0] if self.decisions else None

    def report(self, i: int = 0) -> dict[str, Any]:
        """Content of `info["shield"]` in `ShieldedEnv`, of environment `i` since the last `predict`.

        Raises
        ------
        ConfigError
            If `predict` has not been called.
        """
        if not self.decisions:
            raise ConfigError("report() is about the last decision; call predict() first")
        base = self._bases[i]
        same = base is not None and base.road is self._roads[i]
        if same and base.steps >= self._decided[i] + frames_of(base):
            # All frames of the decision are over, and perhaps no later decision runs the monitor on the last one.
            self._filters[i].monitor_last_frame()
        offences = self._counted[i].since(self._filters[i])
        reported = report(self.decisions[i].with_frames(self.frame_decisions[i]), *offences)
        return {**reported, "verification": self._chosen[i].verification.value}

    @property
    def statistics(self) -> Statistics:
        """Totals of all environments since this shield was made."""
        statistics = deepcopy(self._statistics)
        for i in range(len(self.decisions)):
            statistics.add(self.report(i), self._latency(i))
        return statistics

    @property
    def latency(self) -> float:
        """Total time of the shield since the last `predict`, without the policy's own [s]."""
        return sum(self._latency(i) for i in range(len(self.decisions)))

    def _latency(self, i: int) -> float:
        return sum(d.latency for d in (self.decisions[i], *self.frame_decisions[i]))

    def reset(self) -> None:
        """Clear everything about the episodes. Called automatically when an environment starts a new episode."""
        self._statistics = self.statistics
        for i, action_filter in enumerate(self._filters):
            action_filter.reset()
            self._unsupervise(i)
        self.decisions = []

    def _unsupervise(self, i: int) -> None:
        supervision, self._supervisions[i] = self._supervisions[i], None
        if supervision is not None:
            supervision.remove()

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
        state, episode_start, deterministic : passed to the policy.

        Returns
        -------
        The action (same shape as the policy's) and the policy's state.

        Raises
        ------
        ConfigError
            If there are several environments, and the policy returns another number of actions. (For a single
            environment, an output of the wrong shape is an invalid action. The fallback acts, and the record has
            `bad_action`.)
        SceneError
            If the observation has changed, but not the environment that the shield reads. If its road is not supported.
            If it could not be read in more than `ShieldConfig.failure_limit` consecutive decisions.
        PolicyError
            If the policy has failed in as many.
        """
        for i, alive in enumerate(self._alive):
            alive.check(_row(observation, i, len(self._alive)))
        proposed = self._propose(observation, state, episode_start, deterministic)
        size, whole = self._form
        actions = ActionRows.of(
            proposed.actions, len(self._filters), None if whole else size, self._batched(observation)
        )
        ranking = Ranking(self.policy, observation)
        for i in range(len(self._filters)):
            self._begin(i, episode_start)
        self._show(observation, episode_start is None)
        self.decisions = [self._decide(i, row, ranking, proposed.reason) for i, row in enumerate(actions.rows)]
        for failure_limit, decision, action_filter in zip(
            self._failure_limits, self.decisions, self._filters, strict=True
        ):
            failure_limit.check(decision, proposed.cause or action_filter.cause)
        self._action_warning.check(self.decisions, self._known[0] if self._known else self._bases[0])
        if self._inputs and not whole and not any(decision.overridden for decision in self.decisions):
            return proposed.actions, proposed.state
        return actions.answer([decision.executed for decision in self.decisions]), proposed.state

    @property
    def _form(self) -> tuple[int, bool]:
        """Number of values in an action, and whether it is a whole number."""
        first = self._filters[0]
        if not isinstance(first, InputFilter | SimulatedInputFilter):
            return 1, True
        return first.actuators.entries, first.actuators.choices is not None

    def _propose(self, observation: Any, state: Any, episode_start: Any, deterministic: bool) -> _PolicyOutput:
        """Output of the policy. An error of the policy becomes a reason in the record."""
        try:
            actions, state = self.policy.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except Exception as error:
            _log.debug("the policy raised", exc_info=True)
            shape = (len(self._filters),) if self._batched(observation) else ()
            nothing = np.full((*shape, self._form[0]) if self._inputs else shape, np.nan, np.float32)
            return _PolicyOutput(nothing, state, Reason.POLICY_FAILED, f"{type(error).__name__}: {error}")
        numbers = None if self._inputs else as_numbers(actions)
        broken = numbers is not None and numbers.dtype.kind == "f" and not np.isfinite(numbers).all()
        return _PolicyOutput(actions, state, Reason.POLICY_FAILED if broken else None)

    def _decide(self, i: int, proposal: Any, ranking: Ranking, reason: Reason | None) -> Decision:
        """Decision for environment `i`, with its frames supervised from now on."""
        action_filter, base = self._filters[i], self._bases[i]
        wanted: Any = None
        if not self._inputs:
            proposed, many = action_index(proposal), self._actions(i)
            wanted = lambda: ranking.order(i, proposed, many)  # noqa: E731
        self._decided[i] = 0 if base is None else int(base.steps)
        decision = action_filter.decide(proposal, wanted)
        if reason is not None and decision.reason is Reason.BAD_ACTION:
            decision = replace(decision, reason=reason)
        supervision = self._supervisions[i]
        if (
            self._frames
            and action_filter.supervising
            and (supervision is None or not supervision.supervises(base.vehicle))
        ):
            self._supervisions[i] = Supervision(base, lambda: self._frame(i)).install()
        return decision

    def _begin(self, i: int, episode_start: Any) -> None:
        """Add the last decision to the statistics, and clear the last episode if a new one has begun."""
        action_filter, base = self._filters[i], self._bases[i]
        if len(self.decisions) > i:
            self._statistics.add(self.report(i), self._latency(i))
        if base is None:
            if episode_start is not None and np.reshape(episode_start, -1)[i]:
                action_filter.reset()
        elif base.road is not self._roads[i]:
            self._roads[i] = base.road
            chosen = self._chosen[i] if isinstance(self._given, ShieldConfig) else self._settings(i)
            if chosen.config != self._chosen[i].config:
                self._unsupervise(i)
                self._chosen[i] = chosen
                self._filters[i] = action_filter = self._made(i)
            action_filter.reset()
        self._counted[i], self.frame_decisions[i] = ViolationCount(action_filter), []

    def _show(self, observation: Any, unsaid: bool) -> None:
        """Present each environment's observation to its scene reader. With `unsaid`, no caller marks the beginning of
        an episode."""
        if not isinstance(self._filters[0], MetaActionFilter) or not self._filters[0].observing:
            return
        shown, n = undo_vec_wrappers(self._env, observation), len(self._filters)
        if n > 1 and len(shown) != n:
            raise ConfigError(f"there are {len(shown)} observations for {n} environments; a batch has one row for each")
        for i, action_filter in enumerate(self._filters):
            assert isinstance(action_filter, MetaActionFilter)
            action_filter.show(_row(shown, i, n))
            if unsaid and action_filter.begins():
                action_filter.reset()
                self._counted[i] = ViolationCount(action_filter)
                action_filter.show(_row(shown, i, n))

    def _actions(self, i: int) -> int:
        return len(self._known[i].actions) if self._known else int(self._bases[i].action_space.n)

    def _batched(self, observation: Any) -> bool:
        """Whether an observation is of several environments, or a batch of one."""
        space, seen = getattr(self._env, "observation_space", None), observation
        if space is None:
            return len(self._filters) > 1 or _dimensions(seen) > len(self._known[0].shape)
        if isinstance(seen, dict) and seen:
            key = next(iter(seen))
            space, seen = space[key], seen[key]
        return _dimensions(seen) > len(space.shape or ()) or hasattr(self._env, "single_action_space")

    def _frame(self, i: int) -> Command:
        action_filter = self._filters[i]
        assert not isinstance(action_filter, SimulatedMetaActionFilter)
        command, decision = action_filter.frame()
        self.frame_decisions[i].append(decision)
        return command


def _dimensions(observation: Any) -> int:
    """Number of dimensions of an observation; 0 for rows of different lengths."""
    try:
        return np.ndim(observation)
    except (TypeError, ValueError):
        return 0


def _row(observation: Any, i: int, n: int) -> Any:
    """Observation of environment `i` of `n`."""
    if n == 1:
        return observation
    if isinstance(observation, dict):
        return {key: value[i] for key, value in observation.items()}
    return observation[i]
