"""An experiment: policies in environments, with variants of the shield, all on the same seeds."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import pandas as pd

from dynamics.deprecation import accept_former_fields, with_present_names
from evaluation.experiments.conversion import as_file, name_of, origin_of, setting_given
from evaluation.experiments.result import Result
from evaluation.names import ENGINES, SIMULATORS, check_name, check_sensor, read_toml
from evaluation.report.table import finished
from evaluation.running.comparing import Comparison
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.processes import engine_of
from evaluation.running.records import PLACEMENTS, ShieldVariant, make_variants
from evaluation.running.step_table import check_steps, write_steps
from evaluation.running.store import Store
from evaluation.settings import Setting
from shield.config import MODES, PERCEPTIONS, Buffer, ShieldConfig
from shield.errors import ConfigError
from shield.wrappers.policy_adapters import as_policy

__all__ = ["Experiment", "Stopped"]

_FORMER = {"door": "placement"}
"""Present names of attributes of `Experiment`, by the former name."""


class Stopped(KeyboardInterrupt):
    """Signals an interrupted experiment; `result` has the episodes so far."""

    def __init__(self, result: Result) -> None:
        super().__init__(f"stopped after {len(result.episodes)} episodes")
        self.result = result


@accept_former_fields(_FORMER)
@dataclass(frozen=True)
class Experiment:
    """Specification of an experiment, with one field for each option of `shield evaluate` and each key of a TOML file.

    Attributes
    ----------
    policy : policies: names, paths of SB3 zip files, SB3 models, functions of the observation or objects with
        `predict`. One, a sequence, or a mapping from names in reports.
    env : environments: names of settings, Gymnasium ids, `Setting` objects, or environments made by `gym.make`.
    shield : modes of the shield; None for none and full.
    placement : one or more of "env", "policy", "actions", see `evaluation.running.records.PLACEMENTS`.
    perception : source of the shield's scenes.
    sensor : sensor of the policy.
    episodes : episodes of each row.
    seed : seed of the first episode.
    config : settings of the shield: an object, "simulated", "worst-case" or the path of a TOML file; None for the
        shield's default in each environment.
    algorithm, model, simulator : as in `evaluation.running.episodes.run_episode`.
    jobs : processes; -1 for one per core.
    output : path of the episodes, .parquet or .csv, stored as they finish; None keeps them in memory.
    resume : whether to continue the run in `output`.
    shard : (i, n) to drive every n-th episode only, from the i-th on, 1 to n, on one of n machines; see `merge`.
    buffer : buffers along the road [m], one row for each, in place of the one of `config`.
    steps : path of a .parquet file with one row for each decision (see `evaluation.running.step_table.steps_of`);
        decisions are stored with the episodes until the run ends.
    engine : "processes", or "ray" for the tasks of a Ray cluster.
    address : address of the cluster; "auto", the default, for the one of this machine, "local" to start one here.

    Raises
    ------
    ConfigError
        If a name or number is not valid.

    Examples
    --------
    >>> Experiment(policy="faster", episodes=2).names
    ('faster',)
    """

    policy: Any = "random"
    env: Any = "highway-fast"
    shield: str | Sequence[str] | None = None
    placement: str | Sequence[str] = "env"
    perception: str | Sequence[str] = PERCEPTIONS[0]
    sensor: str | Sequence[str] = "exact"
    episodes: int = 100
    seed: int = 100_000
    config: ShieldConfig | str | Path | None = None
    algorithm: str | None = None
    model: str = "bicycle"
    simulator: str = SIMULATORS[0]
    jobs: int = 1
    output: str | Path | None = None
    resume: bool = False
    shard: tuple[int, int] | None = None
    buffer: float | Sequence[float] = ()
    steps: str | Path | None = None
    engine: str = ENGINES[0]
    address: str | None = None

    def __post_init__(self) -> None:
        for name, valid in (("shield", MODES), ("placement", PLACEMENTS[1:]), ("perception", PERCEPTIONS)):
            for each in _several(getattr(self, name) or ()):
                check_name(name, each, valid)
        for each in _several(self.sensor):
            check_sensor(each)
        check_name("simulator", self.simulator, SIMULATORS)
        check_name("engine", self.engine, ENGINES)
        engine_of(self.engine, self.jobs, self.address)
        if self.steps is not None and Path(self.steps).suffix != ".parquet":
            raise ConfigError(f"steps {str(self.steps)!r} must end in .parquet")
        for length in self._buffers:
            Buffer(length)
        if self.episodes < 1 or self.seed < 0:
            raise ConfigError(f"episodes must be 1 or more, and seed 0 or more; got {self.episodes} and {self.seed}")
        if self.resume and self.output is None:
            raise ConfigError("resume goes with output")
        if self.shard is not None:
            number, count = self.shard
            if not 1 <= number <= count:
                raise ConfigError(f"shard must be (i, n) with 1 <= i <= n, not ({number}, {count})")
            if count > self.episodes:
                raise ConfigError(f"{self.episodes} episodes make no {count} shards")
        self.policies  # noqa: B018  (raises an error for two policies of one name)

    @classmethod
    def from_toml(cls, path: str | Path) -> Experiment:
        """Read an experiment from a TOML file, with a key for each attribute.

        Raises
        ------
        ConfigError
            If there is no such file, it is no TOML, or it has another key.
        """
        keys = with_present_names(read_toml(path), _FORMER, str(path))
        valid = [field.name for field in fields(cls)]
        for key in keys:
            check_name("key", key, valid)
        if "shard" in keys:
            keys["shard"] = tuple(keys["shard"])
        return cls(**keys)

    @property
    def policies(self) -> Mapping[str, Any]:
        """The policies by their names in reports; raises `ConfigError` if two have the same name."""
        if isinstance(self.policy, Mapping):
            return dict(self.policy)
        named: dict[str, Any] = {}
        for each in self.policy if isinstance(self.policy, list | tuple) else [self.policy]:
            name = name_of(each)
            if name in named:
                raise ConfigError(
                    f"{named[name]} and {each} would both be reported as {name!r}; copy one to another name, or give a "
                    "mapping of names to policies"
                )
            named[name] = each
        if not named:
            raise ConfigError("no policy is given")
        return named

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the policies."""
        return tuple(self.policies)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """The environments as settings."""
        several = self.env if isinstance(self.env, list | tuple) else [self.env]
        return tuple(setting_given(each) for each in several)

    @property
    def seeds(self) -> range:
        """Seeds of the episodes of each row; with a shard, only its seeds."""
        whole = range(self.seed, self.seed + self.episodes)
        return whole if self.shard is None else whole[self.shard[0] - 1 :: self.shard[1]]

    def run(self, progress: bool = True) -> Result:
        """Drive the episodes that are not stored yet.

        Parameters
        ----------
        progress : whether to show the progress.

        Returns
        -------
        All episodes, with their manifest.

        Raises
        ------
        ConfigError, PolicyError
            If an environment cannot be made, a policy cannot drive it, or `output` holds another experiment.
        """
        with tempfile.TemporaryDirectory(prefix="policies-") as folder:
            files = {name: as_file(name, each, Path(folder)) for name, each in self.policies.items()}
            functions = {name: each for name, each in files.items() if not isinstance(each, str)}
            named = [each for each in files.values() if isinstance(each, str)]
            objects = [name for name, each in self.policies.items() if not isinstance(each, str | Path)]
            if objects and self.resume:
                raise ConfigError(
                    f"resume cannot tell whether {', '.join(objects)} is the same as before: save the model, and give "
                    "the path of its zip file"
                )
            compared = tuple((setting, tuple(self._variants(setting))) for setting in self.settings)
            comparison = self._comparison(compared, tuple(named))
            store = self._store(comparison, functions)
            if self.steps is not None:
                check_steps(Path(self.steps), store.rows)
            engine = engine_of(self.engine, self.jobs, self.address)
            try:
                parts = [comparison.drive(store, engine, progress)] if named else []
                for setting, variants in compared:
                    parts += [self._drive(setting, variants, name, each) for name, each in functions.items()]
            except KeyboardInterrupt:
                raise Stopped(Result(store.table(), store.made)) from None
        episodes = pd.concat(parts, ignore_index=True)
        if self.steps is not None:
            episodes = write_steps(Path(self.steps), episodes)
        result = Result(episodes, store.made)
        if self.output is not None:
            result.write(self.output)
            store.finish()
        return result

    def with_options(self, **options: Any) -> Experiment:
        """A copy with other values of some attributes.

        Raises
        ------
        ConfigError
            If there is no such attribute, or a value is not valid.
        """
        options = with_present_names(options, _FORMER, "Experiment")
        for key in options:
            check_name("option", key, [field.name for field in fields(self)])
        return replace(self, **options)

    def _variants(self, setting: Setting) -> list[ShieldVariant]:
        modes = _several(self.shield) if self.shield else ["none", "full"] if setting.road else ["none"]
        config = self.config
        if isinstance(config, str | Path) and config not in ("simulated", "worst-case"):
            config = ShieldConfig.named(Path(config))
        made = make_variants(modes, _several(self.placement), config, _several(self.perception), setting)
        return [each for variant in made for each in variant.with_buffers(self._buffers)]

    @property
    def _buffers(self) -> tuple[float, ...]:
        return (self.buffer,) if isinstance(self.buffer, int | float) else tuple(self.buffer)

    def _comparison(
        self, compared: tuple[tuple[Setting, tuple[ShieldVariant, ...]], ...], named: tuple[str, ...]
    ) -> Comparison:
        return Comparison(
            compared,
            named,
            self.seeds,
            tuple(_several(self.sensor)),
            algorithm=self.algorithm,
            model=self.model,
            simulator=self.simulator,
            steps=self.steps is not None,
        )

    def _store(self, comparison: Comparison, functions: Mapping[str, Any]) -> Store:
        """The store of the episodes, with the values that determine them."""
        what = {**comparison.specification(), "seed": self.seed, "episodes": self.episodes}
        if self.shard is not None:
            what["shard"] = list(self.shard)
        if functions:
            what["policies"] = {
                **what["policies"],
                **{name: {"function": origin_of(f)} for name, f in functions.items()},
            }
        output = None if self.output is None else Path(self.output)
        if output is not None:
            try:
                output.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise ConfigError(f"{output.parent} cannot be made: {error.strerror}") from None
        before = finished(output) if self.resume and output is not None else None
        return Store(output, what, self.resume, before, comparison.models)

    def _drive(self, setting: Setting, variants: tuple[ShieldVariant, ...], name: str, policy: Any) -> pd.DataFrame:
        """Drive the episodes of a policy that is an object."""
        parts = []
        for sensor in _several(self.sensor):
            seen = setting if sensor == "exact" else setting.override({}, name=f"{setting.name}, {sensor}")
            env = setting.make()
            try:
                adapted = as_policy(policy, env)
            finally:
                env.close()
            driven = run_paired(
                seen,
                adapted,
                variants,
                self.seeds,
                algorithm=self.algorithm,
                simulator=self.simulator,
                sensor=sensor,
                run=RunOptions(engine_of(self.engine, self.jobs, self.address), steps=self.steps is not None),
            )
            parts.append(driven)
        return pd.concat(parts, ignore_index=True).assign(policy=name)


def _several(value: str | Sequence[str]) -> list[str]:
    return [value] if isinstance(value, str) else list(value)
