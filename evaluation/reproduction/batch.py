"""Many compiled roads at once, with the report's sensor, columns and override around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray
from evaluation.reproduction import script, text
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.variants import Variant
from evaluation.settings import Setting, get_setting
from shield.batch.arrays import Records
from shield.batch.codes import OVERRIDES
from shield.certificate.simulated.batch_choice import batch_for
from shield.config import ShieldConfig

__all__ = ["NOISE_STREAM", "ReportBatch", "Shown", "setting_for", "shield_for"]

NOISE_STREAM = 49
"""Beside an episode's seed, so that the noise is not drawn from the numbers of the traffic."""
_STATE = 4


def setting_for(preset: Preset, variant: Variant) -> Setting:
    """The environment of a variant."""
    if variant.default_road:
        return get_setting("roundabout")
    if not variant.stops:
        return preset.setting
    return preset.setting.override({"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 15, 30]}})


def shield_for(variant: Variant, road: str = "highway") -> ShieldConfig:
    """The shield's settings of a variant on a road, "highway" or "roundabout": those that `ShieldedEnv` takes there by
    itself, those of `Shield` with actions alone that reads the simulator's state, or of mode "none"."""
    if not variant.shield:
        return ShieldConfig(mode="none")
    return ShieldConfig() if variant.shield == "env" and road == "highway" else ShieldConfig.simulated_traffic()


def _overridden(records: Records) -> BoolArray:
    """In which environments something else was done than was proposed, in the decision or a frame of it, (e,)."""
    other = OVERRIDES[records.tier] & (records.executed != records.proposed)
    overridden: BoolArray = other | OVERRIDES[records.tiers].any(axis=1)
    return overridden


class Shown:
    """What a policy is shown of observations: noise, and columns of confidence and intent, in that order.

    Parameters
    ----------
    preset, variant : how they are computed, and which there are.
    envs, rows, decisions : environments, rows of an observation, and decisions of an episode at most.
    """

    def __init__(self, preset: Preset, variant: Variant, envs: int, rows: int, decisions: int) -> None:
        self._preset, self._variant = preset, variant
        self._draws: FloatArray = np.zeros((envs, decisions + 1, rows, _STATE))
        self._over_time = text.ConfidenceOverTime(envs, rows)

    @property
    def columns(self) -> int:
        """How many are added."""
        return int(self._variant.confidence) + int(self._variant.intent)

    def begin(self, e: int, seed: int) -> None:
        """Draw the noise of an episode."""
        if self._variant.noise:
            generator = np.random.default_rng([seed, NOISE_STREAM])
            self._draws[e] = generator.standard_normal(self._draws.shape[1:])
        self._over_time.begin(e)

    def of(self, observations: NDArray[np.float32], steps: IntArray, which: IntArray) -> NDArray[np.float32]:
        """What is shown of some environments, (k, n, 5 + columns); once a decision of each.

        Parameters
        ----------
        observations, steps : of these, (k, n, 5), and how many decisions each episode has had, (k,).
        which : their indices, (k,).
        """
        preset, variant, rows = self._preset, self._variant, observations
        if variant.noise:
            noisy = script.noise_on_all_rows if preset.noise == "all rows" else text.noise_on_others
            rows = noisy(rows, self._draws[which, steps], preset.sigma)
        added = []
        if variant.confidence:
            over_time = preset.confidence == "time"
            added.append(self._over_time.add(rows, which) if over_time else script.confidence_across_features(rows))
        if variant.intent:
            metres = preset.intent == "metres"
            added.append(
                text.intent_in_metres(rows, scale=preset.scale) if metres else script.intent_of_normalised(rows)
            )
        columns = [column[..., None].astype(np.float32) for column in added]
        return np.concatenate([rows, *columns], axis=-1)


class ReportBatch:
    """So many environments of a variant, compiled.

    Parameters
    ----------
    preset, variant : what they are. num_envs : how many.

    Attributes
    ----------
    highways : the traffic, and the shield.
    shown : what the policy is shown, (e, n, f) float32. steps : decisions that each episode has had, (e,).
    replaced : in which environments the report's rule replaced the last action, (e,).
    overridden : in which the shield did something else than it was asked for, (e,).
    """

    def __init__(self, preset: Preset, variant: Variant, num_envs: int) -> None:
        self.preset, self.variant = preset, variant
        setting, config = setting_for(preset, variant), shield_for(variant, preset.road)
        self.highways: Any = batch_for(setting.env_id, config)(setting.env_id, num_envs, setting.configured, config)
        observed: Any = self.highways.simulator.scenario.observation_space
        self._sensor = Shown(preset, variant, num_envs, observed.shape[0], self.highways.steps)
        self.steps: IntArray = np.zeros(num_envs, np.intp)
        self.replaced: BoolArray = np.zeros(num_envs, np.bool_)
        self.overridden: BoolArray = np.zeros(num_envs, np.bool_)
        shape = (observed.shape[0], observed.shape[1] + self._sensor.columns)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.shown: NDArray[np.float32] = np.zeros((num_envs, *shape), np.float32)
        self.begin([0] * num_envs, range(num_envs))

    def begin(self, seeds: Sequence[int], which: Sequence[int]) -> None:
        """Start episodes in these environments."""
        chosen = np.asarray(which, np.intp)
        observations = self.highways.reset(list(seeds), list(which))
        for e, seed in zip(which, seeds, strict=True):
            self._sensor.begin(e, seed)
        self.steps[chosen] = 0
        self._show(observations, chosen)

    def step(self, actions: IntArray) -> None:
        """One decision in each, through the report's rule and the shield; see `highways.simulator.seen`."""
        given: IntArray = np.asarray(actions, np.intp)
        self.replaced[:] = False
        if self.variant.override == "distance" or (self.variant.override and self.preset.override == "lane changes"):
            preset = self.preset
            given, self.replaced = text.override_lane_changes(self.shown, given, preset.distance, preset.scale)
        elif self.variant.override:
            given, self.replaced = script.overriding_action(self.shown, given)
        self.highways.step(given)
        self.overridden = _overridden(self.highways.records)
        self.steps = np.minimum(self.steps + 1, self.highways.steps)
        self._show(self.highways.simulator.seen.observations, np.arange(len(self.steps)))

    def _show(self, observations: NDArray[np.float32], which: IntArray) -> None:
        self.shown[which] = self._sensor.of(observations[which], self.steps[which], which)
