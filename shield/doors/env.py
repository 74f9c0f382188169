"""`ShieldedEnv`: the shield between the decision and the actuators, at every simulation frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from dynamics.scenes.scene import SceneReader, Target
from mpc.filter.program.road_step import StageModel
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.doors.discrete_action import action_index
from shield.doors.input_door import InputDoor, refuse_lots
from shield.doors.ranking import order_from_scores, ranking_of
from shield.errors import ConfigError, SceneError
from shield.procedures.decide import Core, Unreadable, read
from shield.procedures.frames import FrameCommand, Frames
from shield.procedures.meta_actions import MetaActions
from shield.procedures.nearest_inputs import NearestInputs
from shield.procedures.screen import RuleAlone, Wish
from shield.procedures.warm_up import warm_up

__all__ = ["ShieldedEnv"]


class ShieldedEnv(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wraps a highway-env environment with meta-actions or continuous ones; reads the simulator's true state.

    At each decision the proposed meta-action is verified and, if need be, replaced. Between two decisions every
    simulation frame is supervised: when the committed meta-action has become unsafe, the frame is held back
    with bounded acceleration, or the ego keeps its lane. Throttle and steering are verified at every frame, and
    replaced by the nearest inputs that verify.

    Parameters
    ----------
    env : the environment (`highway-v0`, `highway-fast-v0` or one with the same kind of road; with continuous actions
        the racetracks and parking lots too).
    config : settings, or the path of a TOML file with them.
    policy : where given, alternatives are tried in its order of preference (probabilities or Q-values of the
        last observation).
    model : what the predictive filter plans with for `ContinuousAction`, such as
        `dynamics.learned.models.casadi_steps.LearnedSteps`; the bicycle by default. All is verified on the bicycle.

    Raises
    ------
    SceneError
        If the environment's road or number of controlled vehicles is not supported.
    ConfigError
        If its action type is neither `DiscreteMetaAction` nor `ContinuousAction`, or meta-actions in a parking lot; or
        if the settings cannot be read.

    Notes
    -----
    `info["shield"]` holds `overridden`, `reason`, `tier`, `margin` [m], `latency_ms` (all the time that the
    shield took in this step), `frames_overridden` and `violations` (of the assumptions, by the traffic).

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = ShieldedEnv(gym.make("highway-fast-v0"))
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
    ) -> None:
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, config=config, policy=policy, model=model)
        gym.Wrapper.__init__(self, env)
        self.config = ShieldConfig.of(config)
        self.policy = policy
        self._base: Any = env.unwrapped
        self._check_action_type()
        self._reader = SceneReader(env)
        self._inputs: InputDoor | None = None
        if self._kind() == "ContinuousAction":
            self._inputs = InputDoor(self._base, self.config, model=model)
        elif model is not None:
            raise ConfigError("a model is for ContinuousAction; with meta-actions leave it out")
        self._meta = MetaActions(self.config)
        self._frames = Frames(self.config, NearestInputs(self.config) if self.config.repair == "filter" else None)
        alone = self.config.mode in ("distance", "rss", "ttc")
        meta: Core[Any] = Core(RuleAlone(self.config) if alone else self._meta)
        self.core = meta if self._inputs is None else self._inputs.core
        warm_up()
        self._observation: Any = None
        self._supervising = 0.0
        self.last_decision: Decision | None = None
        self.frame_decisions: list[Decision] = []

    def _kind(self) -> str:
        return type(getattr(self.unwrapped, "action_type", None)).__name__

    def _check_action_type(self) -> None:
        kind = self._kind()
        if kind not in ("DiscreteMetaAction", "ContinuousAction"):
            raise ConfigError(
                f"ShieldedEnv filters DiscreteMetaAction and ContinuousAction; this environment has {kind}. Pass "
                'config={"action": {"type": "DiscreteMetaAction"}} to gym.make'
            )
        if kind != "ContinuousAction":
            refuse_lots([self._base])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and forget everything about the last episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self.core.reset()
        if self._inputs is not None:
            self._inputs.reset()
        self._check_action_type()
        self._observation = obs
        self.last_decision = None
        self.frame_decisions = []
        return obs, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Filter one meta-action, run it under supervision, and report in `info["shield"]`."""
        if self._base.road is None:
            raise SceneError("the environment has no road yet; call reset() first")
        start = perf_counter()
        before = self.core.violations
        decision = self._decide(action) if self._inputs is None else self._inputs.decide(action)
        self.last_decision = decision
        self.frame_decisions = []
        self._supervising = 0.0
        deciding = perf_counter() - start
        if self.config.mode == "full":
            with _Supervised(self._base, self._frame):
                obs, reward, terminated, truncated, info = self.env.step(decision.executed)
        else:
            obs, reward, terminated, truncated, info = self.env.step(decision.executed)
        self._observation = obs
        frames = [d for d in self.frame_decisions if d.overridden]
        overridden = [decision, *frames] if decision.overridden else frames
        shown = next((d for d in overridden if d.tier.fallback), overridden[0] if overridden else decision)
        margins = [d.margin for d in (decision, *self.frame_decisions) if np.isfinite(d.margin)]
        info["shield"] = {
            "overridden": decision.overridden or bool(frames),
            "reason": shown.reason.value,
            "tier": shown.tier.value,
            "margin": min(margins, default=float("inf")),
            "latency_ms": 1e3 * (deciding + self._supervising),
            "frames_overridden": len(frames),
            "violations": self.core.violations - before,
        }
        return obs, float(reward), terminated, truncated, info

    def action_masks(self) -> np.ndarray[Any, Any]:
        """Which actions verify now, for sb3-contrib's MaskablePPO; all True where none does.

        (MaskablePPO cannot handle an empty mask; `step` then falls back whatever is chosen.)
        """
        if self._inputs is not None:
            raise ConfigError("action_masks() needs DiscreteMetaAction; this environment has ContinuousAction")
        mask = self._meta.mask(self.core.memory, self._reader.read())
        return mask if mask.any() else np.ones_like(mask)

    def _decide(self, action: Any) -> Decision:
        start, proposed, labels = perf_counter(), action_index(action), self._reader.actions
        if self.config.mode == "none":
            return Decision(action, action, Reason.NONE, Tier.OFF, np.nan, 0.0)
        order = None if self.policy is None else lambda: self._order(proposed)
        decision = self.core.decide(read(self._reader), Wish(proposed, labels, order))
        shown = action if proposed < 0 else proposed
        return replace(decision, proposed=shown, latency=perf_counter() - start)

    def _order(self, proposed: int) -> list[int] | None:
        scores = ranking_of(self.policy, self._observation)
        if scores is None or np.size(scores) != gym.spaces.flatdim(self.unwrapped.action_space):
            return None
        return order_from_scores(np.asarray(scores).reshape(-1), proposed)

    def _frame(self) -> FrameCommand | dict[str, float] | None:
        if self._inputs is not None:
            start = perf_counter()
            raw, decision = self._inputs.frame()
            self.frame_decisions.append(decision)
            self._supervising += perf_counter() - start
            return raw
        first = not self.frame_decisions
        if first and self.last_decision is not None and self.last_decision.tier is Tier.PASSED:
            # The decision has just verified this very frame, with this very target.
            self.frame_decisions.append(self.last_decision)
            return None
        start, scene = perf_counter(), read(self._reader)
        blind = Target(int(self._base.vehicle.lane_index[2]), 0.0)
        target = blind if isinstance(scene, Unreadable) else scene.control.target
        decision = self.core.decide(scene, target, self._frames)
        self.frame_decisions.append(decision)
        self._supervising += perf_counter() - start
        return None if decision.tier is Tier.PASSED else decision.executed


class _Supervised:
    """For the duration of one step, lets `frame` have the last word on the ego's low-level action."""

    def __init__(self, env: Any, frame: Callable[[], FrameCommand | dict[str, float] | None]) -> None:
        self._env, self._frame = env, frame

    def __enter__(self) -> None:
        ego, frame = self._env.vehicle, self._frame
        act = type(ego).act

        def supervised(action: Any = None) -> None:
            act(ego, action)
            if action is not None:
                return
            command = frame()
            if isinstance(command, dict):
                ego.action = command
            elif command is not None:
                lane = (*ego.target_lane_index[:2], command.lane)
                if command.lane != ego.target_lane_index[2]:
                    ego.target_lane_index = lane
                floor = -max(ego.speed, 0.0) * self._env.config["simulation_frequency"]
                wheel = command.steering
                ego.action = {
                    "steering": ego.steering_control(lane) if wheel is None else wheel,
                    "acceleration": max(command.acceleration, floor),
                }

        ego.act = supervised
        self._ego = ego

    def __exit__(self, *_: Any) -> None:
        del self._ego.act
