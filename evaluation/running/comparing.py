"""A comparison: policies in settings, with sensors and variants of the shield, all on the same seeds."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from evaluation.running.driver import policy_name
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.identity import model_hashes, of_environment, of_policy
from evaluation.running.named_policies import is_model, make_policy
from evaluation.running.processes import Engine
from evaluation.running.records import ShieldVariant
from evaluation.running.simulators import environment
from evaluation.running.store import Store
from evaluation.running.store_rows import KEY
from evaluation.settings import Setting
from shield.errors import ConfigError

__all__ = ["Comparison"]


@dataclass(frozen=True)
class Comparison:
    """Specification of a comparison.

    Attributes
    ----------
    settings : each setting with its variants of the shield.
    policies : names of policies, or paths of zip files.
    seeds : seeds of the episodes of each row.
    sensors : sensors of the policies.
    algorithm, model, simulator : as in `evaluation.running.episodes.run_episode`.
    steps : as in `evaluation.running.episodes.RunOptions`.

    Raises
    ------
    ConfigError
        If two policies would be reported under the same name.
    """

    settings: tuple[tuple[Setting, tuple[ShieldVariant, ...]], ...]
    policies: tuple[str, ...]
    seeds: range
    sensors: tuple[str, ...] = ("exact",)
    algorithm: str | None = None
    model: str | None = None
    simulator: str = "auto"
    steps: bool = False

    def __post_init__(self) -> None:
        named: dict[str, str] = {}
        for each in self.policies:
            label = policy_name(each, self.model)
            if label in named:
                raise ConfigError(
                    f"{named[label]} and {each} would both be reported as {label!r}; copy one to another name"
                )
            named[label] = each

    def specification(self) -> dict[str, Any]:
        """The values that determine the rows, as plain values (see `evaluation.running.store.Store`).

        Raises
        ------
        ConfigError, PolicyError
            If an environment cannot be made, or a policy cannot drive it.
        """
        return {
            "settings": {setting.name: of_environment(setting) for setting, _ in self.settings},
            "policies": self._policies(),
            "shields": self.shields(),
            "seed": self.seeds.start,
            "episodes": len(self.seeds),
            "simulator": self.simulator,
        }

    def shields(self) -> dict[str, Any]:
        """The settings of each shield, as plain values, by setting, place and mode."""
        return {
            f"{setting.name}, {variant.place}, {variant.mode}": tomllib.loads(variant.config.to_toml())
            for setting, variants in self.settings
            for variant in variants
        }

    @property
    def models(self) -> dict[str, str]:
        """Hash of each model file, by its name."""
        return model_hashes(self.policies)

    def drive(self, store: Store, engine: Engine, progress: bool = True) -> pd.DataFrame:
        """Drive the episodes that are not stored, and return all rows; rows outside this comparison come first."""
        run = RunOptions(engine, store, self.steps, progress)
        parts = [
            run_paired(
                setting if sensor == "exact" else setting.override({}, name=f"{setting.name}, {sensor}"),
                policy,
                variants,
                self.seeds,
                algorithm=self.algorithm,
                model=self.model,
                simulator=self.simulator,
                sensor=sensor,
                run=run,
            )
            for setting, variants in self.settings
            for sensor in self.sensors
            for policy in self.policies
        ]
        driven = pd.concat(parts, ignore_index=True)
        driven_keys = set(driven[list(KEY)].itertuples(index=False, name=None))
        others = [row for row in store.rows if tuple(row[key] for key in KEY) not in driven_keys]
        return pd.concat([pd.DataFrame(others), driven], ignore_index=True) if others else driven

    def _policies(self) -> Mapping[str, Any]:
        """Identity of each policy's files; each model is loaded and checked in each environment."""
        found = {policy_name(each, self.model): of_policy(each, model=self.model) for each in self.policies}
        models = [each for each in self.policies if is_model(each)]
        for setting, _ in self.settings if models else ():
            for sensor in self.sensors:
                _, env = environment(setting, "idle", ShieldVariant(), None, "highway-env", sensor)
                try:
                    for each in models:
                        made = make_policy(each, env, self.algorithm)
                        found[policy_name(each, self.model)] = of_policy(each, made, self.model)
                finally:
                    env.close()
        return found
