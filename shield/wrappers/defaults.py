"""Default settings for an environment: the strongest verification with assumptions that hold there."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from highway_env.envs.common.action import DiscreteMetaAction, MultiAgentAction

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.road_networks.geometry.network import has_crossing_ways
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.scenes.parking_lot import is_parking_lot
from dynamics.traffic.assumptions import Assumptions
from shield.certificate.network.others import default_on, has_crossings
from shield.config import SIMULATED, WORST_CASE, ShieldConfig
from shield.decision import Verification
from shield.errors import ConfigError, SceneError
from shield.filters.simulated.predicted_scene import check_traffic

__all__ = [
    "ChosenSettings",
    "Given",
    "SettingsContext",
    "as_settings",
    "cannot_stop_text",
    "choose_settings",
    "verification_of",
    "why_not_simulated",
]

Given = ShieldConfig | str | None
"""Settings, "simulated" or "worst-case", or None for the default."""

_log = logging.getLogger("shield")
_CHOOSE = 'To choose, pass config="simulated", config="worst-case" or a ShieldConfig.'
_FORGOTTEN = (
    "These settings assume a highway with supervised frames; without settings this traffic would be simulated: pass "
    "ShieldConfig.simulated_traffic().replace(...) instead"
)
_PROMISES = {
    Verification.OFF: "no shield; every action is executed as proposed",
    Verification.RULE: "a rule decides alone, and nothing is verified",
    Verification.STANDING: "actions are verified among obstacles that stand still",
    Verification.SIMULATED: (
        "each action executed leaves a continuation that is clear of highway-env's own traffic, as simulated; a "
        "deviation from the simulation counts as a violation, and nothing is promised for other traffic"
    ),
    Verification.WORST_CASE: (
        "actions are verified against the worst case within the assumptions: no crash unless another vehicle breaks "
        "a rule of the road. The ego is held back more often than in simulated traffic"
    ),
}


class SettingsContext(NamedTuple):
    """Conditions for the choice of settings.

    Attributes
    ----------
    base : the environment, unwrapped; None if it is in another process.
    inputs : whether the actions are throttle and steering. frames : whether the frames between two decisions are
        supervised.
    worst_case_only : whether simulation is excluded, by a user's model or by scenes from observations.
    rule : whether a user's rule decides alone.
    """

    base: Any
    inputs: bool
    frames: bool = True
    worst_case_only: bool = False
    rule: bool = False


@dataclass(frozen=True, slots=True)
class ChosenSettings:
    """Settings, and their promise in an environment.

    Attributes
    ----------
    config : the settings.
    verification : what actions are verified against.
    promise : its meaning, in a sentence.
    by_default : whether the user gave no settings.
    caution : why the traffic is not simulated although that would be better, in a sentence; "" elsewhere.
    too_fast : text on an ego that cannot stop before a crossing, with a measurement and the remedy; "" elsewhere.
    """

    config: ShieldConfig
    verification: Verification
    promise: str
    by_default: bool = False
    caution: str = ""
    too_fast: str = ""

    def announce(self) -> None:
        """Log the promise: as a warning with a caution, as information for default settings. An ego that cannot stop
        before a crossing gives another warning."""
        if self.too_fast:
            _log.warning("%s", self.too_fast)
        if self.caution:
            _log.warning("%s. %s. %s", self.promise, self.caution, _CHOOSE)
        elif self.by_default:
            _log.info("%s. %s", self.promise, _CHOOSE)


def as_settings(given: ShieldConfig | str | Path | None) -> Given:
    """Settings from a user's argument; a TOML file is read once.

    Raises
    ------
    ConfigError
        As of `ShieldConfig.of`.
    """
    if given is None or (isinstance(given, str) and given in (SIMULATED, WORST_CASE)):
        return given
    return ShieldConfig.of(given)


def choose_settings(given: Given, place: SettingsContext) -> ChosenSettings:
    """Settings for an environment of one ego or several.

    Without given settings, highway-env's own traffic is simulated on road networks. It is also simulated wherever the
    worst case cannot be verified to a standstill: with several egos, tyre slip, or meta-actions without frames.
    Elsewhere, and with unknown traffic, the default is the worst case.
    """
    worst = _worst_case(place)
    if isinstance(given, str):
        return _described(place, ShieldConfig.simulated_traffic() if given == SIMULATED else worst)
    open_to_both = not (place.worst_case_only or place.rule) and _better_simulated(place)
    if given is not None:
        forgotten = open_to_both and given.mode == "full" and given.assumptions == Assumptions()
        caution = _FORGOTTEN if forgotten and not why_not_simulated(place.base) else ""
        return _described(place, given, caution=caution)
    if not open_to_both:
        return _described(place, worst, True)
    unknown = why_not_simulated(place.base)
    caution = f"Its traffic cannot be simulated: {unknown}" if unknown else ""
    return _described(place, worst if unknown else ShieldConfig.simulated_traffic(), True, caution)


def verification_of(config: ShieldConfig) -> Verification:
    """What settings verify actions against on a road, without a user's rule."""
    if config.mode == "none":
        return Verification.OFF
    if config.mode != "full":
        return Verification.RULE
    return Verification.SIMULATED if config.simulates else Verification.WORST_CASE


def cannot_stop_text(base: Any) -> str:
    """Text on meta-actions that cannot stop the ego before a crossing, with a measurement and the remedy. "" if they
    can, if no lanes cross, and for other actions.

    Parameters
    ----------
    base : highway-env's environment, unwrapped.
    """
    if base.road is None or is_parking_lot(base) or not has_crossing_ways(base.road.network):
        return ""
    each = getattr(base.action_type, "agents_action_types", [base.action_type])
    slowest = max((float(kind.target_speeds[0]) for kind in each if type(kind) is DiscreteMetaAction), default=0.0)
    if slowest <= 0:
        return ""
    action = '{"type": "DiscreteMetaAction", "target_speeds": [0, 4.5, 9]}'
    if isinstance(base.action_type, MultiAgentAction):
        action = f'{{"type": "MultiAgentAction", "action_config": {action}}}'
    return (
        f"{type(base).__name__}: the slowest target speed is {slowest:g} m/s, so the ego cannot stop before a "
        "crossing, and the shield cannot keep it from every crash: with 20, 25 and 30 m/s, 40 % of 200 shielded "
        f'episodes of intersection-v1 crashed. Pass config={{"action": {action}}} to gym.make'
    )


def why_not_simulated(base: Any) -> str:
    """Why the traffic of an environment, unwrapped and reset, cannot be simulated, as text; "" if it can."""
    if isinstance(base, CompiledHighwayEnv):
        return ""
    try:
        check_traffic(base)
        NetworkSimulator(base)
    except (ConfigError, SceneError) as error:
        return str(error)
    return ""


def _better_simulated(place: SettingsContext) -> bool:
    """Whether the default is simulated traffic, if it can be simulated."""
    base = place.base
    if base is None or base.road is None or is_parking_lot(base):
        return False
    if not place.frames:
        # Throttle and steering are simulated frame by frame.
        return not place.inputs
    slips = place.inputs and getattr(base.action_type, "dynamical", False)
    return has_crossings(base) or len(getattr(base, "controlled_vehicles", ())) > 1 or slips


def _worst_case(place: SettingsContext) -> ShieldConfig:
    """Settings of the worst case."""
    if place.inputs:
        return ShieldConfig()
    if not place.frames:
        return ShieldConfig.for_meta_actions()
    return ShieldConfig() if place.rule or place.base is None else default_on(place.base)


def _described(
    place: SettingsContext, config: ShieldConfig, by_default: bool = False, caution: str = ""
) -> ChosenSettings:
    """The settings with their promise."""
    kind = verification_of(config)
    if config.mode == "full" and place.rule:
        kind = Verification.RULE
    elif kind is Verification.WORST_CASE and place.base is not None and is_parking_lot(place.base):
        kind = Verification.STANDING
    name = "observations" if place.base is None else type(place.base).__name__
    too_fast = "" if kind is Verification.OFF or place.base is None else cannot_stop_text(place.base)
    return ChosenSettings(config, kind, f"{name}: {_PROMISES[kind]}", by_default, caution, too_fast)
