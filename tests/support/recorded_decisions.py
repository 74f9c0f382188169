"""Whether two revisions decide the same on every road: the decisions of recorded episodes, compared one by one.

    make decisions                      # compare with the file in the repository
    make decisions RECORD=--record      # write it anew, at a revision that means to differ
    python tests/support/recorded_decisions.py --only merge-v0

Each cell of the table in docs/lab/what-it-drives.md that is served (environment, kind of action, settings, wrapper) is
driven for some decisions with actions that a seed draws. Of each decision the file has what was executed, reason, tier,
guarantee, what was done, margin, binding clause and vehicle, overridden frames, and the ego's state afterwards.
`tests/shield/test_recorded_decisions.py` compares a part of them by default.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
from joblib import Parallel, delayed

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "benchmarks")]
from what_it_drives import ACTIONS, CONFIGS, config_of, env_ids  # noqa: E402

from dynamics.traffic.crossing import make  # noqa: E402
from shield import Shield, ShieldedEnv  # noqa: E402
from shield.errors import ShieldError  # noqa: E402

FILE = ROOT / "tests" / "data" / "recorded_decisions.parquet"
DECISIONS, SEED = 10, 7
CLOSE = 1e-9
"""Tolerance of numbers on a processor that rounds as the recording one did, relative to their size or 1."""
ROUNDED = 0.05
"""The same on a processor that rounds otherwise: a search for the nearest input may end elsewhere there."""
MADE_ON = FILE.with_suffix(".json")
"""Fingerprint of the arithmetic of the machine that recorded."""
WRAPPERS = ("ShieldedEnv", "Shield", "Shield, no frames")
NOT_MADE = (TypeError, ValueError, KeyError, AttributeError, IndexError)
"""What highway-env raises where it does not make or drive an environment with a kind of action."""
TEXTS = ("reason", "tier", "guarantee", "done", "clause")
NUMBERS = ("margin", "executed_0", "executed_1", "x", "y", "heading", "speed")
COUNTS = ("vehicle", "frames_overridden")


class Cell(NamedTuple):
    """A cell of the table in docs/lab/what-it-drives.md."""

    env_id: str
    action: str
    settings: str
    wrapper: str

    def __str__(self) -> str:
        return "; ".join(self)


def cells(only: Sequence[str] = ()) -> list[Cell]:
    """All cells, served or not, of these environments."""
    return [
        Cell(env_id, action, settings, wrapper)
        for env_id in env_ids()
        if not only or env_id in only
        for action in ACTIONS
        if config_of(env_id, action) is not None
        for settings in CONFIGS
        for wrapper in WRAPPERS
    ]


def proposals(space: Any, rng: np.random.Generator) -> Any:
    """An action of a space: of meta-actions FASTER half of the time, of the others uniform ones."""
    if isinstance(space, gym.spaces.Tuple):
        return tuple(proposals(part, rng) for part in space)
    if isinstance(space, gym.spaces.Box):
        return rng.uniform(-0.6, 1.0, space.shape).astype(space.dtype)
    faster = {5: 3, 3: 2}.get(int(space.n))
    return faster if faster is not None and rng.random() < 0.5 else int(rng.integers(space.n))


def driven(cell: Cell) -> Iterator[dict[str, Any]]:
    """A row for each decision of a cell and each ego in it; none where it is not served."""
    proposal: list[Any] = [None]
    settings, rng = CONFIGS[cell.settings](), np.random.default_rng(SEED)
    try:
        env = make(cell.env_id, config_of(cell.env_id, cell.action) or {})
        observation, _ = env.reset(seed=SEED)
        if cell.wrapper == "ShieldedEnv":
            shield: Any = ShieldedEnv(env, settings)
            shield.reset(seed=SEED)
        else:
            shield = Shield(lambda _: proposal[0], env, settings, frames=cell.wrapper == "Shield")
        for k in range(DECISIONS):
            proposal[0] = proposals(env.action_space, rng)
            if isinstance(shield, ShieldedEnv):
                _, _, terminated, truncated, _ = shield.step(proposal[0])
            else:
                observation, _, terminated, truncated, _ = env.step(shield.predict(observation)[0])
            for ego, decision in enumerate(shield.last_decisions):
                yield {"cell": str(cell), "k": k, "ego": ego, **_row(decision, env.unwrapped.controlled_vehicles[ego])}
            if terminated or truncated:
                return
    except (ShieldError, *NOT_MADE) as error:
        logging.getLogger(__name__).debug("%s: %s", cell, error)


def _row(decision: Any, ego: Any) -> dict[str, Any]:
    executed = [*np.ravel(np.asarray(decision.executed, float)), np.nan][:2]
    texts = (decision.reason, decision.tier, decision.guarantee, decision.intervention, decision.clause)
    numbers = (decision.margin, *executed, *ego.position, ego.heading, ego.speed)
    return {
        **dict(zip(TEXTS, map(str, texts), strict=True)),
        **dict(zip(NUMBERS, map(float, numbers), strict=True)),
        **dict(zip(COUNTS, (decision.vehicle, decision.frames_overridden), strict=True)),
    }


def decided(which: Sequence[Cell], jobs: int = 1) -> pd.DataFrame:
    """What is decided in these cells now, with `jobs` processes. Environments have traffic of their own (`make`):
    highway-env's intersections change the classes of the process otherwise, and what is driven after them."""
    by_env: dict[str, list[Cell]] = {}
    for cell in which:
        by_env.setdefault(cell.env_id, []).append(cell)
    found = Parallel(n_jobs=jobs)(delayed(_rows)(each) for each in by_env.values())
    return pd.DataFrame([row for rows in found for row in rows])


def _rows(which: Sequence[Cell]) -> list[dict[str, Any]]:
    with _quiet():
        return [row for cell in which for row in driven(cell)]


@contextmanager
def _quiet() -> Iterator[None]:
    """No warning and no log line up to WARNING inside, and both as before afterwards."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


def fingerprint() -> str:
    """Digest of how this machine rounds: sines, powers, products and solutions of linear equations [hex]."""
    x = np.random.default_rng(0).uniform(-4.0, 4.0, (8, 8))
    parts = [np.sin(x), np.cos(x), np.tan(x), np.arctan(x), np.exp(x), np.abs(x) ** 1.7, x @ x, np.linalg.inv(x)]
    return sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def rounds_as_recorded() -> bool:
    """Whether this machine's arithmetic is that of the machine that recorded."""
    return bool(json.loads(MADE_ON.read_text(encoding="utf-8"))["fingerprint"] == fingerprint())


def differences(before: pd.DataFrame, now: pd.DataFrame, exactly: bool = True) -> Iterator[str]:
    """A line for the first decision of each cell that is another than before.

    Parameters
    ----------
    before, now : decisions as `decided` returns them.
    exactly : whether numbers agree to `CLOSE`. Otherwise a cell is compared up to its first decision that rounding has
        changed: all texts and counts are equal there, and the numbers to `ROUNDED`.
    """
    ours = dict(tuple(now.groupby("cell"))) if len(now) else {}
    for cell, old in before.groupby("cell"):
        new = ours.pop(cell, None)
        if new is None:
            yield f"{cell}: is not served any more"
            continue
        old, new = old.reset_index(drop=True), new.reset_index(drop=True)
        for row in range(max(len(old), len(new))):
            told = _told(old, new, row)
            if told and not exactly and not _told(old, new, row, ROUNDED):
                break
            if told:
                yield f"{cell}: {told}"
                break
    for cell in ours:
        yield f"{cell}: was not served before"


def _told(old: pd.DataFrame, new: pd.DataFrame, row: int, close: float = CLOSE) -> str:
    """In what a decision is another, "" where in nothing."""
    if row >= min(len(old), len(new)):
        return f"{len(new)} decisions, {len(old)} before"
    a, b = old.loc[row], new.loc[row]
    other = [name for name in ("k", "ego", *TEXTS, *COUNTS) if a[name] != b[name]]
    other += [name for name in NUMBERS if not np.isclose(a[name], b[name], rtol=close, atol=close, equal_nan=True)]
    return f"decision {a.k}: " + ", ".join(f"{name} {a[name]} -> {b[name]}" for name in other) if other else ""


_FORMER_CLAUSES = {"slip-in": "cut-in"}
"""Present names of clauses, by the name in the file."""


def recorded() -> pd.DataFrame:
    """The decisions at the revision that wrote the file, with the present names of clauses."""
    return pd.read_parquet(FILE).replace({"clause": _FORMER_CLAUSES})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="write the file anew")
    parser.add_argument("--only", nargs="*", default=[], help="environments")
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    if asked.record and asked.only:
        parser.error("--record writes all cells: leave --only out")
    which = cells(asked.only)
    now = decided(which, asked.jobs)
    if asked.record:
        FILE.parent.mkdir(exist_ok=True)
        now.to_parquet(FILE, index=False, compression="zstd")
        MADE_ON.write_text(json.dumps({"fingerprint": fingerprint()}, indent=1) + "\n", encoding="utf-8")
        print(f"{len(now)} decisions of {now.cell.nunique()} cells are recorded in {FILE.relative_to(ROOT)}")
        return
    before = recorded()
    before = before[before.cell.isin(set(map(str, which)))]
    exactly = rounds_as_recorded()
    if not exactly:
        print("This machine rounds otherwise than the recording one: cells are compared up to where that shows.")
    found = list(differences(before, now, exactly))
    print(*found, sep="\n")
    print(f"{len(found)} of {before.cell.nunique()} cells differ, {len(before)} decisions")
    raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
