"""What is compared, and what is written down of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from highway_env.envs.common.action import ContinuousAction

from evaluation.settings import Setting
from shield.config import PERCEPTIONS, ShieldConfig
from shield.decision import Reason, Tier, Verification
from shield.errors import ConfigError
from shield.wrappers.defaults import Given, Place, choose_settings

__all__ = ["DOORS", "EpisodeRecord", "Variant", "config_on", "make_variants", "told", "variant_for"]

DOORS = ("none", "env", "policy", "actions")
"""No shield; `ShieldedEnv`; `Shield`; `Shield` with actions alone, `frames=False`."""


@dataclass(frozen=True, slots=True)
class Variant:
    """What stands between the policy and the environment.

    Attributes
    ----------
    door : one of `DOORS`.
    config : the shield's settings; not looked at without a shield.
    perception : one of `shield.config.PERCEPTIONS`, what it reads scenes from.
    note : what tells it from another variant of the same mode, such as "buffer 4 m".
    """

    door: str = "none"
    config: ShieldConfig = field(default_factory=ShieldConfig)
    perception: str = "simulator"
    note: str = ""

    def __post_init__(self) -> None:
        if self.door not in DOORS:
            raise ConfigError(f"unknown door {self.door!r}; valid are {', '.join(DOORS)}")
        if self.perception not in PERCEPTIONS:
            raise ConfigError(f"unknown perception {self.perception!r}; valid are {', '.join(PERCEPTIONS)}")

    @property
    def place(self) -> str:
        """The door, and what scenes are read from where that is not the simulator's state: "env, observation"."""
        return self.door if self.perception == "simulator" else f"{self.door}, {self.perception}"

    @property
    def mode(self) -> str:
        """The shield's mode and the note, "none" without a shield."""
        if self.door == "none":
            return "none"
        return f"{self.config.mode}, {self.note}" if self.note else self.config.mode

    def with_buffers(self, lengths: Sequence[float]) -> list[Variant]:
        """The same with each of these buffers along the road [m]; without a shield, or without lengths, itself alone.

        Examples
        --------
        >>> [each.mode for each in Variant("env").with_buffers([1, 2.5])]
        ['full, buffer 1 m', 'full, buffer 2.5 m']
        """
        if self.door == "none" or not lengths:
            return [self]
        notes = [", ".join(filter(None, (self.note, f"buffer {length:g} m"))) for length in lengths]
        configs = [
            self.config.replace(buffer=replace(self.config.buffer, longitudinal=float(length))) for length in lengths
        ]
        return [replace(self, config=config, note=note) for config, note in zip(configs, notes, strict=True)]


def variant_for(config: ShieldConfig, setting: Setting | None = None) -> Variant:
    """The shield that a configuration is made for: `ShieldedEnv`, or `Shield` with actions alone where the traffic is
    simulated and the policy decides about meta-actions.

    Parameters
    ----------
    setting : what is driven; meta-actions without.
    """
    alone = config.assumptions.simulated and not (setting is not None and _decides_inputs(setting))
    return Variant("actions" if alone else "env", config)


def _decides_inputs(setting: Setting) -> bool:
    """Whether the policy decides about throttle and steering."""
    env = setting.make()
    try:
        base: Any = env.unwrapped
        if base.road is None:
            env.reset(seed=0)
        return isinstance(base.action_type, ContinuousAction)
    finally:
        env.close()


def config_on(setting: Setting, given: Given = None, door: str = "env", observes: bool = False) -> ShieldConfig:
    """The settings that a shield has in an environment.

    Parameters
    ----------
    given : settings, "simulated" or "worst-case"; None for those that the shield takes by itself.
    door : one of `DOORS`. observes : whether its scenes are made from observations.
    """
    env = setting.make()
    try:
        base: Any = env.unwrapped
        if base.road is None:
            env.reset(seed=0)
        inputs = isinstance(base.action_type, ContinuousAction)
        return choose_settings(given, Place(base, inputs, door != "actions", observes)).config
    finally:
        env.close()


def make_variants(
    modes: Sequence[str],
    doors: Sequence[str],
    config: Given = None,
    perceptions: Sequence[str] = ("simulator",),
    setting: Setting | None = None,
) -> list[Variant]:
    """Each mode behind each door, with scenes from each of `perceptions`; the mode "none" stands for driving without
    any shield.

    Parameters
    ----------
    config : settings, "simulated" or "worst-case"; by default each door has those that it takes by itself in the
        environment of `setting`, or without one on a straight highway.

    Examples
    --------
    >>> [(v.door, v.mode) for v in make_variants(["none", "full"], ["env", "policy"])]
    [('none', 'none'), ('env', 'full'), ('policy', 'full')]
    """
    variants: list[Variant] = []
    for mode in modes:
        for door in ["none"] if mode == "none" else doors:
            for perception in ["simulator"] if mode == "none" else perceptions:
                observes = perception != "simulator"
                if isinstance(config, ShieldConfig) or setting is None or mode != "full":
                    simple = ShieldConfig.for_meta_actions() if door == "actions" else ShieldConfig()
                    chosen = config if isinstance(config, ShieldConfig) else simple
                else:
                    chosen = config_on(setting, config, door, observes)
                variant = Variant(door, chosen if door == "none" else chosen.replace(mode=mode), perception)
                if variant not in variants:
                    variants.append(variant)
    return variants


def told(rules: Mapping[str, int]) -> str:
    """How often each rule was broken, as a text.

    Examples
    --------
    >>> told({"lanes": 2, "crash": 1})
    'crash 1, lanes 2'
    """
    return ", ".join(f"{rule} {count}" for rule, count in sorted(rules.items()) if count)


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """What happened in one episode.

    Attributes
    ----------
    setting, policy : names.
    door, mode : what stood between the two (see `Variant`; the door is its `place`).
    seed : seed of the episode.
    crashed : whether the ego crashed.
    off_road : whether the ego's centre left the road.
    attribution : the `Cause` of it, judged from the simulator's state.
    return_ : undiscounted sum of rewards (column "return").
    steps : decisions taken.
    duration : time driven, up to a crash [s].
    mean_speed : mean of the ego's speed over it [m/s].
    distance : way along the road [m]; on a network that is no single road, the way that was driven.
    lane_changes : how often the nearest lane changed; NaN on a network that is no single road.
    laps : share of a closed road that was driven, 1 for a lap; NaN on any other.
    mean_jerk : mean size of the jerk along the way, frame by frame [m/s^3].
    mean_lateral_acceleration : mean size of speed times yaw rate, frame by frame [m/s^2].
    overridden : decisions in which something else than the proposal was done, in part or whole; held_back : those of
        them whose action was the proposed one, and that had frames replaced only.
    reasons, tiers : decisions by `Reason` and `Tier` (columns "reason_…", "tier_…").
    frames, frames_overridden : simulation frames, and those in which the shield acted.
    violations : how often the traffic broke the assumptions; None where the door does not count it.
    rules : how often each of them was broken (column "rules", see `told`).
    min_margin : smallest margin of what was executed [m]; NaN where none was computed.
    min_gap : smallest clearance to anybody [m]; 0 in a crash.
    min_time_to_collision, min_headway : least time to a collision at constant velocities, 0 in a crash, and to the rear
        of anybody ahead; NaN where it is not defined (see `evaluation.measuring.recorder.History`) [s].
    latencies : time that the shield took at each decision [ms] (column "latencies_ms").
    success : whether the goal was reached; None where there is none.
    arrival_speed : the ego's speed then [m/s]; NaN where it was not.
    simulator : "highway-env", or "compiled", its copy.
    verification : what actions were verified against, a `shield.decision.Verification`.
    frame_override_share : share of the frames in which the shield acted.
    input_distance : mean over the decisions of the distance between the proposed and the executed action, 0 where they
        are the same. Of throttle and steering: Euclidean, each input over its range. Of meta-actions: lanes plus
        steps of speed between the two targets, so that LANE_LEFT to SLOWER is 2. An action is what the environment got:
        frames in which the shield drove otherwise are in `frame_override_share`. NaN of several egos.
    acceleration_distance, steering_distance : the same of throttle [m/s^2] and front wheel angle [rad]; NaN of
        meta-actions, which ask for targets.
    on_lane_share : share of the decisions at whose end the ego's centre was on the road.
    mean_confidence : mean over the decisions of the mean confidence of the rows that are not empty; NaN without such a
        channel.
    latency_p50_ms, latency_p99_ms, latency_max_ms : of `latencies`; NaN without a shield.
    mean_reward, peak_reward : of a decision. peak_speed : over the frames up to a crash [m/s].
    mean_normalised_speed : mean over the ends of decisions of the speed over `Vehicle.MAX_SPEED`, within 0 and 1.
    peak_jerk : as `mean_jerk`. mean_normalised_jerk, peak_normalised_jerk : see
        `evaluation.measuring.jerk.normalised_jerk`, of the inputs that the ego's motion tells of the last frame of each
        decision; NaN where it stands, and from a crash on.
    """

    setting: str
    policy: str
    door: str
    mode: str
    seed: int
    crashed: bool
    off_road: bool
    attribution: str
    return_: float
    steps: int
    duration: float
    mean_speed: float
    distance: float
    lane_changes: float
    laps: float
    mean_jerk: float
    mean_lateral_acceleration: float
    overridden: int
    reasons: Mapping[str, int]
    tiers: Mapping[str, int]
    frames: int
    frames_overridden: int
    violations: int | None
    min_margin: float
    min_gap: float
    latencies: tuple[float, ...] = field(repr=False)
    success: bool | None = None
    arrival_speed: float = float("nan")
    simulator: str = "highway-env"
    rules: Mapping[str, int] = field(default_factory=dict)
    held_back: int = 0
    verification: str = Verification.OFF.value
    min_time_to_collision: float = float("nan")
    min_headway: float = float("nan")
    frame_override_share: float = float("nan")
    input_distance: float = float("nan")
    acceleration_distance: float = float("nan")
    steering_distance: float = float("nan")
    on_lane_share: float = float("nan")
    mean_confidence: float = float("nan")
    latency_p50_ms: float = float("nan")
    latency_p99_ms: float = float("nan")
    latency_max_ms: float = float("nan")
    mean_reward: float = float("nan")
    peak_reward: float = float("nan")
    peak_speed: float = float("nan")
    mean_normalised_speed: float = float("nan")
    peak_jerk: float = float("nan")
    mean_normalised_jerk: float = float("nan")
    peak_normalised_jerk: float = float("nan")

    def row(self) -> dict[str, Any]:
        """The record as flat columns of a table."""
        flat = {f.name: getattr(self, f.name) for f in fields(self)}
        reasons, tiers = flat.pop("reasons"), flat.pop("tiers")
        flat["return"], flat["rules"] = flat.pop("return_"), told(self.rules)
        flat["latencies_ms"] = list(flat.pop("latencies"))
        flat |= {f"reason_{r.value}": reasons.get(r.value, 0) for r in Reason}
        return flat | {f"tier_{t.value}": tiers.get(t.value, 0) for t in Tier}
