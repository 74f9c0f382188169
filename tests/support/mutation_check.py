"""`make mutants`: switches the clauses of the certificate off one by one; some test has to fail each time.

The working tree is copied, each mutant is applied to the copy, and its tests are run there. A mutant that no test
notices survives; one whose node is no longer in the sources, or whose tests fail without it, says nothing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from queue import Queue
from time import perf_counter

import typer
from mutants import TABLES, Mutant
from mutants.nodes import StaleEditError
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
KILLED, SURVIVED = "killed", "SURVIVED"
STALE = "STALE: its syntax node is not in the sources; update tests/support/mutants"
RED = "RED: its tests fail, or are missing, without the mutant"
BROKEN = "BROKEN: its tests did not fail but could not be run, or its kernel does not compile"
STYLES = {KILLED: "green", SURVIVED: "bold red"}


class Copy:
    """A copy of the working tree, with a folder for compiled kernels of its own."""

    def __init__(self, folder: Path) -> None:
        self.tree, self._warm, self._used = folder / "tree", folder / "warm", folder / "used"
        listed = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
        names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, names.split("\0")):
            source, goal = ROOT / name, self.tree / name
            if source.is_file():
                goal.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, goal)
        self._warm.mkdir()
        probe = (
            "import dynamics, mpc, shield, evaluation as e; print(*(m.__file__ for m in (dynamics, mpc, shield, e)))"
        )
        found = self._run([sys.executable, "-c", probe], self._warm).stdout.split()
        if len(found) != 4 or not all(Path(file).is_relative_to(self.tree) for file in found):
            raise SystemExit(f"the tests would not import the copy in {self.tree}, but {found}")

    def warm_up(self, targets: list[str]) -> None:
        """Have the kernels of the copy compiled; each mutant recompiles those of its own file only."""
        self._pytest(targets, self._warm)

    def failing(self, targets: list[str]) -> list[str]:
        """The targets that do not pass in the unchanged copy."""
        return [t for t in targets if self._pytest([t], self._warm).returncode != 0]

    def verdict(self, mutant: Mutant) -> str:
        """What becomes of a mutant."""
        kept: dict[Path, tuple[bytes, os.stat_result]] = {}
        try:
            for edit in mutant.edits:
                try:
                    path, text = edit.apply(self.tree)
                except StaleEditError:
                    return STALE
                kept.setdefault(path, (path.read_bytes(), path.stat()))
                path.write_text(text, encoding="utf-8")
            shutil.rmtree(self._used, ignore_errors=True)
            shutil.copytree(self._warm, self._used, copy_function=shutil.copy2)
            done = self._pytest(list(mutant.tests), self._used)
        finally:
            for path, (content, stat) in kept.items():
                path.write_bytes(content)
                os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        if done.returncode == 0:
            return SURVIVED
        broken = any(word in done.stdout for word in ("TypingError", "NameError", "SyntaxError", "CompilerError"))
        return BROKEN if done.returncode != 1 or broken else KILLED

    def _pytest(self, targets: list[str], cache: Path) -> subprocess.CompletedProcess[str]:
        return self._run([sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *targets], cache)

    def _run(self, command: list[str], cache: Path) -> subprocess.CompletedProcess[str]:
        paths = {"PYTHONPATH": str(self.tree), "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
        single = {"OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy"}
        return subprocess.run(command, cwd=self.tree, env=os.environ | paths | single, capture_output=True, text=True)


def check(mutants: list[Mutant], jobs: int) -> Iterator[tuple[Mutant, str, float]]:
    """What becomes of each mutant, and how long it took [s]."""
    targets = sorted({test for mutant in mutants for test in mutant.tests})
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        copies: Queue[Copy] = Queue()
        for i in range(jobs):
            (Path(folder) / str(i)).mkdir()
            copies.put(Copy(Path(folder).resolve() / str(i)))

        def borrow(mutant: Mutant | None, tests: list[str]) -> tuple[list[str] | str, float]:
            copy, start = copies.get(), perf_counter()
            try:
                return copy.verdict(mutant) if mutant else copy.failing(tests), perf_counter() - start
            finally:
                copies.put(copy)

        list(pool.map(lambda copy: copy.warm_up(targets), list(copies.queue)))
        red = {t for failed, _ in pool.map(lambda t: borrow(None, [t]), targets) for t in failed}
        mutants = [replace(m, tests=tuple(t for t in m.tests if t not in red)) for m in mutants]
        green = [m for m in mutants if m.tests]
        yield from ((m, RED, 0.0) for m in mutants if not m.tests)
        for mutant, (verdict, took) in zip(green, pool.map(lambda m: borrow(m, []), green), strict=True):
            yield mutant, str(verdict), took


def main(
    only: list[str] = typer.Option([], help="Mutants whose name contains this; all by default."),
    table: list[str] = typer.Option([], help="Tables of `mutants.TABLES`, all by default."),
    show: bool = typer.Option(False, "--list", help="Name the mutants and their tests, and run nothing."),
    jobs: int = typer.Option(1, min=1, help="How many to run at a time."),
) -> None:
    """Check that every clause of the certificate is held by a test; exit status 1 if one is not."""
    if unknown := set(table) - set(TABLES):
        raise typer.BadParameter(f"no table {', '.join(sorted(unknown))}; have {', '.join(TABLES)}")
    mutants = [mutant for name in table or TABLES for mutant in TABLES[name]]
    chosen = [m for m in mutants if not only or any(word in m.name for word in only)]
    console, shown, start = Console(), Table("mutant", "verdict", "s"), perf_counter()
    if show:
        for mutant in chosen:
            console.print(f"{mutant.name}: {', '.join(mutant.tests)}", markup=False, soft_wrap=True)
        return
    verdicts = []
    for mutant, verdict, took in check(chosen, jobs):
        verdicts.append(verdict)
        shown.add_row(mutant.name, f"[{STYLES.get(verdict, 'yellow')}]{verdict}", f"{took:.0f}")
        console.print(f"{mutant.name}: {verdict}", markup=False)
    console.print(shown)
    killed = verdicts.count(KILLED)
    console.print(f"{killed} of {len(verdicts)} killed in {perf_counter() - start:.0f} s")
    raise typer.Exit(killed < len(verdicts) or not verdicts)


if __name__ == "__main__":
    typer.run(main)
