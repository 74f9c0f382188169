"""Choice of the filter for an environment: by kind of action, by road, and by assumptions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

from shield.certificate.network.others import has_crossings
from shield.config import ShieldConfig
from shield.errors import ConfigError
from shield.filters.inputs import InputFilter
from shield.filters.meta_actions import MetaActionFilter
from shield.filters.network import NetworkFilter
from shield.filters.simulated.inputs import SimulatedInputFilter
from shield.filters.simulated.meta_actions import SimulatedMetaActionFilter
from shield.perception.perceiving import PerceptionConfig
from shield.perception.scenes import NO_OBSERVED_SCENES, scenes_of
from shield.rules import Rule

if TYPE_CHECKING:
    from mpc.filter.program.road_step import StageModel

__all__ = ["Filter", "filter_for"]

Filter: TypeAlias = MetaActionFilter | InputFilter | SimulatedMetaActionFilter | SimulatedInputFilter | NetworkFilter
"""A filter for the actions of one ego."""


def filter_for(
    env: Any,
    config: ShieldConfig,
    *,
    inputs: bool,
    frames: bool = True,
    perception: str | PerceptionConfig = "simulator",
    model: StageModel | None = None,
    rule: Rule | None = None,
) -> Filter:
    """The filter for an environment of one ego.

    Parameters
    ----------
    env : the environment. config : settings.
    inputs : whether its actions are throttle and steering instead of meta-actions.
    frames, perception : as of `Shield`. model, rule : as of `ShieldedEnv`.

    Raises
    ------
    ConfigError, SceneError
        As of the filter, or if it reads the simulator's state although `perception` requires observations.
    """
    base = env.unwrapped
    # On a network, vehicles on the other roads count too.
    on_roads = frames and not inputs and rule is None and has_crossings(base)
    if not inputs and not config.simulates and not (on_roads and config.mode == "full"):
        return MetaActionFilter(base, config, frames, rule, scenes_of(perception, env))
    action_filter: Filter
    if inputs and config.simulates:
        action_filter = SimulatedInputFilter(base, config)
    elif inputs:
        action_filter = InputFilter(base, config, agent=not frames, model=model)
    else:
        action_filter = SimulatedMetaActionFilter(base, config) if config.simulates else NetworkFilter(base, config)
    if perception != "simulator":
        raise ConfigError(NO_OBSERVED_SCENES)
    return action_filter
