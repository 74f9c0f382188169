"""Runs that are killed (`kill -9`) at random moments."""

from __future__ import annotations

import random
import subprocess
import time
from pathlib import Path

__all__ = ["episodes_kept", "kill_at_moments"]


def episodes_kept(table: Path) -> int:
    """How many episodes of a table that is to come are on the disk, in no part."""
    path = table.with_name(table.name + ".episodes") / "open.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def kill_at_moments(command: list[str], table: Path, moments: int, seed: int = 0) -> list[int]:
    """Start a run as often as there are moments, and kill it at a random one after it has kept an episode more.

    Parameters
    ----------
    command : that goes on with the run. table : that it writes at its end; it then removes the episodes that it kept.

    Returns
    -------
    How many episodes were kept after each kill; fewer than `moments` where a run was over before it was killed.
    """
    chance, kept = random.Random(seed), list[int]()
    while len(kept) < moments:
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        before = episodes_kept(table)
        while run.poll() is None and episodes_kept(table) <= before:
            time.sleep(0.005)
        time.sleep(chance.uniform(0, 0.15))
        over = run.poll() is not None
        run.kill()
        run.wait()
        if over or table.exists():
            break
        kept.append(episodes_kept(table))
    return kept
