"""Chooses the class of batched environments for a configuration."""

from __future__ import annotations

from dynamics.road_networks.episodes.scenario import on_roads
from shield.batch.filtered import FilteredHighways
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.highways import ExactHighways
from shield.certificate.simulated.roads import ExactRoads
from shield.config import ShieldConfig

__all__ = ["batch_for", "highways_for"]


def batch_for(env_id: str, config: ShieldConfig) -> type[FilteredHighways]:
    """The class that simulates copies of an environment: `ExactRoads` on a road network with simulated traffic or
    without a shield, otherwise `highways_for`. Each class refuses what it does not support."""
    alone = config.assumptions.simulated or config.mode == "none"
    return ExactRoads if alone and on_roads(env_id) else highways_for(config)


def highways_for(config: ShieldConfig) -> type[FilteredHighways]:
    """`ExactHighways` for simulated traffic, otherwise `ShieldedHighways`."""
    return ExactHighways if config.assumptions.simulated else ShieldedHighways
