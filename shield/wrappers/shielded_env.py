"""`ShieldedEnv`: the shield between the decision and the actuators, at every simulation frame."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from dynamics.deprecation import warn_of_former_name
from shield.config import ShieldConfig
from shield.decision import Decision, Verification
from shield.environments import base_environments, check_step
from shield.errors import ConfigError, SceneError
from shield.filters.discrete_action import action_index
from shield.filters.inputs import InputFilter
from shield.filters.meta_actions import MetaActionFilter
from shield.filters.network import NetworkFilter
from shield.filters.simulated.inputs import SimulatedInputFilter
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter
from shield.filters.simulated.multi_agent import MultiAgentFilter, is_multi_agent
from shield.filters.supervision import Command, Supervision
from shield.perception.perceiving import PerceptionConfig
from shield.perception.scenes import NO_OBSERVED_SCENES
from shield.pipelines.decide import DecisionCore
from shield.rules import Rule
from shield.wrappers.action_type import action_type_name
from shield.wrappers.defaults import ChosenSettings, SettingsContext, as_settings, choose_settings
from shield.wrappers.failure_limit import ActionWarning, FailureLimit
from shield.wrappers.filter_choice import Filter, filter_for
from shield.wrappers.policy_adapters import as_policy, refuse_misfits
from shield.wrappers.ranking import normalised, order_from_scores, ranking_of
from shield.wrappers.report import Statistics, ViolationCount, multi_agent_record, multi_agent_report, report
from shield.wrappers.warm_filters import warm_up_filter

if TYPE_CHECKING:
    from mpc.filter.program.road_step import StageModel

__all__ = ["ShieldedEnv"]


class ShieldedEnv(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wraps a highway-env environment with meta-actions or continuous ones; reads the simulator's true state.

    At each decision the proposed meta-action is verified and, if need be, replaced. Between two decisions every
    simulation frame is supervised. If the target command does not verify any more, an acceleration cap or the present
    lane replaces it for the frame. Throttle and steering are verified at every frame, and replaced by the nearest
    inputs that verify.

    With `ShieldConfig.simulated_traffic()` the traffic is simulated instead, on every road with known traffic. Then
    meta-actions are verified at each decision, and throttle and steering at every frame. Several egos with meta-actions
    (`MultiAgentAction`) are verified together; `step` then takes a tuple of actions.

    Parameters
    ----------
    env : the environment: with meta-actions on any road; with continuous actions on straight highways, racetracks and
        parking lots, and with `ShieldConfig.simulated_traffic()` on every other road.
    config : settings, the path of a TOML file with them, "simulated" (`ShieldConfig.simulated_traffic()`) or
        "worst-case". By default highway-env's own traffic is simulated on road networks, with several egos, and with
        tyre slip. Elsewhere, and with unknown traffic, actions are verified against the worst case. A line in the log
        of "shield" states the promise, as a warning if the traffic is unknown.
    policy : if given, alternatives are tried in its order of preference (probabilities or Q-values of the last
        observation).
    model : model of the predictive filter for `ContinuousAction`, such as
        `dynamics.learned.models.casadi_steps.LearnedSteps`; the bicycle by default. All plans are verified with the
        bicycle.
    rule : a user's own rule (`shield.rules.Rule`), which decides alone, as in the modes of `shield.config.RULES_ALONE`.
        Then no action is verified and no frame supervised. `shield.testing.check_rule` tests it.
    perception : source of the scenes. "simulator": its true state. "observation": the policy's observations only, for
        the traffic (Kinematics, grids; meta-actions, a highway), with a new observation at each frame. A
        `PerceptionConfig` has the settings of the latter.

    Attributes
    ----------
    decisions : the decisions of the last step about the action alone, one for each ego.
    frame_decisions : those about its frames. Both together are `last_decision`.

    Raises
    ------
    SceneError
        If the environment's road or number of controlled vehicles is not supported.
    PolicyError
        If `policy` is unsuitable, or was made for other observations or actions.
    ConfigError
        If its action type is neither `DiscreteMetaAction` nor `ContinuousAction`, or it is a parking lot with
        meta-actions. If a wrapper inside changes the actions (`step` detects one that is not an `ActionWrapper`). If
        the settings cannot be read.

    Notes
    -----
    `info["shield"]` is read from `last_decision`, the record of the step. `latency` is the total time of the shield in
    the last step [s].

    - `overridden`, and `intervention`, a `shield.decision.Intervention`: "none", "held back" or "other action".
    - `reason` and `tier`.
    - `margin` [m]; NaN if none is known.
    - `frames_overridden`: number of replaced frames.
    - `violations`: number of violations of the assumptions by the traffic, and `rules`, the same by rule.
    - `guarantee`: a `shield.decision.Guarantee`, the weakest of the decision and its frames.
    - `verification`: a `shield.decision.Verification`, what actions are verified against.
    - `agents`: the same for each of several egos.

    The last step of an episode has `info["shield_episode"]`:

    - `decisions`, the number of these that were `overridden`, and of these the number that were only `held_back`.
    - `frames_overridden`, `violations`, `rules`.
    - the least `margin` [m] and the mean `latency_ms`.
    - `reasons`: number of decisions with each reason.
    - the weakest `guarantee`, no better than "assumptions broken" after a violation.

    If an outer wrapper ends the episode (`TimeLimit`), this summary is in `statistics` and in the info of the next
    `reset`.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = ShieldedEnv(gym.make("highway-fast-v0"))
    >>> env.verification.value
    'worst_case'
    >>> obs, info = env.reset(seed=0)
    >>> obs, reward, terminated, truncated, info = env.step(3)
    >>> info["shield"]["reason"]
    'none'
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: ShieldConfig | str | Path | None = None,
        policy: Any = None,
        model: StageModel | None = None,
        rule: Rule | None = None,
        perception: str | PerceptionConfig = "simulator",
    ) -> None:
        if hasattr(env, "num_envs"):
            around = ", or take Shield(policy, env)" if getattr(env, "envs", None) else ""
            raise ConfigError(
                f"ShieldedEnv takes one Gymnasium environment, not a {type(env).__name__}: put the shield inside, "
                f"DummyVecEnv([lambda: ShieldedEnv(gym.make(...))]){around}"
            )
        bases = base_environments(env, "ShieldedEnv")
        RecordConstructorArgs.__init__(
            self, _disable_deepcopy=True, config=config, policy=policy, model=model, rule=rule, perception=perception
        )
        gym.Wrapper.__init__(self, env)
        self._base: Any = bases[0]
        self.policy = None if policy is None else as_policy(policy, env)
        refuse_misfits(self.policy, env)
        kind = self._kind()
        if rule is not None and kind == "ContinuousAction":
            raise ConfigError("a rule judges meta-actions; this environment has ContinuousAction")
        if model is not None and kind != "ContinuousAction":
            raise ConfigError("a model is for ContinuousAction; with meta-actions leave it out")
        self._given, self._rule, self._model, self._perception = as_settings(config), rule, model, perception
        self._recording = False
        self._chosen = self._settings(kind)
        self._filter: Filter | MultiAgentFilter = self._made(kind)
        self._observation: Any = None
        self._road: Any = None
        self._supervising = self.latency = 0.0
        self._episode, self._summed = Statistics(), False
        self._failure_limit = FailureLimit(self.config.failure_limit)
        self._action_warning = ActionWarning()
        self.decisions: list[Decision] = []
        self.frame_decisions: list[Decision] = []

    @property
    def last_decisions(self) -> list[Decision]:
        """The record of the last step, of each ego: the decision and its frames so far (`Decision.with_frames`)."""
        if isinstance(self._filter, MultiAgentFilter):
            return [each.with_frames(()) for each in self.decisions]
        return [each.with_frames(self.frame_decisions) for each in self.decisions]

    @property
    def last_decision(self) -> Decision | None:
        """The record of the last step, from which `info["shield"]` is read; None before the first. For several egos one
        record, with tuples of the proposed and of the executed actions."""
        if not self.decisions:
            return None
        return (
            multi_agent_record(self.decisions) if isinstance(self._filter, MultiAgentFilter) else self.last_decisions[0]
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and clear everything about the last episode.

        `info["shield_episode"]` is about that episode, if an outer wrapper has ended it, so that no step reported it.
        """
        if self._episode.decisions and not self._summed and self._base.road is self._road:
            before = ViolationCount(self._filter)
            self._filter.monitor_last_frame()
            self._episode.add_offences(*before.since(self._filter))
        obs, info = self.env.reset(seed=seed, options=options)
        if self._episode.decisions and not self._summed:
            info["shield_episode"] = self._episode.summary()
        kind = self._kind()
        inputs, several_egos = kind == "ContinuousAction", kind == "MultiAgentAction"
        same = inputs is isinstance(self._filter, InputFilter | SimulatedInputFilter) and several_egos is isinstance(
            self._filter, MultiAgentFilter
        )
        if not same:
            raise ConfigError("the reset has changed the environment's action type; make a new ShieldedEnv around it")
        if not isinstance(self._given, ShieldConfig):
            chosen = self._settings(kind)
            if chosen.config != self._chosen.config:
                self._chosen = chosen
                self._filter = self._made(kind)
        self._filter.reset()
        self._episode, self._summed = Statistics(), False
        self._observation = obs
        self.decisions, self.frame_decisions = [], []
        return obs, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Filter one action, run it under supervision, and report in `info["shield"]`."""
        if self._base.road is None:
            raise SceneError("the environment has no road yet; call reset() first")
        start = perf_counter()
        before = ViolationCount(self._filter)
        if isinstance(self._filter, MultiAgentFilter):
            decisions = self._filter.decide(action)
            executed = tuple(int(each.executed) for each in decisions)
        else:
            if isinstance(self._filter, MetaActionFilter):
                self._filter.show(self._observation)
            decisions = [self._filter.decide(action, self._order_of(action))]
            executed = decisions[0].executed
        self._failure_limit.check(decisions[0], self._filter.cause)
        self._action_warning.check(decisions, self._base)
        self.decisions, self.frame_decisions = decisions, []
        self._supervising, self._road = 0.0, self._base.road
        deciding, frames = perf_counter() - start, int(self._base.steps)
        if self._filter.supervising:
            with Supervision(self._base, self._frame):
                obs, reward, terminated, truncated, info = self.env.step(executed)
        else:
            obs, reward, terminated, truncated, info = self.env.step(executed)
        check_step(self._base, frames, executed, info)
        self._observation = obs
        self.latency = deciding + self._supervising
        # highway-env's wrapper for several egos returns tuples of rewards and of terminations.
        each: Any = terminated
        ended = truncated or (self._base._is_terminated() if isinstance(each, tuple) else terminated)
        if ended:
            self._filter.monitor_last_frame()
        offences = before.since(self._filter)
        record = self.last_decision
        assert record is not None
        if isinstance(self._filter, MultiAgentFilter):
            info["shield"] = multi_agent_report(record, self.last_decisions, *offences)
        else:
            info["shield"] = report(record, *offences)
        info["shield"]["verification"] = self.verification.value
        self._episode.add(info["shield"], self.latency)
        if ended:
            info["shield_episode"] = self._episode.summary()
            self._summed = True
        paid: Any = reward if isinstance(reward, tuple) else float(reward)
        return obs, paid, terminated, truncated, info

    def _settings(self, kind: str) -> ChosenSettings:
        """The given settings, or the default, which may change with the traffic at a reset."""
        observes = self._perception != "simulator"
        return choose_settings(
            self._given,
            SettingsContext(
                self._base,
                inputs=kind == "ContinuousAction",
                worst_case_only=observes or self._model is not None,
                rule=self._rule is not None,
            ),
        )

    def _kind(self) -> str:
        """Name of the action type."""
        return "MultiAgentAction" if is_multi_agent(self._base) else action_type_name([self._base], "ShieldedEnv")

    @property
    def config(self) -> ShieldConfig:
        """The settings."""
        return self._chosen.config

    @property
    def verification(self) -> Verification:
        """What actions are verified against."""
        return self._chosen.verification

    @property
    def promise(self) -> str:
        """Meaning of the verification, in a sentence."""
        return self._chosen.promise

    def _made(self, kind: str) -> Filter | MultiAgentFilter:
        """The filter for the chosen settings."""
        config = self.config
        action_filter: Filter | MultiAgentFilter
        if is_multi_agent(self._base):
            action_filter = MultiAgentFilter(self._base, config)
            if self._perception != "simulator":
                raise ConfigError(NO_OBSERVED_SCENES)
        else:
            action_filter = filter_for(
                self.env,
                config,
                inputs=kind == "ContinuousAction",
                perception=self._perception,
                model=self._model,
                rule=self._rule,
            )
        # Last, because the filter's own refusals apply without rule and model too.
        if config.simulates and (self._rule is not None or self._model is not None):
            raise ConfigError("Assumptions.simulated_traffic() verifies by simulation: leave rule and model out")
        warm_up_filter(action_filter)
        if self._recording:
            action_filter.record()
        self._chosen.announce()
        return action_filter

    def action_masks(self) -> np.ndarray[Any, Any]:
        """Mask of the actions that verify now, for sb3-contrib's MaskablePPO; all True if none does.

        (MaskablePPO cannot handle an empty mask; then `step` falls back for any action.)
        """
        if not isinstance(self._filter, MetaActionFilter | SimulatedMetaActionFilter | NetworkFilter):
            raise ConfigError("action_masks() needs DiscreteMetaAction of one ego; this environment has other actions")
        return self._filter.mask()

    def record(self) -> None:
        """Keep in each later decision the data for films and overlays, as with `ShieldConfig.record`."""
        self._recording = True
        self._filter.record()

    @property
    def statistics(self) -> Statistics:
        """Totals of this episode so far; `statistics.summary()` is the content of `info["shield_episode"]`.

        For an episode that an outer wrapper ends, such as `TimeLimit`: `env.get_wrapper_attr("statistics")`.
        """
        return deepcopy(self._episode)

    @property
    def filter(self) -> Filter | MultiAgentFilter:
        """The filter; its class determines the kind of verification."""
        return self._filter

    @property
    def door(self) -> Filter | MultiAgentFilter:
        """The former name of `filter`."""
        warn_of_former_name("ShieldedEnv.door", "write ShieldedEnv.filter")
        return self._filter

    @property
    def core(self) -> DecisionCore[Any]:
        """The decision core, with the memory.

        Raises
        ------
        AttributeError
            If the traffic is simulated, or on a road network: the filters for these have none.
        """
        if isinstance(
            self._filter, SimulatedMetaActionFilter | SimulatedInputFilter | MultiAgentFilter | NetworkFilter
        ):
            raise AttributeError("there is no core where the traffic is simulated, and on networks of roads")
        return self._filter.core

    def _order_of(self, action: Any) -> Callable[[], list[int] | None] | None:
        """Function for the policy's order of preference over the other actions; None without a policy."""
        return None if self.policy is None else lambda: self._order(action_index(action))

    def _order(self, proposed: int) -> list[int] | None:
        scores = ranking_of(self.policy, normalised(self.policy, self._observation))
        if scores is None or np.size(scores) != gym.spaces.flatdim(self.unwrapped.action_space):
            return None
        return order_from_scores(np.asarray(scores).reshape(-1), proposed)

    def _frame(self) -> Command:
        start = perf_counter()
        assert not isinstance(self._filter, SimulatedMetaActionFilter | MultiAgentFilter)
        command, decision = self._filter.frame()
        self.frame_decisions.append(decision)
        self._supervising += perf_counter() - start
        return command
