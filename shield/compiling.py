"""How long the kernels of the shield take to compile on this machine, and what is said meanwhile."""

from __future__ import annotations

import json
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from threading import Event as Flag
from threading import Thread
from time import perf_counter
from typing import IO, Any

import numpy as np
from numba import njit
from numba.core.event import Event, Listener, install_listener

__all__ = [
    "UNITS_FILE",
    "announced",
    "compile_units",
    "estimated_units",
    "is_on_disk",
    "reference_seconds",
    "types_digest",
]

UNITS_FILE = "compile_units.json"
"""Compile times that `benchmarks/compile_times.py --write` has measured, in units of the reference kernel."""
_log = logging.getLogger("shield")
_LEAST = 2.0
"""Shorter compilations are not announced [s]."""
_EVERY = 30.0
"""Time between two lines of progress where the output is no terminal [s]."""


@contextmanager
def announced(part: str) -> Iterator[None]:
    """Say once how long it takes, where kernels have to be compiled, and show the progress.

    Kernels that are read from the disk are not announced. Of several processes that compile at the same time one
    speaks.

    Parameters
    ----------
    part : a name in the file of compile times; of others it is said that their time has not been measured.
    """
    compiling = _Compiling(part)
    with install_listener("numba:compile", compiling):
        try:
            yield
        finally:
            compiling.stop()


@cache
def compile_units() -> Mapping[str, Mapping[str, float]]:
    """How long each kernel takes to compile, in compilations of the reference kernel: by part, and by kernel and the
    types of its arguments (see `is_on_disk`)."""
    read: dict[str, dict[str, float]] = json.loads((files("shield") / UNITS_FILE).read_text(encoding="utf-8"))
    return read


def estimated_units(part: str) -> float:
    """How long a part takes to compile, without the kernels that are on the disk, in units of the reference kernel."""
    return sum(units for kernel, units in compile_units()[part].items() if not is_on_disk(kernel))


def is_on_disk(kernel: str) -> bool:
    """Whether machine code of the present sources of a kernel is kept for arguments of these types.

    Parameters
    ----------
    kernel : "module.name:types", of which the types are as `types_digest` tells them; "module.name" for any types.
    """
    where, _, types = kernel.partition(":")
    module, _, name = where.rpartition(".")
    try:
        kept = getattr(import_module(module), name)._cache._cache_file._load_index()
    except (ImportError, AttributeError, OSError):
        # It is kept nowhere, or has another name by now.
        return False
    return any(types in ("", types_digest(key[0])) for key in kept)


def types_digest(types: Any) -> str:
    """A short name of the types of a kernel's arguments."""
    return sha256(str(tuple(types)).encode()).hexdigest()[:12]


def reference_seconds(clock: Callable[[], float] = perf_counter) -> float:
    """How long the reference kernel takes to compile on this machine now [s]; `clock` tells the time.

    The first compilations of a process take longer and do not count.
    """
    taken = []
    for _ in range(4):
        start = clock()
        njit(error_model="numpy")(_reference)(np.zeros((2, 4)), np.zeros((2, 3)))
        taken.append(clock() - start)
    return sum(taken[2:]) / 2


def _reference(rows: Any, out: Any) -> Any:
    """Loops and arithmetic as kernels have them; what it computes is of no use."""
    best = 1e9
    for i in range(rows.shape[0]):
        x, y, heading, speed = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
        for k in range(out.shape[0]):
            x += speed * np.cos(heading) * 0.1
            y += speed * np.sin(heading) * 0.1
            speed = max(speed - 0.5, 0.0)
            along = abs(x - out[k, 0]) - 5.0
            across = abs(y - out[k, 1]) - 2.0
            gap = max(along, across)
            if gap < 0.0 and speed > 1.0:
                out[k, 2] = gap
            elif np.isfinite(gap):
                out[k, 2] = min(out[k, 2], gap)
            best = min(best, gap)
    order = np.argsort(rows[:, 0])
    for k in range(order.size - 1):
        best += rows[order[k + 1], 0] - rows[order[k], 0]
    return best


class _Compiling(Listener):
    """Says what is waited for when numba begins to compile the first kernel of a part."""

    def __init__(self, part: str) -> None:
        self._part, self._begun = part, False
        self._over = Flag()
        self._speaker: IO[str] | None = None
        self._progress: Thread | None = None

    def on_start(self, event: Event) -> None:
        if self._begun:
            return
        self._begun = True
        self._speaker = _only_speaker()
        if self._speaker is None:
            return
        if self._part not in compile_units():
            _log.warning("compiling kernels (%s), once after installation: how long has not been measured", self._part)
            return
        units = estimated_units(self._part)
        seconds = units * reference_seconds()
        if seconds < _LEAST:
            return
        _log.warning(
            "compiling kernels (%s): about %.0f s, once after installation; `shield warm` compiles all ahead",
            self._part,
            seconds,
        )
        self._progress = Thread(target=self._show, args=(seconds,), daemon=True)
        self._progress.start()

    def on_end(self, event: Event) -> None:
        pass

    def stop(self) -> None:
        """The part is compiled."""
        self._over.set()
        if self._progress is not None:
            self._progress.join()
        if self._speaker is not None:
            self._speaker.close()

    def _show(self, seconds: float) -> None:
        start, live = perf_counter(), sys.stderr.isatty()
        while not self._over.wait(1.0 if live else _EVERY):
            text = f"compiling kernels ({self._part}): {perf_counter() - start:.0f} of about {seconds:.0f} s"
            if live:
                sys.stderr.write(f"\r{text} ")
                sys.stderr.flush()
            else:
                _log.info("%s", text)
        if live:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()


def _only_speaker() -> IO[str] | None:
    """A lock that one process of a user holds while it compiles; None where another one has it."""
    try:
        import fcntl
    except ImportError:  # on Windows each process speaks
        return tempfile.TemporaryFile("w")
    name = f"highway-shield-compiling-{os.getuid()}.lock"
    lock = Path(tempfile.gettempdir(), name).open("a", encoding="utf-8")  # noqa: SIM115
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        return None
    return lock
