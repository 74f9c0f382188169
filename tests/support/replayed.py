"""Records of an episode, driven apart from its replay: what the data and the page of the replay are compared with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from evaluation.replay.collect import ReplayRequest
from evaluation.running.driver import Driver, DriverSpec
from evaluation.running.records import config_on, variant_for
from evaluation.settings import get_setting
from shield import ShieldedEnv

__all__ = ["Records", "asked_for", "records_of"]


@dataclass
class Records:
    """The record of each step, its decisions about frames, what was said of it; the recorded states in the world."""

    steps: list[Any] = field(default_factory=list)
    frames: list[list[Any]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    world: Any = None
    episode: Any = None


def asked_for(setting, policy, seed, **changes):
    """An episode of a named setting, with the shield that it is given by itself."""
    where = get_setting(setting).override(changes) if changes else get_setting(setting)
    return ReplayRequest(where, policy, variant_for(config_on(where), where), seed)


def records_of(asked):
    """Drive it without a replay."""
    driver = Driver(DriverSpec(asked.setting, asked.policy, asked.variant, simulator="highway-env"))
    found = Records()
    shielded = driver.env if driver.shield is None else driver.shield

    def after(_, record):
        frames = shielded.frame_decisions if isinstance(shielded, ShieldedEnv) else shielded.frame_decisions[0]
        found.steps.append(record)
        found.frames.append(list(frames))
        found.texts.append(record.explain().text)

    found.episode = driver.run(asked.seed, after)
    found.world = driver.recorder.world()
    driver.env.close()
    return found
