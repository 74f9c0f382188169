"""Episodes on a Ray cluster equal those of one process, with nodes and drivers lost on the way.

`make ray` installs Ray, which is large, and runs this; the tests without a cluster run everywhere.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pandas as pd
import pytest
from killing import episodes_kept, kill_at_moments
from slowly import later

from evaluation import Experiment
from evaluation.running.processes import Processes, RayTasks, engine_of
from evaluation.settings import Setting
from shield.errors import ConfigError

SHORT = Setting("short", "highway-fast-v0", {"duration": 4, "vehicles_count": 10})
EPISODES = 120


class FakeRay:
    """A cluster of so many cores, of which one call at a time is finished, the latest first."""

    exceptions = SimpleNamespace(RayTaskError=type("RayTaskError", (Exception,), {}))

    def __init__(self, cores):
        self.cores, self.under_way, self.most, self.cancelled = cores, 0, 0, []

    def is_initialized(self):
        return True

    def cluster_resources(self):
        return {"CPU": float(self.cores)}

    def remote(self, function):
        def begin(*call):
            self.under_way += 1
            self.most = max(self.most, self.under_way)
            return (function, call)

        return SimpleNamespace(options=lambda **_: SimpleNamespace(remote=begin))

    def wait(self, pending, num_returns):
        return pending[-1:], pending[:-1]

    def get(self, reference):
        self.under_way -= 1
        function, call = reference
        return function(*call)

    def cancel(self, reference, force):
        self.cancelled.append(reference)


@pytest.mark.parametrize("cores", [1, 3])
def test_pending_calls_are_limited_by_the_number_of_cores(monkeypatch, cores):
    """Two for each core, in any order of completion; each result is returned once."""
    fake = FakeRay(cores)
    monkeypatch.setitem(sys.modules, "ray", fake)
    found = list(RayTasks().spread(lambda x: x * x, [(x,) for x in range(20)]))
    assert sorted(found) == [x * x for x in range(20)]
    assert fake.most == 2 * cores
    assert not fake.cancelled


def test_pending_calls_are_cancelled_when_the_results_are_closed(monkeypatch):
    fake = FakeRay(2)
    monkeypatch.setitem(sys.modules, "ray", fake)
    results = RayTasks().spread(lambda x: x, [(x,) for x in range(20)])
    next(results)
    results.close()
    assert len(fake.cancelled) == 3


def test_a_missing_ray_is_an_error_that_names_the_installation(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"needs the package ray: pip install 'ray>=2.40,<3'"):
        _ = RayTasks().workers
    with pytest.raises(ConfigError, match="an address goes with the engine ray"):
        Experiment("idle", SHORT, address="auto")
    with pytest.raises(ConfigError, match="unknown engine 'spark'; have processes, ray"):
        Experiment("idle", SHORT, engine="spark")
    assert engine_of("processes", 2, None) == Processes(2)


def asked(folder, **options):
    return Experiment(
        "random", SHORT, ["none", "full"], config="worst-case", episodes=EPISODES, seed=100_100,
        simulator="highway-env", output=folder / "x.parquet", **options,
    )  # fmt: skip


def same(one, two):
    times = [column for column in one if column.startswith("latenc")]
    pd.testing.assert_frame_equal(one.drop(columns=times), two.drop(columns=times), check_dtype=False)


@pytest.fixture
def cluster():
    """Two nodes of one core each on this machine."""
    import ray
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    made.second = made.add_node(num_cpus=1)
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.mark.ray
def test_a_node_that_is_lost_loses_and_doubles_nothing(cluster, tmp_path):
    """One of the two nodes is killed half-way: the rows are those of one process."""
    lost = []

    def lose():
        while episodes_kept(tmp_path / "x.parquet") < EPISODES and not lost:
            time.sleep(0.02)
        lost.append(episodes_kept(tmp_path / "x.parquet"))
        cluster.remove_node(cluster.second, allow_graceful=False)

    watch = threading.Thread(target=lose)
    watch.start()
    try:
        found = asked(tmp_path, engine="ray", address=cluster.address).run(progress=False).episodes
    finally:
        lost.append(-1)
        watch.join()
    assert EPISODES <= lost[0] < 2 * EPISODES
    assert len(found) == 2 * EPISODES
    same(found, asked(tmp_path / "one").run(progress=False).episodes)


@pytest.mark.ray
def test_an_error_in_a_task_is_raised_in_the_driver(cluster, tmp_path):
    def fail(number):
        raise ConfigError(f"number {number} is not valid")

    with pytest.raises(ConfigError, match="number 3 is not valid"):
        list(RayTasks(cluster.address).spread(fail, [(3,)]))


@pytest.mark.ray
@pytest.mark.parametrize("moments", [2, *later(10)])
def test_a_driver_that_is_killed_loses_and_doubles_nothing(cluster, moments, tmp_path):
    """`kill -9` of the command that hands tasks to the cluster, at random moments."""
    (tmp_path / "short.toml").write_text("duration = 4\nvehicles_count = 10\n", encoding="utf-8")
    words = ["evaluate", "--env-id", "highway-fast-v0", "--env-config", str(tmp_path / "short.toml"), "--policy"]
    words += ["random", "--episodes", str(EPISODES), "--simulator", "highway-env", "--resume", "--output"]
    command = [sys.executable, "-m", "evaluation.commands.cli", *words, str(tmp_path / "x.parquet")]
    spread = [*command, "--engine", "ray", "--address", cluster.address]
    kept = kill_at_moments(spread, tmp_path / "x.parquet", moments)
    assert len(kept) == moments
    assert kept == sorted(set(kept))
    done = subprocess.run(spread, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    one = [*command[:-1], str(tmp_path / "one.parquet"), "--jobs", "1"]
    assert subprocess.run(one, capture_output=True).returncode == 0
    same(*(pd.read_parquet(tmp_path / f"{name}.parquet") for name in ("x", "one")))
