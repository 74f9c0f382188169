"""Training of a safety monitor in rounds: each round drives behind the monitor of the round before (DAgger).

Source: Ross, Gordon and Bagnell 2011. States in which a monitor's user finds itself are those after its own decisions,
so they have to be among the training states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from dynamics.world_model.monitor import MonitorConfig, SafetyMonitor
from evaluation.training.monitor import MonitorTraining, calibrated, filtered_driver, fit, named_driver
from evaluation.training.safety_labels import LabelledHighways, LabelledStates, gather, gather_episodes
from shield.errors import ConfigError

__all__ = ["MonitorRounds", "train_monitor"]

_CALIBRATION_SEED = 8_000
"""First seed of the calibration episodes; those of the rounds are below."""
_ROUND_SEEDS = 1_000
"""Distance between the first seeds of two rounds."""


@dataclass(frozen=True)
class MonitorRounds:
    """Parameters of `train_monitor`.

    Attributes
    ----------
    env_id, config : the highway, as in `FastHighwayVecEnv`.
    rounds : the first is driven without a monitor, up to 7. environments, steps : of each round.
    keep_safe : share of the states without an unsafe action that are trained on.
    calibration : number of calibration episodes. miss : share of the unsafe actions that the threshold may miss.
    round_miss : the same for the monitors of the rounds, which should see states near unsafe ones.
    driver : as in `named_driver`. training : of each round.
    """

    env_id: str = "highway-fast-v0"
    config: Mapping[str, Any] = field(default_factory=dict)
    rounds: int = 4
    environments: int = 96
    steps: int = 300
    keep_safe: float = 0.5
    calibration: int = 300
    miss: float = 0.003
    round_miss: float = 0.05
    driver: str = "mixed"
    training: MonitorTraining = field(default_factory=MonitorTraining)

    def __post_init__(self) -> None:
        if not 1 <= self.rounds < _CALIBRATION_SEED // _ROUND_SEEDS:
            raise ConfigError(f"a safety monitor is trained in 1 to 7 rounds, not {self.rounds}")
        for name in ("miss", "round_miss"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} is a share between 0 and 1, not {getattr(self, name)!r}")


def train_monitor(
    options: MonitorRounds | None = None,
    monitor_config: MonitorConfig | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> tuple[SafetyMonitor, dict[str, Any]]:
    """Gather labelled states in rounds, train a monitor on all of them after each, and calibrate the last.

    Parameters
    ----------
    progress : called with a line after each step.

    Returns
    -------
    The monitor, and notes for its checkpoint: the parameters, and the number of states of each round.
    """
    given, shape = options or MonitorRounds(), monitor_config or MonitorConfig()
    world = LabelledHighways(given.environments, given.env_id, given.config, shape.view)
    drive, parts = named_driver(given.driver, shape.actions), []
    monitor = SafetyMonitor(shape)
    for k in range(given.rounds):
        behind = drive if k == 0 else filtered_driver(monitor, drive)
        parts.append(gather(world, behind, given.steps, _ROUND_SEEDS * k, given.keep_safe))
        found = parts[-1]
        progress(
            f"round {k}: {len(found.frames)} states, {found.unsafe.mean():.3f} of the actions unsafe, "
            f"{found.unsafe.all(axis=1).mean():.3f} of the states lost"
        )
        monitor = fit(SafetyMonitor(shape), LabelledStates.join(parts), given.training)
        monitor = _calibrated(monitor, given, given.round_miss, drive)
        progress(f"round {k}: threshold {monitor.config.threshold:.4f}")
    monitor = _calibrated(monitor, given, given.miss, drive)
    progress(f"threshold {monitor.config.threshold:.4f}")
    notes = {"rounds": asdict(given), "states": [len(part.frames) for part in parts]}
    return monitor, notes


def _calibrated(monitor: SafetyMonitor, given: MonitorRounds, miss: float, drive: Any) -> SafetyMonitor:
    """The monitor, calibrated on episodes driven behind it."""
    world = LabelledHighways(given.calibration, given.env_id, given.config, monitor.config.view)
    states, _ = gather_episodes(world, filtered_driver(monitor, drive), _CALIBRATION_SEED)
    return calibrated(monitor, states, miss)
