"""Calls of a function in several processes, which end with the one that started them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from threading import Thread
from typing import Any, TypeVar

import joblib

__all__ = ["in_processes"]

T = TypeVar("T")


def in_processes(function: Callable[..., T], calls: Sequence[tuple[Any, ...]], workers: int) -> Iterator[T]:
    """What each call gives, in their order; with one worker in this process."""
    if workers == 1:
        yield from (function(*call) for call in calls)
        return
    # Workers that were started before the library was asked not to thread would still do so.
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        pool = joblib.Parallel(n_jobs=workers, return_as="generator")
        yield from pool(joblib.delayed(_in_worker)(function, os.getpid(), *call) for call in calls)


def _in_worker(function: Callable[..., T], parent: int, *call: Any) -> T:
    _end_with(parent)
    return function(*call)


@lru_cache(maxsize=1)
def _end_with(parent: int) -> None:
    """A worker whose parent was killed has nobody to work for."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
