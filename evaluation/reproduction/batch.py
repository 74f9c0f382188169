"""Batch of compiled roads with the report's sensor, columns and override."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.state import BoolArray, FloatArray, IntArray
from evaluation.reproduction import script, text
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.variants import ReportVariant
from evaluation.settings import Setting, get_setting
from shield.batch.arrays import BatchRecords
from shield.batch.codes import OVERRIDES
from shield.certificate.simulated.batch_choice import batch_for
from shield.config import ShieldConfig

__all__ = ["NOISE_STREAM", "ObservationChannels", "ReportBatch", "setting_for", "shield_for"]

NOISE_STREAM = 49
"""Second seed of the noise, so that it is independent of the traffic's random numbers."""
_STATE = 4


def setting_for(preset: Preset, variant: ReportVariant) -> Setting:
    """The environment of a variant."""
    if variant.default_road:
        return get_setting("roundabout")
    if not variant.stops:
        return preset.setting
    return preset.setting.override({"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 15, 30]}})


def shield_for(variant: ReportVariant, road: str = "highway") -> ShieldConfig:
    """The shield's settings of a variant on a road, "highway" or "roundabout".

    They are the defaults of `ShieldedEnv` there, those of a `Shield` with `frames=False` that reads the simulator's
    state, or of mode "none".
    """
    if not variant.shield:
        return ShieldConfig(mode="none")
    return ShieldConfig() if variant.shield == "env" and road == "highway" else ShieldConfig.simulated_traffic()


def _overridden(records: BatchRecords) -> BoolArray:
    """Environments in which a decision or one of its frames was overridden, (e,)."""
    other = OVERRIDES[records.tier] & (records.executed != records.proposed)
    overridden: BoolArray = other | OVERRIDES[records.tiers].any(axis=1)
    return overridden


class ObservationChannels:
    """Observations as the policy receives them: with noise, and with columns of confidence and intent, in that order.

    Parameters
    ----------
    preset, variant : formulas of the columns, and choice of columns.
    envs, rows, decisions : number of environments, of rows of an observation, and largest number of decisions.
    """

    def __init__(self, preset: Preset, variant: ReportVariant, envs: int, rows: int, decisions: int) -> None:
        self._preset, self._variant = preset, variant
        self._draws: FloatArray = np.zeros((envs, decisions + 1, rows, _STATE))
        self._over_time = text.ConfidenceOverTime(envs, rows)

    @property
    def columns(self) -> int:
        """Number of added columns."""
        return int(self._variant.confidence) + int(self._variant.intent)

    def begin(self, e: int, seed: int) -> None:
        """Draw the noise of an episode."""
        if self._variant.noise:
            generator = np.random.default_rng([seed, NOISE_STREAM])
            self._draws[e] = generator.standard_normal(self._draws.shape[1:])
        self._over_time.begin(e)

    def of(self, observations: NDArray[np.float32], steps: IntArray, which: IntArray) -> NDArray[np.float32]:
        """Observations of some environments for the policy, (k, n, 5 + columns); to be called once in each decision.

        Parameters
        ----------
        observations : observations of these environments, (k, n, 5).
        steps : number of past decisions of each episode, (k,).
        which : indices of the environments, (k,).
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
    """Batch of compiled environments of a variant.

    Parameters
    ----------
    preset, variant : the variant.
    num_envs : number of environments.

    Attributes
    ----------
    highways : the traffic and the shield.
    shown : observations for the policy, (e, n, f) float32.
    steps : number of past decisions of each episode, (e,).
    replaced : environments in which the report's rule replaced the last action, (e,).
    overridden : environments in which the shield overrode the last action, (e,).
    """

    def __init__(self, preset: Preset, variant: ReportVariant, num_envs: int) -> None:
        self.preset, self.variant = preset, variant
        setting, config = setting_for(preset, variant), shield_for(variant, preset.road)
        self.highways: Any = batch_for(setting.env_id, config)(setting.env_id, num_envs, setting.configured, config)
        observed: Any = self.highways.simulator.scenario.observation_space
        self._sensor = ObservationChannels(preset, variant, num_envs, observed.shape[0], self.highways.steps)
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
        """Execute one decision in each environment, with the report's rule and the shield.

        The results are in `highways.simulator.seen`.
        """
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
