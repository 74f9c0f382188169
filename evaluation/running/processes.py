"""Calls of a function in several processes: of this machine, or of a Ray cluster.

Processes of this machine end when the process that started them ends.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from threading import Thread
from typing import Any, Protocol, TypeVar

import joblib

from shield.errors import ConfigError

__all__ = ["Engine", "Processes", "RayTasks", "engine_of", "in_processes"]

T = TypeVar("T")
_WAITING = 2
"""Number of calls for each core of a cluster that are submitted at a time."""


class Engine(Protocol):
    """Executes calls in parallel."""

    @property
    def workers(self) -> int:
        """Number of calls at a time."""

    @property
    def most(self) -> int:
        """Largest number of episodes of a call, if each episode is stored as it finishes."""

    def spread(self, function: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Iterator[T]:
        """Yield the result of each call once, in any order."""


@dataclass(frozen=True)
class Processes:
    """Processes of this machine.

    Attributes
    ----------
    jobs : number of processes; -1 for one per core.
    """

    jobs: int = 1
    most = 1

    @property
    def workers(self) -> int:
        """Number of processes."""
        return int(joblib.effective_n_jobs(self.jobs))

    def spread(self, function: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Iterator[T]:
        """Yield the result of each call, in order."""
        return in_processes(function, calls, self.workers)


@dataclass(frozen=True)
class RayTasks:
    """Tasks of a Ray cluster, one for each call. The tasks of a node that fails are repeated on another node.

    Attributes
    ----------
    address : address of the cluster; "auto" for the one of this machine, "local" to start one here.
    most : episodes of a task, which are stored together at its end.

    Raises
    ------
    ConfigError
        If Ray is not installed, or there is no such cluster.
    """

    address: str = "auto"
    most: int = 10

    @property
    def workers(self) -> int:
        """Number of cores of the cluster."""
        return max(1, int(self._ray().cluster_resources().get("CPU", 1)))

    def spread(self, function: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Iterator[T]:
        """Yield the result of each call as it finishes; at most `_WAITING` calls for each core are pending."""
        ray = self._ray()
        task = ray.remote(function).options(max_retries=-1, num_cpus=1)
        left = iter(calls)
        pending: list[Any] = []
        try:
            while True:
                while len(pending) < _WAITING * self.workers and (call := next(left, None)) is not None:
                    pending.append(task.remote(*call))
                if not pending:
                    return
                (first, *_), pending = ray.wait(pending, num_returns=1)
                try:
                    found = ray.get(first)
                except ray.exceptions.RayTaskError as error:
                    # Raise the original exception instead of Ray's.
                    raise error.cause from None
                yield found
        finally:
            for each in pending:
                ray.cancel(each, force=True)

    def _ray(self) -> Any:
        """The module `ray`, connected to the cluster."""
        try:
            import ray
        except ImportError:
            raise ConfigError(
                "--engine ray needs the package ray: pip install 'ray>=2.40,<3', on every node of the cluster"
            ) from None
        if not ray.is_initialized():
            where = None if self.address == "local" else self.address
            # One thread for each worker; the library has to be importable in it.
            paths = os.pathsep.join(dict.fromkeys([*_paths(), os.environ.get("PYTHONPATH", "")])).strip(os.pathsep)
            variables = {"OMP_NUM_THREADS": "1", "PYTHONPATH": paths, "SDL_VIDEODRIVER": "dummy"}
            try:
                ray.init(address=where, runtime_env={"env_vars": variables}, log_to_driver=False, logging_level="ERROR")
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise ConfigError(f"there is no Ray cluster at {self.address!r}: {error}") from None
        return ray


def engine_of(name: str, jobs: int, address: str | None) -> Engine:
    """Make an engine by name.

    Parameters
    ----------
    name : one of `evaluation.names.ENGINES`.
    jobs : number of processes.
    address : address of a Ray cluster; "auto" by default.

    Raises
    ------
    ConfigError
        If an address is given for processes.
    """
    if name == "ray":
        return RayTasks(address or "auto")
    if address is not None:
        raise ConfigError("an address goes with the engine ray")
    return Processes(jobs)


def in_processes(function: Callable[..., T], calls: Sequence[tuple[Any, ...]], workers: int) -> Iterator[T]:
    """Yield the result of each call, in order; with one worker in this process."""
    if workers == 1:
        yield from (function(*call) for call in calls)
        return
    # Loky may reuse workers, which need the limit on threads too.
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        pool = joblib.Parallel(n_jobs=workers, return_as="generator")
        yield from pool(joblib.delayed(_in_worker)(function, os.getpid(), *call) for call in calls)


def _paths() -> list[str]:
    """Import paths of the user: working directories and PYTHONPATH, without installed packages."""
    import sys

    return [path for path in sys.path if path and "site-packages" not in path and not path.startswith(sys.base_prefix)]


def _in_worker(function: Callable[..., T], parent: int, *call: Any) -> T:
    _end_with(parent)
    return function(*call)


@lru_cache(maxsize=1)
def _end_with(parent: int) -> None:
    """End this worker once its parent process has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
