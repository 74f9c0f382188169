"""Which batch of filtered environments is for what."""

from __future__ import annotations

from dynamics.road_networks.episodes.scenario import on_roads
from shield.batch.filtered import FilteredHighways
from shield.batch.highways import ShieldedHighways
from shield.certificate.simulated.highways import ExactHighways
from shield.certificate.simulated.roads import ExactRoads
from shield.config import ShieldConfig

__all__ = ["batch_for", "highways_for"]


def batch_for(env_id: str, config: ShieldConfig) -> type[FilteredHighways]:
    """What drives so many copies of an environment at once: `ExactRoads` on a road network that is simulated or driven
    without a shield, on all others `highways_for`; each refuses what it cannot do."""
    alone = config.assumptions.simulated or config.mode == "none"
    return ExactRoads if alone and on_roads(env_id) else highways_for(config)


def highways_for(config: ShieldConfig) -> type[FilteredHighways]:
    """What settings are for: `ExactHighways` where the traffic is simulated, `ShieldedHighways` elsewhere."""
    return ExactHighways if config.assumptions.simulated else ShieldedHighways
