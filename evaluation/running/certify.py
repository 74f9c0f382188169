"""Batches of shielded episodes in parts that are stored as they finish, and the bound on the crash rate."""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import joblib
import pandas as pd

from evaluation.measuring.statistics import bootstrap_mean, clopper_pearson
from evaluation.running.batch_episodes import Many
from evaluation.running.decision_log import MEASURED
from evaluation.running.driver import policy_name
from evaluation.running.episodes import run_paired
from evaluation.running.identity import check_files, hash_of_files, model_hashes, of_environment, of_policy
from evaluation.running.manifest import check_fits, extended, provenance
from evaluation.running.named_policies import is_model, make_policy
from evaluation.running.parts import Parts
from evaluation.running.records import ShieldVariant, rules_text, variant_for
from evaluation.settings import Setting
from evaluation.simulators import compiled_if_supported
from shield.config import ShieldConfig
from shield.decision import Tier
from shield.errors import ConfigError

__all__ = ["CertifyRun", "certify", "page"]

_PART = 1_000
"""Episodes of a part: the most that each process loses if a run is killed."""
COLUMNS = (
    "setting",
    "policy",
    "mode",
    "seed",
    "crashed",
    "off_road",
    "attribution",
    "return",
    "steps",
    "mean_speed",
    "overridden",
    "held_back",
    "frames",
    "frames_overridden",
    "violations",
    "min_margin",
    "min_gap",
    "simulator",
    "rules",
    *MEASURED,
)
FALLBACKS = [f"tier_{tier.value}" for tier in Tier if tier.fallback]
_PART_NAME = re.compile(r"\d+-\d+")
_SHOWN = 20


@dataclass(frozen=True, slots=True)
class CertifyRun:
    """Specification of a run.

    Attributes
    ----------
    setting : the environment.
    policy : name of a policy, or path of a zip file.
    episodes : number of episodes.
    seed : seed of the first episode.
    config : the shield's settings.
    simulator : one of `SIMULATORS`.
    """

    setting: Setting
    policy: str
    episodes: int
    seed: int
    config: ShieldConfig
    simulator: str = "auto"

    @property
    def variant(self) -> ShieldVariant:
        """The variant of the shield between the policy and the environment."""
        return variant_for(self.config, self.setting)

    def as_dict(self) -> dict[str, Any]:
        """The specification as plain values, with the keys of
        `evaluation.running.comparing.Comparison.specification`."""
        shield = f"{self.setting.name}, {self.variant.place}, {self.variant.mode}"
        return {
            "settings": {self.setting.name: of_environment(self.setting)},
            "policies": {policy_name(self.policy, None): {"name": self.policy, **self._policy()}},
            "shields": {shield: tomllib.loads(self.config.to_toml())},
            "seed": self.seed,
            "episodes": self.episodes,
            "simulator": self.simulator,
        }

    @property
    def models(self) -> dict[str, str]:
        """Hash of each model file, by its name."""
        return model_hashes([self.policy])

    def _policy(self) -> dict[str, Any]:
        """Identity of the policy's files; a model is loaded and checked in the environment."""
        if not is_model(self.policy):
            return of_policy(self.policy)
        env = self.setting.make()
        try:
            return of_policy(self.policy, make_policy(self.policy, env))
        finally:
            env.close()

    def parts(self) -> list[tuple[int, int]]:
        """Seed of the first episode of each part, and number of its episodes."""
        last = self.seed + self.episodes
        return [(first, min(_PART, last - first)) for first in range(self.seed, last, _PART)]


def certify(certify_run: CertifyRun, folder: str | Path, jobs: int = 1, progress: Any = None) -> pd.DataFrame:
    """Drive the episodes that are not in the folder yet, and return all of them.

    Parameters
    ----------
    certify_run : specification of the run.
    folder : folder of the parts (see `evaluation.running.parts.Parts`). A run can extend one with fewer episodes.
    jobs : processes; -1 for one per core.
    progress : called with the table of each part as it finishes.

    Returns
    -------
    A row for each episode, by seed: setting, policy, mode, seed, crashed, off_road, attribution, return, steps,
    mean_speed [m/s], overridden, held_back, frames, frames_overridden, violations, min_margin and min_gap [m],
    simulator, rules (number of violations by rule, as a text), and `fallbacks`, the number of decisions with a
    fallback. Then the columns `evaluation.running.decision_log.MEASURED`; those in
    `evaluation.running.batch_episodes.UNMEASURED` are NaN for episodes of a batch.

    Raises
    ------
    ConfigError
        If `episodes` is less than 1, or the folder holds the parts of another run or cannot be written.
    """
    if certify_run.episodes < 1:
        raise ConfigError(f"have at least one episode, not {certify_run.episodes}")
    folder = Path(folder)
    parts = Parts(folder)
    _claim(parts, certify_run)
    left = [part for part in certify_run.parts() if not parts.has(_name(*part))]
    files = hash_of_files(certify_run.policy)
    for frame in _driven(partial(_drive, certify_run, folder, files), left, joblib.effective_n_jobs(jobs)):
        if progress is not None:
            progress(frame)
    whole = pd.concat([parts.read(_name(*part)) for part in certify_run.parts()], ignore_index=True)
    # Parts of an older version lack some columns.
    whole["placement"] = certify_run.variant.place
    whole = whole if "rules" in whole else whole.assign(rules=None)
    whole.attrs["made"] = parts.manifest
    return whole


def _claim(parts: Parts, certify_run: CertifyRun) -> None:
    """Write the specification into the folder, or raise `ConfigError` if the folder belongs to another run."""
    _adopt(parts, certify_run)
    made = provenance(json.loads(json.dumps(certify_run.as_dict())), models=certify_run.models)
    before = parts.manifest
    if before is not None:
        for key in ("settings", "policies", "shields"):
            if (was := before.get("asked", {}).get(key, {})).keys() != (now := made["asked"][key]).keys():
                raise ConfigError(
                    f"{parts.folder} holds episodes of another run: of the {key} {', '.join(was)}, and not "
                    f"{', '.join(now)}; take a new folder"
                )
        check_fits(str(parts.folder), before, made, "take a new folder")
        made = extended(before, made)
    parts.claim(made)


def _adopt(parts: Parts, certify_run: CertifyRun) -> None:
    """Convert a folder of an earlier version, with parts beside asked.json and other keys in it, to a store."""
    note = parts.folder / "asked.json"
    if not note.is_file():
        return
    old = json.loads(note.read_text(encoding="utf-8"))
    was = dict(old["asked"])
    policy, versions_then = was.pop("policy"), was.pop("version of")
    shield = f"{certify_run.setting.name}, {certify_run.variant.place}, {certify_run.variant.mode}"
    files = [path for path in parts.folder.glob("*.parquet") if _PART_NAME.fullmatch(path.stem)]
    count = sum(len(pd.read_parquet(path, columns=["seed"])) for path in files)
    words = {
        "settings": {certify_run.setting.name: was.pop("setting")},
        "policies": {policy_name(policy["name"], None): policy},
        "shields": {shield: was.pop("shield")},
    }
    parts.claim({**old, "asked": {**words, **was, "episodes": count}, "versions": versions_then})
    for path in files:
        path.replace(parts.folder / "parts" / path.name)
    note.unlink()


def _name(first: int, count: int) -> str:
    return f"{first}-{first + count - 1}"


def _driven(
    drive: Callable[[int, int], pd.DataFrame], parts: list[tuple[int, int]], workers: int
) -> Iterator[pd.DataFrame]:
    if workers == 1:
        yield from (drive(*part) for part in parts)
        return
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        pool = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")
        yield from pool(joblib.delayed(drive)(*part) for part in parts)


@lru_cache(maxsize=1)
def _episode_batch(certify_run: CertifyRun, files: str) -> Many | None:
    """The batch runner, or None where it is not supported; cached while `files`, the hashes of the policy's files, stay
    the same."""

    def compiled() -> tuple[Many, bool]:
        many = Many(certify_run.setting, certify_run.policy, certify_run.config)
        return many, many.exact

    try:
        return compiled_if_supported(certify_run.simulator, compiled)
    except ConfigError:
        return None  # `run_paired` may support the run, or raises an error that names what is missing


def _drive(certify_run: CertifyRun, folder: Path, files: str, first: int, count: int) -> pd.DataFrame:
    """Drive one part and write it atomically; `files` are the hashes of the policy's files."""
    seeds = range(first, first + count)
    check_files(certify_run.policy, None, files)
    many = _episode_batch(certify_run, files)
    if many is not None:
        frame = many.run(seeds)
    else:
        table = run_paired(
            certify_run.setting, certify_run.policy, [certify_run.variant], seeds, simulator=certify_run.simulator
        )
        frame = table[list(COLUMNS)].assign(fallbacks=table[FALLBACKS].sum(axis=1))
    frame.insert(2, "placement", certify_run.variant.place)
    check_files(certify_run.policy, None, files)
    Parts(folder).write(_name(first, count), frame)
    return frame


def _broken(episodes: pd.DataFrame) -> str:
    """Number of violations by rule in all episodes, in the format of `rules_text`."""
    rules: Counter[str] = Counter()
    for text in episodes["rules"].dropna():
        for rule, count in (each.rsplit(" ", 1) for each in text.split(", ") if each):
            rules[rule] += int(count)
    return rules_text(rules)


def page(episodes: pd.DataFrame) -> str:
    """Markdown report of the episodes: the bound, the distribution of clearances, and seeds to inspect."""
    n, crashes = len(episodes), int(episodes["crashed"].sum())
    bound, mean = clopper_pearson(crashes, n), bootstrap_mean(episodes["return"].to_numpy()[:100_000])
    gaps = episodes["min_gap"].astype(float)
    decisions, first = int(episodes["steps"].sum()), episodes.iloc[0]
    facts = {
        "episodes": f"{n:,} ({decisions:,} decisions, {int(episodes['frames'].sum()):,} frames), "
        f"seeds {episodes['seed'].min()} to {episodes['seed'].max()}, simulated by "
        + " and ".join(sorted(set(episodes["simulator"]))),
        "crashes": f"{crashes}; rate {bound.estimate:.2g}, 95 % Clopper-Pearson [{bound.low:.2g}, {bound.high:.2g}]",
        "return": f"{mean.estimate:.2f} [{mean.low:.2f}, {mean.high:.2f}]",
        "speed": f"{episodes['mean_speed'].mean():.1f} m/s",
        "decisions overridden": f"{100 * episodes['overridden'].sum() / decisions:.1f} %",
        "smallest clearance of bodies": f"{gaps.min():.3f} m (seed {episodes.loc[gaps.idxmin(), 'seed']}); "
        f"a thousandth of the episodes below {gaps.quantile(0.001):.2f} m",
        "smallest margin": f"{episodes['min_margin'].min():.3f} m",
        "violations of the assumptions": f"{int(episodes['violations'].sum())} "
        f"in {int((episodes['violations'] > 0).sum())} episodes",
        "rules that were broken": _broken(episodes) or "none",
        "decisions with a fallback": f"{int(episodes['fallbacks'].sum())} "
        f"in {int((episodes['fallbacks'] > 0).sum())} episodes",
    }
    title = f"# {first['policy']} on {first['setting']}, shield {first['mode']}"
    table = pd.DataFrame({"": list(facts), "found": list(facts.values())}).to_markdown(index=False)
    odd = episodes[(episodes["crashed"]) | (episodes["violations"] > 0) | (episodes["fallbacks"] > 0)]
    columns = ["seed", "crashed", "attribution", "min_gap", "min_margin", "violations", "rules", "fallbacks"]
    rows = odd.sort_values(["crashed", "min_gap"], ascending=[False, True])[columns].head(_SHOWN)
    seeds = "None." if rows.empty else rows.to_markdown(index=False, floatfmt=".3f")
    more = f"\n\nThe first {_SHOWN} of {len(odd)}." if len(odd) > _SHOWN else ""
    return f"{title}\n\n{table}\n\n## Episodes to look at\n\n`shield replay` drives each again.\n\n{seeds}{more}\n"
