"""Chooses the class of batched environments for a configuration."""

from __future__ import annotations

from dynamics.road_networks.episodes.scenario import on_roads
from shield.batch.filtered import FilteredHighways
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.highways import SimulatedHighways
from shield.certificate.simulated.roads import SimulatedRoads
from shield.config import ShieldConfig

__all__ = ["batch_for", "highways_for"]


def batch_for(env_id: str, config: ShieldConfig) -> type[FilteredHighways]:
    """The class that simulates copies of an environment: `SimulatedRoads` on a road network with simulated traffic or
    without a shield, otherwise `highways_for`. Each class refuses what it does not support."""
    alone = config.assumptions.simulated or config.mode == "none"
    return SimulatedRoads if alone and on_roads(env_id) else highways_for(config)


def highways_for(config: ShieldConfig) -> type[FilteredHighways]:
    """`SimulatedHighways` for simulated traffic, otherwise `ShieldedHighways`."""
    return SimulatedHighways if config.assumptions.simulated else ShieldedHighways
