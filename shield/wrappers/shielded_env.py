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

from shield.certificate.network.others import has_crossings
from shield.config import ShieldConfig
from shield.decision import Decision, Verification
from shield.environments import base_environments, check_step
from shield.errors import ConfigError, SceneError
from shield.filters.discrete_action import action_index
from shield.filters.inputs import InputDoor
from shield.filters.meta_actions import MetaDoor
from shield.filters.network import RoadDoor
from shield.filters.simulated.inputs import ExactInputDoor
from shield.filters.simulated.meta_actions import ExactDoor
from shield.filters.simulated.multi_agent import TeamDoor, is_team
from shield.filters.supervision import Command, Supervision
from shield.perception.perceiving import PerceptionConfig
from shield.perception.scenes import NO_OBSERVED_SCENES
from shield.pipelines.decide import Core
from shield.rules import Rule
from shield.wrappers.action_type import the_action_type
from shield.wrappers.defaults import ChosenSettings, Place, as_settings, choose_settings
from shield.wrappers.failure_limit import ActionWarning, Patience
from shield.wrappers.filter_choice import Door, door_for
from shield.wrappers.policy_adapters import as_policy, refuse_misfits
from shield.wrappers.ranking import normalised, order_from_scores, ranking_of
from shield.wrappers.report import Offences, Statistics, report, team_record, team_report
from shield.wrappers.warm_filters import warm_up_door

if TYPE_CHECKING:
    from mpc.filter.program.road_step import StageModel

__all__ = ["ShieldedEnv"]


class ShieldedEnv(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wraps a highway-env environment with meta-actions or continuous ones; reads the simulator's true state.

    At each decision the proposed meta-action is verified and, if need be, replaced. Between two decisions every
    simulation frame is supervised: when the committed meta-action has become unsafe, the frame is held back
    with bounded acceleration, or the ego keeps its lane. Throttle and steering are verified at every frame, and
    replaced by the nearest inputs that verify.

    With `ShieldConfig.simulated_traffic()` the traffic is simulated instead, on every road with known traffic:
    meta-actions are verified when they are taken, throttle and steering at every frame. Several egos with meta-actions
    (`MultiAgentAction`) are verified together: `step` takes a tuple of actions then.

    Parameters
    ----------
    env : the environment: with meta-actions on any road; with continuous actions on straight highways, racetracks and
        parking lots, and with `ShieldConfig.simulated_traffic()` on every other road.
    config : settings, the path of a TOML file with them, "simulated" (`ShieldConfig.simulated_traffic()`) or
        "worst-case". By default highway-env's own traffic is simulated on networks of roads, with several egos, and
        with tyres that slip; elsewhere, and where the traffic is unknown, actions are verified against the worst case.
        A line in the log of "shield" says what is promised, a warning where the traffic is unknown.
    policy : where given, alternatives are tried in its order of preference (probabilities or Q-values of the
        last observation).
    model : what the predictive filter plans with for `ContinuousAction`, such as
        `dynamics.learned.models.casadi_steps.LearnedSteps`; the bicycle by default. All is verified on the bicycle.
    rule : a rule of one's own (`shield.rules.Rule`), which decides alone, as the modes of `shield.config.RULES_ALONE`
        do: nothing is verified then, and no frame supervised. `shield.testing.check_rule` tries it.

    perception : what scenes are read from: "simulator", its true state, or "observation", nothing of the traffic but
        what the policy observes (Kinematics, grids; meta-actions, a highway), sensed anew at each frame; or a
        `PerceptionConfig`, which has the settings of the latter.

    Attributes
    ----------
    decisions : the decisions of the last step about the action alone, one for each ego.
    frame_decisions : those about its frames. Both together are `last_decision`.

    Raises
    ------
    SceneError
        If the environment's road or number of controlled vehicles is not supported.
    PolicyError
        If `policy` cannot be used as one, or was made for other observations or actions.
    ConfigError
        If its action type is neither `DiscreteMetaAction` nor `ContinuousAction`, or meta-actions in a parking lot; if
        a wrapper inside changes the actions, which `step` finds out of one that is no `ActionWrapper`; or if the
        settings cannot be read.

    Notes
    -----
    `info["shield"]` is read from `last_decision`, the record of the step. It holds `overridden`, `intervention` (a
    `shield.decision.Intervention`: "none", "held back" or "other action"), `reason`, `tier`, `margin` [m] (NaN where
    none is known), `frames_overridden`, `violations` (of the assumptions, by the traffic), `rules` (how often each was
    broken, by name), `guarantee` (a `shield.decision.Guarantee`, the weakest of the decision and its frames) and
    `verification` (a `shield.decision.Verification`, what actions are verified against), and of several egos `agents`,
    the same of each; `latency` is all the time that the shield took in the last step [s]. With an episode's last step
    comes `info["shield_episode"]`: `decisions`, how many were `overridden`, and of these only `held_back`,
    `frames_overridden`, `violations`, `rules`, the smallest `margin` [m], the mean `latency_ms`, `reasons`, how often
    each was one, and the weakest `guarantee`: no better than "assumptions broken" where there were violations. Of an
    episode that a wrapper outside ends (`TimeLimit`), `statistics` has it, and the info of
    the next `reset`.

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
        self._door: Door | TeamDoor = self._made(kind)
        self._observation: Any = None
        self._road: Any = None
        self._supervising = self.latency = 0.0
        self._episode, self._summed = Statistics(), False
        self._patience = Patience(self.config.patience)
        self._action_warning = ActionWarning()
        self.decisions: list[Decision] = []
        self.frame_decisions: list[Decision] = []

    @property
    def last_decisions(self) -> list[Decision]:
        """The record of the last step, of each ego: the decision and its frames so far (`Decision.with_frames`)."""
        if isinstance(self._door, TeamDoor):
            return [each.with_frames(()) for each in self.decisions]
        return [each.with_frames(self.frame_decisions) for each in self.decisions]

    @property
    def last_decision(self) -> Decision | None:
        """The record of the last step, which `info["shield"]` is read from; None before the first. Of several egos,
        their records as one, with tuples of what was proposed and executed."""
        if not self.decisions:
            return None
        return team_record(self.decisions) if isinstance(self._door, TeamDoor) else self.last_decisions[0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and forget everything about the last episode.

        `info["shield_episode"]` is of that episode, where a wrapper outside has ended it: no step could say so.
        """
        if self._episode.decisions and not self._summed and self._base.road is self._road:
            before = Offences(self._door)
            self._door.look()
            self._episode.add_offences(*before.since(self._door))
        obs, info = self.env.reset(seed=seed, options=options)
        if self._episode.decisions and not self._summed:
            info["shield_episode"] = self._episode.summary()
        kind = self._kind()
        inputs, team = kind == "ContinuousAction", kind == "MultiAgentAction"
        same = inputs is isinstance(self._door, InputDoor | ExactInputDoor) and team is isinstance(self._door, TeamDoor)
        if not same:
            raise ConfigError("the reset has changed the environment's action type; make a new ShieldedEnv around it")
        if not isinstance(self._given, ShieldConfig):
            chosen = self._settings(kind)
            if chosen.config != self._chosen.config:
                self._chosen = chosen
                self._door = self._made(kind)
        self._door.reset()
        self._episode, self._summed = Statistics(), False
        self._observation = obs
        self.decisions, self.frame_decisions = [], []
        return obs, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Filter one meta-action, run it under supervision, and report in `info["shield"]`."""
        if self._base.road is None:
            raise SceneError("the environment has no road yet; call reset() first")
        start = perf_counter()
        before = Offences(self._door)
        if isinstance(self._door, TeamDoor):
            decisions = self._door.decide(action)
            executed = tuple(int(each.executed) for each in decisions)
        else:
            if isinstance(self._door, MetaDoor):
                self._door.show(self._observation)
            decisions = [self._door.decide(action, self._order_of(action))]
            executed = decisions[0].executed
        self._patience.check(decisions[0], self._door.cause)
        self._action_warning.check(decisions, self._base)
        self.decisions, self.frame_decisions = decisions, []
        self._supervising, self._road = 0.0, self._base.road
        deciding, frames = perf_counter() - start, int(self._base.steps)
        if self._door.supervising:
            with Supervision(self._base, self._frame):
                obs, reward, terminated, truncated, info = self.env.step(executed)
        else:
            obs, reward, terminated, truncated, info = self.env.step(executed)
        check_step(self._base, frames, executed, info)
        self._observation = obs
        self.latency = deciding + self._supervising
        # highway-env's wrapper for several egos rewards each, and says of each whether it is over for it.
        each: Any = terminated
        ended = truncated or (self._base._is_terminated() if isinstance(each, tuple) else terminated)
        if ended:
            self._door.look()
        offences = before.since(self._door)
        record = self.last_decision
        assert record is not None
        if isinstance(self._door, TeamDoor):
            info["shield"] = team_report(record, self.last_decisions, *offences)
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
        """What was handed in, or what is taken without: that may change with the traffic, at a reset."""
        observes = self._perception != "simulator"
        return choose_settings(
            self._given,
            Place(
                self._base,
                inputs=kind == "ContinuousAction",
                worst_case_only=observes or self._model is not None,
                rule=self._rule is not None,
            ),
        )

    def _kind(self) -> str:
        """What the policy decides about."""
        return "MultiAgentAction" if is_team(self._base) else the_action_type([self._base], "ShieldedEnv")

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
        """What that promises, in a sentence."""
        return self._chosen.promise

    def _made(self, kind: str) -> Door | TeamDoor:
        """What filters, by the settings chosen."""
        config = self.config
        door: Door | TeamDoor
        if is_team(self._base):
            door = TeamDoor(self._base, config)
            if self._perception != "simulator":
                raise ConfigError(NO_OBSERVED_SCENES)
        else:
            door = door_for(
                self.env,
                config,
                inputs=kind == "ContinuousAction",
                on_roads=kind == "DiscreteMetaAction" and self._rule is None and has_crossings(self._base),
                perception=self._perception,
                model=self._model,
                rule=self._rule,
            )
        # After what is refused without them as well.
        if config.simulates and (self._rule is not None or self._model is not None):
            raise ConfigError("Assumptions.simulated_traffic() verifies by simulation: leave rule and model out")
        warm_up_door(door)
        if self._recording:
            door.record()
        self._chosen.announce()
        return door

    def action_masks(self) -> np.ndarray[Any, Any]:
        """Which actions verify now, for sb3-contrib's MaskablePPO; all True where none does.

        (MaskablePPO cannot handle an empty mask; `step` then falls back whatever is chosen.)
        """
        if not isinstance(self._door, MetaDoor | ExactDoor | RoadDoor):
            raise ConfigError("action_masks() needs DiscreteMetaAction of one ego; this environment has other actions")
        return self._door.mask()

    def record(self) -> None:
        """Keep in each decision from now on what films and overlays draw, as with `ShieldConfig.record`."""
        self._recording = True
        self._door.record()

    @property
    def statistics(self) -> Statistics:
        """What has been done in this episode so far; `statistics.summary()` is what `info["shield_episode"]` has.

        For an episode that a wrapper outside ends, such as `TimeLimit`: `env.get_wrapper_attr("statistics")`.
        """
        return deepcopy(self._episode)

    @property
    def door(self) -> Door | TeamDoor:
        """What filters: its class says what is verified and how."""
        return self._door

    @property
    def core(self) -> Core[Any]:
        """What decides, and remembers.

        Raises
        ------
        AttributeError
            If the traffic is simulated, or on a network of roads: the doors for that have none.
        """
        if isinstance(self._door, ExactDoor | ExactInputDoor | TeamDoor | RoadDoor):
            raise AttributeError("there is no core where the traffic is simulated, and on networks of roads")
        return self._door.core

    def _order_of(self, action: Any) -> Callable[[], list[int] | None] | None:
        """The policy's order of preference over what it has not proposed, where it is needed."""
        return None if self.policy is None else lambda: self._order(action_index(action))

    def _order(self, proposed: int) -> list[int] | None:
        scores = ranking_of(self.policy, normalised(self.policy, self._observation))
        if scores is None or np.size(scores) != gym.spaces.flatdim(self.unwrapped.action_space):
            return None
        return order_from_scores(np.asarray(scores).reshape(-1), proposed)

    def _frame(self) -> Command:
        start = perf_counter()
        assert not isinstance(self._door, ExactDoor | TeamDoor)
        command, decision = self._door.frame()
        self.frame_decisions.append(decision)
        self._supervising += perf_counter() - start
        return command
