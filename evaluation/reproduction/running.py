"""The whole experiment: training and driving part by part, each stored as it finishes.

A part is a variant and a training seed. The folder contains `models/VARIANT-SEED.zip`, each with a manifest beside it,
`parts/VARIANT-SEED.parquet`, each with a record of its origin, and `manifest.json`. It is a store of episodes
(`evaluation.running.store`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import pandas as pd

from evaluation.learning.algorithms import get_algorithm, load_model
from evaluation.reproduction.batch import ReportBatch
from evaluation.reproduction.driving import drive_many
from evaluation.reproduction.learning import hyperparameters, is_trained, train_variant
from evaluation.reproduction.live import drive_one_by_one
from evaluation.reproduction.presets import Preset
from evaluation.reproduction.variants import ReportVariant
from evaluation.running.highway_planner import highway_policy
from evaluation.running.identity import differences, file_hash, versions
from evaluation.running.manifest import commit, provenance
from evaluation.running.parts import Parts
from evaluation.running.processes import in_processes
from evaluation.running.roundabout_planner import roundabout_policy
from shield.errors import ConfigError

__all__ = ["FIRST_SEED", "Reproduction", "first_seed", "run", "unsupported_reason"]

FIRST_SEED = 970_000
"""Seed of the first episode of the first training seed on the highway."""
_SEEDS = {"highway": (FIRST_SEED, 10_000), "roundabout": (1_830_000, 1_000)}
"""For each road (first, stride): the episodes of training seed k have seeds from first + k * stride on."""
_SHOWN = 6
_PHASES = ("training", "driving")


def first_seed(preset: Preset) -> int:
    """Seed of the first episode of the first training seed."""
    return _SEEDS[preset.road][0]


@dataclass(frozen=True)
class Reproduction:
    """Specification of the experiment.

    Attributes
    ----------
    preset, variants : the preset and its variants.
    seeds : number of training seeds, from 0 on.
    episodes : episodes of each variant and training seed.
    pooled : episodes of each slow variant and training seed (`takes_long`).
    steps : number of training steps.
    """

    preset: Preset
    variants: tuple[ReportVariant, ...]
    seeds: int = 10
    episodes: int = 1_000
    pooled: int = 30
    steps: int = 10_000

    def __post_init__(self) -> None:
        for name in ("seeds", "episodes", "pooled", "steps"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, not {getattr(self, name)}")
        most = _SEEDS[self.preset.road][1]
        if max(self.episodes, self.pooled) > most:
            raise ConfigError(
                f"episodes are at most {most:,} for each training seed, not {max(self.episodes, self.pooled):,}"
            )

    def scenes(self, variant: ReportVariant, seed: int) -> range:
        """Seeds of the episodes of a training seed, the same for all variants."""
        first, stride = _SEEDS[self.preset.road]
        first += stride * seed
        return range(first, first + (self.pooled if self.takes_long(variant) else self.episodes))

    def takes_long(self, variant: ReportVariant) -> bool:
        """Whether a variant is slow and has `pooled` episodes.

        Such a variant is driven one episode at a time, or with a shield that simulates the traffic on the roundabout.
        """
        return variant.pooled or (bool(variant.shield) and self.preset.road == "roundabout")

    def as_dict(self, variant: ReportVariant) -> dict[str, Any]:
        """The values that determine the rows of a variant, as plain values."""
        specified: dict[str, Any] = {"preset": self.preset.as_dict(), "variant": variant.as_dict()}
        if variant.learner and variant.learner != "cem":
            specified |= {"training steps": self.steps, "hyperparameters": hyperparameters(self.preset, variant)}
        plain: dict[str, Any] = json.loads(json.dumps(specified))
        return plain


def unsupported_reason(preset: Preset, variant: ReportVariant) -> str:
    """The reason why a variant is unsupported here; "" if it is supported."""
    try:
        on_highway = preset.road == "highway"
        if variant.default_road and on_highway:
            return "it is driven on the roundabout"
        if variant.observed and not on_highway:
            return "scenes are made from observations on straight highways only"
        if variant.shield == "actions" and not on_highway:
            return "on this road ShieldedEnv replaces whole actions too, and its row is this one"
        if variant.learner == "cem":
            (highway_policy if on_highway else roundabout_policy)(preset.setting.make())
        elif variant.learner:
            get_algorithm(variant.learner)
        if not variant.pooled:
            ReportBatch(preset, variant, 1)
    except ConfigError as error:
        return str(error)
    return ""


def run(
    experiment: Reproduction, folder: Path, jobs: int = 1, tell: Callable[[str], None] | None = None
) -> pd.DataFrame:
    """Train and drive the parts that are not in the folder yet, and return all rows.

    Parameters
    ----------
    experiment : specification of the experiment.
    folder : folder of the results.
    jobs : processes; -1 for one per core.
    tell : called with a line after each part, with one process only.

    Returns
    -------
    A row for each episode: preset, variant, training_seed, and `evaluation.reproduction.driving.COLUMNS`.

    Raises
    ------
    ConfigError
        If the folder holds parts of another experiment, or cannot be written.
    """
    for name in ("models", "parts"):
        try:
            (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder} cannot be written: {error.strerror}") from None
    _adopt(folder)
    commit()  # cached now, so that it is the commit of the imported source
    left_out = {
        each.name: reason for each in experiment.variants if (reason := unsupported_reason(experiment.preset, each))
    }
    variants = [each for each in experiment.variants if each.name not in left_out and each.model not in left_out]
    for variant in variants:
        for seed in range(experiment.seeds):
            _check(experiment, variant, seed, folder)
    began = time.perf_counter()
    workers = joblib.effective_n_jobs(jobs)
    calls = [(experiment, variants, seed, folder, tell if workers == 1 else None) for seed in range(experiment.seeds)]
    frames = [frame for parts in in_processes(_seed, calls, workers) for frame in parts]
    whole = pd.concat(frames, ignore_index=True)
    order = {each.name: k for k, each in enumerate(variants)}
    whole = whole.sort_values(
        ["variant", "training_seed", "seed"],
        key=lambda column: column.map(order) if column.name == "variant" else column,
    ).reset_index(drop=True)
    _write_manifest(experiment, variants, left_out, folder, time.perf_counter() - began)
    return whole


def _seed(
    experiment: Reproduction,
    variants: Sequence[ReportVariant],
    seed: int,
    folder: Path,
    tell: Callable[[str], None] | None,
) -> list[pd.DataFrame]:
    """All parts of one training seed; a model is trained before a variant that shares it is driven."""
    return [_part(experiment, variant, seed, folder, tell) for variant in variants]


def _adopt(folder: Path) -> None:
    """Convert the rows of an earlier version, with a file of their record beside them, to parts."""
    for rows in sorted((folder / "episodes").glob("*.parquet")):
        record = rows.with_suffix(".json")
        if record.is_file():
            made = json.loads(record.read_text(encoding="utf-8"))
            made["commit"] = made.pop("revision")
            Parts(folder).write(rows.stem, pd.read_parquet(rows), made)
            rows.unlink()
            record.unlink()


def _names(variant: ReportVariant, seed: int, folder: Path) -> tuple[Path, str]:
    """Path of the model, and name of the part."""
    return folder / "models" / f"{variant.model or variant.name}-{seed}.zip", f"{variant.name}-{seed}"


@dataclass(frozen=True)
class _Clock:
    """Elapsed time and processor time of this process [s]."""

    wall: float
    cpu: float

    @classmethod
    def now(cls) -> _Clock:
        return cls(time.perf_counter(), time.process_time())


def _by_phase(began: float, trained: float, driven: float) -> dict[str, float]:
    return dict(zip(_PHASES, (round(trained - began, 2), round(driven - trained, 2)), strict=True))


def _check(experiment: Reproduction, variant: ReportVariant, seed: int, folder: Path) -> None:
    """Check that existing rows have the same specification, versions and model; raises `ConfigError` otherwise."""
    model, part = _names(variant, seed, folder)
    before = Parts(folder).record(part)
    if before is None:
        return
    differ = differences(before["asked"], experiment.as_dict(variant))
    differ += differences({"version of": before["versions"]}, {"version of": versions()})
    if before["model"] and model.is_file() and file_hash(model) != before["model"]["sha256"]:
        differ.append(f"the model {model.name}")
    if differ:
        raise ConfigError(
            f"{folder} holds episodes of another experiment: of {variant.name}, {', '.join(differ[:_SHOWN])} differ; "
            "take another --out"
        )


def _part(
    experiment: Reproduction, variant: ReportVariant, seed: int, folder: Path, tell: Callable[[str], None] | None
) -> pd.DataFrame:
    """The rows of one part; missing ones are made, existing ones are read."""
    path, part = _names(variant, seed, folder)
    scenes, preset, parts = experiment.scenes(variant, seed), experiment.preset, Parts(folder)
    before = parts.read(part) if parts.has(part) else pd.DataFrame({"seed": []})
    before.attrs = {}
    left = [each for each in scenes if each not in set(before["seed"])]
    if not left:
        return before[before["seed"].isin(scenes)]
    began, model = _Clock.now(), None
    if variant.trains and not is_trained(path):
        train_variant(preset, variant, seed, experiment.steps, path)
    trained = _Clock.now()
    if variant.learner and variant.learner != "cem":
        model = load_model(path)
    drive = drive_one_by_one if variant.pooled else drive_many
    driven = drive(preset, variant, model, left)
    driven_at = _Clock.now()
    driven.insert(0, "preset", preset.name)
    driven.insert(1, "variant", variant.name)
    driven.insert(2, "training_seed", seed)
    frame = pd.concat([before, driven], ignore_index=True) if len(before) else driven
    manifest = {
        "asked": experiment.as_dict(variant),
        "model": None if model is None else {"file": path.name, "sha256": file_hash(path)},
        "training_seed": seed,
        "seeds": [int(frame["seed"].min()), int(frame["seed"].max())],
        "commit": commit(),
        "seconds": _by_phase(*(each.wall for each in (began, trained, driven_at))),
        "cpu_seconds": _by_phase(*(each.cpu for each in (began, trained, driven_at))),
        "versions": versions(),
    }
    parts.write(part, frame, manifest)
    if tell is not None:
        crashes = int(driven["crashed"].sum())
        tell(
            f"seed {seed}, {variant.name}: {crashes} of {len(driven)} crashed, return {driven['return'].mean():.2f}"
            f" ({driven_at.wall - began.wall:.0f} s, {driven_at.cpu - began.cpu:.0f} CPU seconds)"
        )
    return frame[frame["seed"].isin(scenes)]


def _processor_time(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """CPU seconds by variant and their sum, over the training seeds with CPU seconds in their records."""
    found: dict[str, dict[str, float]] = {}
    for each in records:
        if "cpu_seconds" in each:
            row = found.setdefault(each["asked"]["variant"]["name"], {**dict.fromkeys(_PHASES, 0.0), "parts": 0})
            for phase in _PHASES:
                row[phase] = round(row[phase] + each["cpu_seconds"][phase], 1)
            row["parts"] += 1
    total = sum(row[phase] for row in found.values() for phase in _PHASES)
    return {"total": round(total, 1), "parts without": sum("cpu_seconds" not in each for each in records), **found}


def _write_manifest(
    experiment: Reproduction, variants: Sequence[ReportVariant], left_out: dict[str, str], folder: Path, seconds: float
) -> None:
    """Write the manifest of the whole experiment, with the hash of each model file."""
    parts = Parts(folder)
    names = [_names(variant, seed, folder)[1] for variant in variants for seed in range(experiment.seeds)]
    records = [record for name in names if (record := parts.record(name)) is not None]
    specified = {
        "preset": experiment.preset.name,
        "variants": {each.name: experiment.as_dict(each)["variant"] for each in variants},
        **{name: getattr(experiment, name) for name in ("seeds", "episodes", "pooled", "steps")},
        "first seed": first_seed(experiment.preset),
    }
    models = {each["model"]["file"]: each["model"]["sha256"] for each in records if each["model"]}
    spent = {key: round(sum(each["seconds"][key] for each in records), 1) for key in _PHASES}
    manifest = {
        **provenance(specified, models=models),
        "commits of parts": sorted({each["commit"] for each in records}),
        "seconds of this call": round(seconds, 1),
        "seconds of parts": spent,
        "CPU seconds of parts": _processor_time(records),
        "left out": left_out,
    }
    parts.claim(manifest)
