"""Compile times of the shield's kernels on this machine, and the progress line."""

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
"""Compile times measured by `benchmarks/compile_times.py --write`, in units of the reference kernel."""
_log = logging.getLogger("shield")
_LEAST = 2.0
"""Shorter compilations are not announced [s]."""
_EVERY = 30.0
"""Time between two lines of progress where the output is not a terminal [s]."""


@contextmanager
def announced(part: str) -> Iterator[None]:
    """Log once the estimated time if kernels have to be compiled, and show the progress.

    Kernels that are loaded from the disk are not announced. If several processes compile at the same time, only one
    logs.

    Parameters
    ----------
    part : a name in the file of compile times; for other names the message says that their time has not been measured.
    """
    compiling = _Compiling(part)
    with install_listener("numba:compile", compiling):
        try:
            yield
        finally:
            compiling.stop()


@cache
def compile_units() -> Mapping[str, Mapping[str, float]]:
    """Compile time of each kernel, in units of the reference kernel: by part, and by kernel and the types of its
    arguments (see `is_on_disk`)."""
    read: dict[str, dict[str, float]] = json.loads((files("shield") / UNITS_FILE).read_text(encoding="utf-8"))
    return read


def estimated_units(part: str) -> float:
    """Compile time of a part, without the kernels that are on the disk, in units of the reference kernel."""
    return sum(units for kernel, units in compile_units()[part].items() if not is_on_disk(kernel))


def is_on_disk(kernel: str) -> bool:
    """Whether machine code of a kernel's present sources is on the disk, for the given types of arguments.

    Parameters
    ----------
    kernel : "module.name:types", with types from `types_digest`; "module.name" for any types.
    """
    where, _, types = kernel.partition(":")
    module, _, name = where.rpartition(".")
    try:
        kept = getattr(import_module(module), name)._cache._cache_file._load_index()
    except (ImportError, AttributeError, OSError):
        # There is no cache, or the kernel has another name now.
        return False
    return any(types in ("", types_digest(key[0])) for key in kept)


def types_digest(types: Any) -> str:
    """Digest of the types of a kernel's arguments."""
    return sha256(str(tuple(types)).encode()).hexdigest()[:12]


def reference_seconds(clock: Callable[[], float] = perf_counter) -> float:
    """Compile time of the reference kernel on this machine now [s].

    The first compilations of a process take longer and do not count.

    Parameters
    ----------
    clock : returns the time [s].
    """
    taken = []
    for _ in range(4):
        start = clock()
        njit(error_model="numpy")(_reference)(np.zeros((2, 4)), np.zeros((2, 3)))
        taken.append(clock() - start)
    return sum(taken[2:]) / 2


def _reference(rows: Any, out: Any) -> Any:
    """Loops and arithmetic typical of a kernel; the result has no meaning."""
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
    """Logs the estimated time when numba begins to compile the first kernel of a part."""

    def __init__(self, part: str) -> None:
        self._part, self._begun = part, False
        self._over = Flag()
        self._speaker: IO[str] | None = None
        self._progress: Thread | None = None

    def on_start(self, event: Event) -> None:
        if self._begun:
            return
        self._begun = True
        self._speaker = _progress_lock()
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
        """Called after the compilation of the part."""
        self._over.set()
        if self._progress is not None:
            self._progress.join()
        if self._speaker is not None:
            self._speaker.close()

    def _show(self, seconds: float) -> None:
        """Print the progress until the compilation is over."""
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


def _progress_lock() -> IO[str] | None:
    """A lock that one process of a user holds while it compiles; None if another process has it."""
    try:
        import fcntl
    except ImportError:  # on Windows each process logs
        return tempfile.TemporaryFile("w")
    name = f"highway-shield-compiling-{os.getuid()}.lock"
    lock = Path(tempfile.gettempdir(), name).open("a", encoding="utf-8")  # noqa: SIM115
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        return None
    return lock
