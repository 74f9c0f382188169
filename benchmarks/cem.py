"""Planning to park: HighwayEnv's notebook, our planner on the true model, and on learned models, side by side.

Time per decision is the processor's, on the same observations, in turns, in one thread; the ratio is to the notebook
as it is (with autograd's graphs). Outcomes are driven on evaluation seeds, with models of several training seeds;
`--models` names a folder with one folder per training seed, where models are kept or made (20 s each).

    python benchmarks/cem.py --train 0 --episodes 50
    python benchmarks/cem.py --train 0,1,2,3,4 --episodes 200 --setting parking

What each part of the planner is worth, on one learned model (`--train bundled` is the one that comes with the package):

    python benchmarks/cem.py --ablation --train bundled --episodes 50
"""

from __future__ import annotations

import argparse
import json
import platform
from dataclasses import dataclass
from pathlib import Path
from time import thread_time
from typing import Any

import joblib
import numpy as np

from evaluation.measuring.statistics import wilson
from evaluation.running.parking_planner import BUNDLED, CAUTION, TEMPERATURE, load, network, save, train, train_notebook
from evaluation.settings import get_setting
from evaluation.threads import one_thread
from mpc.cem_policy import CEMPolicy
from mpc.tasks.cautious_parking import CautiousTask
from mpc.tasks.notebook import NotebookPolicy
from mpc.tasks.parking import ParkingTask, parking_settings

POLICIES = ("notebook", "notebook, inference mode", "oracle", "oracle, fast", "learned", "learned, fast")
DRIVEN = ("notebook", "oracle", "learned", "learned, fast")
_ORDER = (*(name for name in POLICIES if name != "oracle"), "oracle")
ABLATION = ("plain CEM", "iCEM", "multi-start", "MPPI", "multi-start, disagreement", "multi-start, oracle")
"""Ways to search with 4 x 128 samples, all but the last on the learned model; the multi-start is `learned` again."""


@dataclass(frozen=True)
class Outcome:
    """How an episode ended."""

    success: bool
    crashed: bool
    speed: float
    decisions: int
    fallbacks: int


def make(name: str, env: Any, models: Path) -> Any:
    """A policy of `POLICIES` on the models in a folder."""
    if name == "notebook":
        return NotebookPolicy(load(models)[1])
    if name == "notebook, inference mode":
        return NotebookPolicy(load(models)[1], inference=True)
    if name in ABLATION:
        return _ablated(name, env, models)
    settings = parking_settings("fast" if name.endswith("fast") else "quality")
    return CEMPolicy.parking(env, load(models)[0] if name.startswith("learned") else None, settings)


def _ablated(name: str, env: Any, models: Path) -> CEMPolicy:
    """A policy of `ABLATION`."""
    model = None if name.endswith("oracle") else load(models)[0]
    if name == "MPPI":
        return CEMPolicy.parking(env, model, temperature=TEMPERATURE)
    if name.endswith("disagreement"):
        return CEMPolicy.parking(env, model, task=CautiousTask(ParkingTask(env), network(models), CAUTION))
    profiles = {"plain CEM": "plain", "iCEM": "icem"}
    return CEMPolicy.parking(env, model, parking_settings(profiles.get(name, "quality")))


def drive(setting: str, name: str, models: Path, seeds: list[int]) -> list[Outcome]:
    """One episode for each seed."""
    env = get_setting(setting).make()
    env.reset(seed=seeds[0])
    policy, outcomes = make(name, env, models), []
    with one_thread():
        for seed in seeds:
            observation, _ = env.reset(seed=seed)
            state, steps, done, info = None, 0, False, {}
            before = getattr(policy, "fallbacks", 0)
            while not done:
                action, state = policy.predict(observation, state, np.array([steps == 0]), deterministic=True)
                observation, _, terminated, truncated, info = env.step(action)
                steps, done = steps + 1, terminated or truncated
            ego = env.unwrapped.vehicle
            success = bool(info["is_success"]) and not ego.crashed
            fallbacks = getattr(policy, "fallbacks", 0) - before
            outcomes.append(Outcome(success, bool(ego.crashed), abs(float(ego.speed)), steps, fallbacks))
    env.close()
    return outcomes


def times(setting: str, models: Path, seeds: range, decisions: int, names: tuple[str, ...]) -> dict[str, list[float]]:
    """Processor time [ms] of each decision of all policies along the same episodes; the last, an oracle, drives."""
    env = get_setting(setting).make()
    env.reset(seed=seeds[0])
    policies = {name: make(name, env, models) for name in names}
    spent: dict[str, list[float]] = {name: [] for name in names}
    with one_thread():
        for seed in seeds:
            observation, _ = env.reset(seed=seed)
            states: dict[str, Any] = dict.fromkeys(names)
            for step in range(decisions):
                actions = {}
                for name, policy in policies.items():
                    begin = thread_time()
                    actions[name], states[name] = policy.predict(observation, states[name], np.array([step == 0]))
                    spent[name].append(1e3 * (thread_time() - begin))
                observation, _, terminated, truncated, _ = env.step(actions[names[-1]])
                if terminated or truncated:
                    break
    return spent


def percent(count: int, n: int) -> str:
    """A rate with its Wilson interval."""
    interval = wilson(count, n)
    return f"{100 * interval.estimate:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def prepare(folder: Path, seed: int | None) -> Path:
    """The folder of a training seed's models; they are made if there are none."""
    if seed is None:
        return BUNDLED
    path = folder / str(seed)
    if not (path / "cem-notebook.npz").is_file():
        path.mkdir(parents=True, exist_ok=True)
        with one_thread():
            trained = train(seed)
            save(trained, train_notebook(seed), path)
        print(f"training seed {seed}: {len(trained.data)} transitions, {trained.seconds:.1f} s", flush=True)
    return path


def main() -> None:
    """Print both tables, and write them as JSON beside the models."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", default="0", help="training seeds, a comma list, or bundled")
    parser.add_argument("--episodes", type=int, default=50, help="episodes for each training seed")
    parser.add_argument("--seed", type=int, default=100_000, help="seed of the first episode")
    parser.add_argument("--setting", default="parking", help="parking or parking-parked")
    parser.add_argument("--models", type=Path, default=Path("runs", "cem"), help="folder of the models")
    parser.add_argument("--policies", help=f"what is driven, separated by slashes: {'/'.join((*POLICIES, *ABLATION))}")
    parser.add_argument("--ablation", action="store_true", help="drive and time the ways to search instead")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--timed", type=int, default=4, help="episodes along which times are measured; 0 for none")
    options = parser.parse_args()
    training = [None if seed == "bundled" else int(seed) for seed in options.train.split(",")]
    driven = tuple(options.policies.split("/")) if options.policies else ABLATION if options.ablation else DRIVEN
    unknown = sorted(set(driven) - {*POLICIES, *ABLATION})
    if unknown:
        parser.error(f"unknown policies {unknown}; have {', '.join((*POLICIES, *ABLATION))}")
    folders = [prepare(options.models, seed) for seed in training]
    report: dict[str, Any] = {"setting": options.setting, "machine": platform.processor() or platform.machine()}
    if options.timed:
        names = ("notebook", *ABLATION) if options.ablation else _ORDER
        spent = times(options.setting, folders[0], range(5000, 5000 + options.timed), 25, names)
        base = float(np.median(spent["notebook"]))
        print(f"\n| {options.setting}: planning | p50 ms | p99 ms | p50 / notebook |\n|:--|--:|--:|--:|")
        for name, values in spent.items():
            p50, p99 = np.quantile(values, [0.5, 0.99])
            print(f"| {name} | {p50:.2f} | {p99:.2f} | {p50 / base:.3f} |")
            report[f"time, {name}"] = {"p50_ms": p50, "p99_ms": p99, "ratio": p50 / base}
    print(f"\n| {options.setting} | episodes | success % | crash % | timeout % | stopped % | decisions | fallbacks |")
    print("|:--|--:|--:|--:|--:|--:|--:|--:|", flush=True)
    seeds = list(range(options.seed, options.seed + options.episodes))
    size = min(25, -(-len(seeds) // max(options.jobs, 1)))
    for name in driven:
        # The true model has nothing to train; the planner's own seed is the same.
        used = folders[:1] if "oracle" in name else folders
        calls = [(options.setting, name, f, seeds[i : i + size]) for f in used for i in range(0, len(seeds), size)]
        parts = joblib.Parallel(n_jobs=options.jobs)(joblib.delayed(drive)(*call) for call in calls)
        outcomes = [outcome for part in parts for outcome in part]
        n = len(outcomes)
        counts = {
            "success": sum(o.success for o in outcomes),
            "crash": sum(o.crashed for o in outcomes),
            "timeout": sum(not o.success and not o.crashed for o in outcomes),
            "stopped": sum(o.success and o.speed < 1.0 for o in outcomes),
        }
        rates = " | ".join(percent(count, n) for count in counts.values())
        median = np.median([o.decisions for o in outcomes])
        print(f"| {name} | {n} | {rates} | {median:.0f} | {sum(o.fallbacks for o in outcomes)} |", flush=True)
        report[f"outcome, {name}"] = {"episodes": n, **counts}
    path = options.models / f"{options.setting}{'-ablation' if options.ablation else ''}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(f"\nwrote {path}")


if __name__ == "__main__":
    main()
