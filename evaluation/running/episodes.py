"""Run of episodes: one record each, paired over the same seeds, in parallel.

A seed determines the traffic and all random choices of the policy. So the records, except their latencies, do not
depend on the number of jobs.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any, NamedTuple, TypedDict, Unpack

import pandas as pd

from dynamics.deprecation import warn_of_former_name
from evaluation.running.driver import Driver, DriverSpec, policy_name
from evaluation.running.identity import check_files, hash_of_files
from evaluation.running.named_policies import Policy
from evaluation.running.processes import Engine, Processes
from evaluation.running.progress import EpisodeProgress
from evaluation.running.records import EpisodeRecord, ShieldVariant
from evaluation.running.store import Store
from evaluation.settings import Setting, get_setting
from evaluation.threads import one_thread
from shield.decision import Decision
from shield.errors import ConfigError

__all__ = ["RunOptions", "run_episode", "run_paired"]

_CHUNK = 25
"""Episodes of one call if rows are not stored as they finish."""


@dataclass(frozen=True)
class RunOptions:
    """How `run_paired` executes its episodes, and where they are stored.

    Attributes
    ----------
    engine : executes the calls, instead of `jobs` processes.
    store : store of each episode as it finishes; stored episodes are not driven again.
    steps : whether each row has a column "decisions", see `evaluation.running.driver.Driver.steps`.
    progress : whether to show a bar; if the output is no terminal, a line for each tenth of the episodes.
    """

    engine: Engine | None = None
    store: Store | None = None
    steps: bool = False
    progress: bool = False


class DrivingOptions(TypedDict, total=False):
    """Keywords of `run_episode` and `run_paired`, see `evaluation.running.driver.DriverSpec`."""

    algorithm: str | None
    model: str | None
    simulator: str
    sensor: str


def run_episode(
    setting: str | Setting,
    policy: str | Policy,
    variant: ShieldVariant | None = None,
    seed: int = 100_000,
    *,
    after: Callable[[float, Decision], None] | None = None,
    **driving: Unpack[DrivingOptions],
) -> EpisodeRecord:
    """Drive one episode.

    Parameters
    ----------
    setting, policy : by name or as objects; a policy may also be the path of an SB3 zip file.
    variant : the shield between the two; none by default.
    seed : seed of the traffic and of the policy.
    after : see `evaluation.running.driver.Driver.run`.
    driving : algorithm, model, simulator and sensor, see `evaluation.running.driver.DriverSpec`.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    driver = Driver(DriverSpec(setting, policy, variant or ShieldVariant(), **driving))
    try:
        with one_thread():
            return driver.run(seed, after)
    finally:
        driver.env.close()


def run_paired(
    setting: str | Setting,
    policy: str | Policy,
    variants: Iterable[ShieldVariant],
    seeds: Iterable[int],
    *,
    jobs: int = 1,
    run: RunOptions | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Drive every variant on the same seeds; one row per episode, by variant and then seed.

    Parameters
    ----------
    setting, policy : as in `run_episode`.
    variants : variants of the shield to compare.
    seeds : seeds of the episodes.
    jobs : processes; -1 for one per core.
    run : execution and storage of the episodes; in memory by default.
    options : algorithm, model, simulator and sensor, as in `run_episode`. Also fields of `RunOptions` by name, in place
        of `run`, with a `DeprecationWarning`.

    Raises
    ------
    TypeError
        If a keyword is not one of these.
    ConfigError
        If there is nothing to run, `jobs` is 0, or neither the policy nor a shield uses the given model.
    """
    setting = get_setting(setting) if isinstance(setting, str) else setting
    names = DrivingOptions.__optional_keys__
    driving: Any = {name: options.pop(name) for name in names & options.keys()}
    run, model = _with_deprecated(run or RunOptions(), options), driving.get("model")
    variants, seeds = list(variants), list(seeds)
    if not variants or not seeds:
        raise ConfigError(f"nothing to run: {len(variants)} variants, {len(seeds)} episodes")
    if jobs == 0:
        raise ConfigError("jobs must be at least 1, or -1 for one per core")
    if model not in (None, "bicycle") and policy != "mpc" and not any(v.placement == "env" for v in variants):
        raise ConfigError("a model is for mpc and for the shield's placement env; none of the two drives here")
    specs = [DriverSpec(setting, policy, variant, **driving) for variant in variants]
    return _run_specs(specs, seeds, Processes(jobs) if run.engine is None else run.engine, run)


def _with_deprecated(run: RunOptions, keywords: dict[str, Any]) -> RunOptions:
    """The options, updated by keywords that `run_paired` took before `RunOptions`; to be removed after one release."""
    if not keywords:
        return run
    valid = [field.name for field in fields(RunOptions)]
    if unknown := sorted(set(keywords) - set(valid)):
        raise TypeError(f"run_paired() has no keyword {', '.join(unknown)}; run=RunOptions() has {', '.join(valid)}")
    named = ", ".join(f"{name}=..." for name in keywords)
    warn_of_former_name(f"run_paired({named})", f"pass run=RunOptions({named})", stacklevel=4)
    return replace(run, **keywords)


def _run_specs(specs: Sequence[DriverSpec], seeds: Sequence[int], engine: Engine, run: RunOptions) -> pd.DataFrame:
    """Rows of the episodes of specs that differ only in their variants."""
    rows = [] if run.store is None else _stored_rows(specs, seeds, run.store)
    calls = _calls(specs, seeds, {_key(row) for row in rows}, engine, run)
    with EpisodeProgress(specs[0].setting.name, len(seeds) * len(specs), run.progress) as progress:
        progress.begin(rows)
        for part in engine.spread(_run_chunk, calls):
            rows += part
            if run.store is not None:
                run.store.add(part)
            progress.add(part)
    order = {(each.variant.place, each.variant.mode): i for i, each in enumerate(specs)}
    place = {seed: i for i, seed in enumerate(seeds)}
    rows.sort(key=lambda row: (order[row["placement"], row["mode"]], place[row["seed"]]))
    return pd.DataFrame(rows)


def _key(row: dict[str, Any]) -> tuple[str, str, int]:
    """Columns `placement`, `mode` and `seed` of a row."""
    return row["placement"], row["mode"], row["seed"]


def _stored_rows(specs: Sequence[DriverSpec], seeds: Sequence[int], store: Store) -> list[dict[str, Any]]:
    """Stored rows of these specs and seeds."""
    whose = specs[0].setting.name, policy_name(specs[0].policy, specs[0].model)
    requested = {(each.variant.place, each.variant.mode, seed) for each in specs for seed in seeds}
    return [row for row in store.rows if (row["setting"], row["policy"]) == whose and _key(row) in requested]


def _calls(
    specs: Sequence[DriverSpec], seeds: Sequence[int], done: set[tuple[str, str, int]], engine: Engine, run: RunOptions
) -> list[tuple[_Chunk, list[int]]]:
    """Calls of `_run_chunk` for the seeds that are not done."""
    # Calls are short if each episode is stored as it finishes. The driver is cached between them.
    size = min(_CHUNK if run.store is None else engine.most, -(-len(seeds) // engine.workers))
    policy, model = specs[0].policy, specs[0].model
    files = hash_of_files(policy, model) if isinstance(policy, str) else ""
    calls = []
    for spec in specs:
        chunk = _Chunk(spec, files, run.steps, run.store is not None)
        left = [seed for seed in seeds if (spec.variant.place, spec.variant.mode, seed) not in done]
        calls += [(chunk, left[i : i + size]) for i in range(0, len(left), size)]
    return calls


class _Chunk(NamedTuple):
    """What the episodes of a call have in common.

    Attributes
    ----------
    spec : specification of the driver.
    files : hashes of the policy's files.
    steps : whether the decisions are recorded.
    kept : whether the driver is cached between calls.
    """

    spec: DriverSpec
    files: str
    steps: bool
    kept: bool

    def driver(self) -> Driver:
        """Make a driver of the spec.

        Raises
        ------
        PolicyError
            If the files of the policy have changed since the hashes were taken.
        """
        driver = Driver(self.spec)
        if isinstance(self.spec.policy, str):
            check_files(self.spec.policy, self.spec.model, self.files)
        return driver


def _run_chunk(chunk: _Chunk, seeds: list[int]) -> list[dict[str, Any]]:
    with one_thread():
        if chunk.kept and isinstance(chunk.spec.policy, str):
            driver = _kept(chunk)
            return [_row(driver, seed, chunk.steps) for seed in seeds]
        driver = chunk.driver()
        try:
            return [_row(driver, seed, chunk.steps) for seed in seeds]
        finally:
            driver.env.close()


def _row(driver: Driver, seed: int, steps: bool) -> dict[str, Any]:
    """Row of an episode."""
    row = driver.run(seed).row()
    return {**row, "decisions": json.dumps(driver.steps())} if steps else row


@lru_cache(maxsize=4)
def _kept(chunk: _Chunk) -> Driver:
    """A driver, cached between calls while the policy's files stay the same."""
    return chunk.driver()
