"""Variants of the shield, and the record of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from highway_env.envs.common.action import ContinuousAction

from dynamics.deprecation import accept_former_fields, accept_former_keywords
from evaluation.settings import Setting
from shield.config import PERCEPTIONS, ShieldConfig
from shield.decision import Reason, Tier, Verification
from shield.errors import ConfigError
from shield.wrappers.defaults import Given, SettingsContext, choose_settings

__all__ = ["PLACEMENTS", "EpisodeRecord", "ShieldVariant", "config_on", "make_variants", "rules_text", "variant_for"]

PLACEMENTS = ("none", "env", "policy", "actions")
"""Values of `ShieldVariant.placement`: no shield; `ShieldedEnv`; `Shield`; `Shield` with `frames=False`, which verifies
no frames between decisions."""


@accept_former_fields({"door": "placement"})
@dataclass(frozen=True, slots=True)
class ShieldVariant:
    """The shield between the policy and the environment.

    Attributes
    ----------
    placement : one of `PLACEMENTS`.
    config : the shield's settings; ignored without a shield.
    perception : source of the shield's scenes, one of `shield.config.PERCEPTIONS`.
    note : distinguishes variants of the same mode, such as "buffer 4 m".
    """

    placement: str = "none"
    config: ShieldConfig = field(default_factory=ShieldConfig)
    perception: str = "simulator"
    note: str = ""

    def __post_init__(self) -> None:
        if self.placement not in PLACEMENTS:
            raise ConfigError(f"unknown placement {self.placement!r}; valid are {', '.join(PLACEMENTS)}")
        if self.perception not in PERCEPTIONS:
            raise ConfigError(f"unknown perception {self.perception!r}; valid are {', '.join(PERCEPTIONS)}")

    @property
    def place(self) -> str:
        """`placement`, followed by the perception unless that is the simulator's state: "env, observation"."""
        return self.placement if self.perception == "simulator" else f"{self.placement}, {self.perception}"

    @property
    def mode(self) -> str:
        """The shield's mode and the note; "none" without a shield."""
        if self.placement == "none":
            return "none"
        return f"{self.config.mode}, {self.note}" if self.note else self.config.mode

    def with_buffers(self, lengths: Sequence[float]) -> list[ShieldVariant]:
        """Copies with each of these buffers along the road [m]; only itself without a shield or without lengths.

        Examples
        --------
        >>> [each.mode for each in ShieldVariant("env").with_buffers([1, 2.5])]
        ['full, buffer 1 m', 'full, buffer 2.5 m']
        """
        if self.placement == "none" or not lengths:
            return [self]
        notes = [", ".join(filter(None, (self.note, f"buffer {length:g} m"))) for length in lengths]
        configs = [
            self.config.replace(buffer=replace(self.config.buffer, longitudinal=float(length))) for length in lengths
        ]
        return [replace(self, config=config, note=note) for config, note in zip(configs, notes, strict=True)]


def variant_for(config: ShieldConfig, setting: Setting | None = None) -> ShieldVariant:
    """The variant for a configuration.

    `ShieldedEnv`; or `Shield` with `frames=False` if the traffic is simulated and the actions are meta-actions.

    Parameters
    ----------
    config : the shield's settings.
    setting : the environment; meta-actions by default.
    """
    alone = config.assumptions.simulated and not (setting is not None and _decides_inputs(setting))
    return ShieldVariant("actions" if alone else "env", config)


def _decides_inputs(setting: Setting) -> bool:
    """Whether the actions are throttle and steering."""
    env = setting.make()
    try:
        base: Any = env.unwrapped
        if base.road is None:
            env.reset(seed=0)
        return isinstance(base.action_type, ContinuousAction)
    finally:
        env.close()


@accept_former_keywords({"door": "placement"})
def config_on(setting: Setting, given: Given = None, placement: str = "env", observes: bool = False) -> ShieldConfig:
    """The settings of a shield in an environment.

    Parameters
    ----------
    setting : the environment.
    given : settings, "simulated" or "worst-case"; None for the shield's default.
    placement : one of `PLACEMENTS`.
    observes : whether scenes come from observations.
    """
    env = setting.make()
    try:
        base: Any = env.unwrapped
        if base.road is None:
            env.reset(seed=0)
        inputs = isinstance(base.action_type, ContinuousAction)
        return choose_settings(given, SettingsContext(base, inputs, placement != "actions", observes)).config
    finally:
        env.close()


@accept_former_keywords({"doors": "placements"})
def make_variants(
    modes: Sequence[str],
    placements: Sequence[str],
    config: Given = None,
    perceptions: Sequence[str] = ("simulator",),
    setting: Setting | None = None,
) -> list[ShieldVariant]:
    """Make the variants of each mode, `placement` and perception; the mode "none" is one variant without a shield.

    Parameters
    ----------
    modes : shield modes.
    placements : values from `PLACEMENTS`.
    config : settings, "simulated" or "worst-case"; by default those that the shield chooses in the environment of
        `setting`, or without one on a straight highway.
    perceptions : values from `shield.config.PERCEPTIONS`.
    setting : the environment.

    Examples
    --------
    >>> [(v.placement, v.mode) for v in make_variants(["none", "full"], ["env", "policy"])]
    [('none', 'none'), ('env', 'full'), ('policy', 'full')]
    """
    variants: list[ShieldVariant] = []
    for mode in modes:
        for placement in ["none"] if mode == "none" else placements:
            for perception in ["simulator"] if mode == "none" else perceptions:
                observes = perception != "simulator"
                if isinstance(config, ShieldConfig) or setting is None or mode != "full":
                    simple = ShieldConfig.for_meta_actions() if placement == "actions" else ShieldConfig()
                    chosen = config if isinstance(config, ShieldConfig) else simple
                else:
                    chosen = config_on(setting, config, placement, observes)
                variant = ShieldVariant(
                    placement, chosen if placement == "none" else chosen.replace(mode=mode), perception
                )
                if variant not in variants:
                    variants.append(variant)
    return variants


def rules_text(rules: Mapping[str, int]) -> str:
    """Number of violations by rule, as a text.

    Examples
    --------
    >>> rules_text({"lanes": 2, "crash": 1})
    'crash 1, lanes 2'
    """
    return ", ".join(f"{rule} {count}" for rule, count in sorted(rules.items()) if count)


@accept_former_fields({"door": "placement"})
@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """Result of one episode.

    Attributes
    ----------
    setting, policy : names.
    placement, mode : `place` and `mode` of the `ShieldVariant`.
    seed : seed of the episode.
    crashed : whether the ego crashed.
    off_road : whether the ego's centre left the road.
    attribution : the `Cause` of the crash, from the simulator's state.
    return_ : undiscounted sum of rewards (column "return").
    steps : number of decisions.
    duration : time driven, up to a crash [s].
    mean_speed : mean speed of the ego, up to a crash [m/s].
    distance : distance along the road [m]; on a road network the length of the path driven.
    lane_changes : number of changes of the nearest lane; NaN on a road network.
    laps : driven share of a closed road, 1 for a lap; NaN on other roads.
    mean_jerk : mean magnitude of the jerk along the path, frame by frame [m/s^3].
    mean_lateral_acceleration : mean magnitude of speed times yaw rate, frame by frame [m/s^2].
    overridden : number of decisions in which the proposal was not executed as it was, wholly or for some frames.
    held_back : number of them in which the action was the proposal and only frames were replaced.
    reasons, tiers : number of decisions by `Reason` and `Tier` (columns "reason_…", "tier_…").
    frames, frames_overridden : number of simulation frames, and of those in which the shield acted.
    violations : number of violations of the assumptions by the traffic; None if the variant does not count them.
    rules : number of violations by rule (column "rules", see `rules_text`).
    min_margin : least margin of the executed plans [m]; NaN if none was computed.
    min_gap : least clearance to another vehicle [m]; 0 in a crash.
    min_time_to_collision : least time to a collision at constant velocities [s]; 0 in a crash.
    min_headway : least time headway to the rear of a vehicle ahead [s]. Both are NaN if undefined (see
        `evaluation.measuring.recorder.History`).
    latencies : computing time of the shield for each decision [ms] (column "latencies_ms").
    success : whether the goal was reached; None without a goal.
    arrival_speed : speed of the ego at the goal [m/s]; NaN without success.
    simulator : "highway-env", or "compiled" for the compiled copy.
    verification : what actions were verified against, a `shield.decision.Verification`.
    frame_override_share : share of the frames in which the shield acted.
    input_distance : mean over the decisions of the distance between proposed and executed action, 0 if they are equal.
        For throttle and steering: Euclidean, each input over its range. For meta-actions: lanes plus steps of speed
        between the two targets, so LANE_LEFT to SLOWER is 2. The executed action is the one that the environment
        received; frames with other inputs are in `frame_override_share`. NaN for several egos.
    acceleration_distance, steering_distance : the same for throttle [m/s^2] and front wheel angle [rad]; NaN for
        meta-actions, which set targets.
    on_lane_share : share of the decisions with the ego's centre on the road at their end.
    mean_confidence : mean over the decisions of the mean confidence of rows that are not empty; NaN without such a
        channel.
    latency_p50_ms, latency_p99_ms, latency_max_ms : statistics of `latencies`; NaN without a shield.
    mean_reward, peak_reward : mean and greatest reward of a decision.
    peak_speed : greatest speed of the ego, up to a crash [m/s].
    mean_normalised_speed : mean over the ends of decisions of the speed over `Vehicle.MAX_SPEED`, within 0 and 1.
    peak_jerk : greatest magnitude of the jerk, up to a crash, as in `mean_jerk` [m/s^3].
    mean_normalised_jerk, peak_normalised_jerk : see `evaluation.measuring.jerk.normalised_jerk`, for the inputs
        inferred from the ego's motion in the last frame of each decision; NaN at a standstill, and from a crash on.
    """

    setting: str
    policy: str
    placement: str
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
        flat["return"], flat["rules"] = flat.pop("return_"), rules_text(self.rules)
        flat["latencies_ms"] = list(flat.pop("latencies"))
        flat |= {f"reason_{r.value}": reasons.get(r.value, 0) for r in Reason}
        return flat | {f"tier_{t.value}": tiers.get(t.value, 0) for t in Tier}
