"""No decision waits for a compiler: all its kernels are compiled when the wrapper is made, and a message says so."""

import logging
import re
import subprocess
import sys
from contextlib import nullcontext
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from time import sleep

import pytest
from numba.core.event import trigger_event

from evaluation.commands.warming import warm_command
from shield import compiling
from shield.pipelines import warm_up
from shield.wrappers import warm_filters, warm_parts
from shield.wrappers.warm_parts import PARTS

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "compile_times.py"

COMPILED = """
import sys
import gymnasium as gym, highway_env, numpy as np
from shield import Shield, ShieldConfig, ShieldedEnv

def compiled():
    found = set()
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] in ("shield", "dynamics", "mpc"):
            for each in vars(module).values():
                if hasattr(each, "py_func"):
                    found |= {(each.py_func.__name__, str(one)) for one in each.signatures}
    return found
"""

DRIVE = """
env = ShieldedEnv(gym.make("highway-fast-v0", config={config}))
before = compiled()
rng = np.random.default_rng(0)
for seed in range(3):
    env.reset(seed=seed)
    done = False
    while not done:
        space = env.action_space
        action = int(rng.integers(5)) if not space.shape else space.low + (space.high - space.low) * rng.random(2)
        _, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
assert before and compiled() == before, compiled() - before
"""

LOOK_AHEAD = """
class Faster:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.array(3), state

env, overridden = gym.make("{env_id}", config={"duration": 12}), 0
shield = Shield(Faster(), env, ShieldConfig.simulated_traffic(), frames=False)
before = compiled()
for seed in range(2):
    obs, _ = env.reset(seed=seed)
    done = False
    while not done:
        obs, _, terminated, truncated, _ = env.step(shield.predict(obs)[0])
        overridden += shield.last_decision.overridden
        done = terminated or truncated
assert overridden and before and compiled() == before, compiled() - before
"""


@pytest.mark.parametrize(
    "drive",
    [
        pytest.param(DRIVE.replace("{config}", "{}"), id="meta"),
        pytest.param(LOOK_AHEAD.replace("{env_id}", "roundabout-v1"), id="exact on a network"),
        pytest.param(
            DRIVE.replace("{config}", "{'action': {'type': 'ContinuousAction'}, 'duration': 10}"),
            id="inputs",
            marks=pytest.mark.slow,
        ),
        pytest.param(LOOK_AHEAD.replace("{env_id}", "highway-fast-v0"), id="exact", marks=pytest.mark.slow),
    ],
)
def test_nothing_is_compiled_once_the_wrapper_is_made(drive):
    done = subprocess.run([sys.executable, "-c", COMPILED + drive], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


EXPLAIN = """
config = {"action": {"type": "ContinuousAction"}} if {inputs} else {}
env = ShieldedEnv(gym.make("{env_id}", config=config), ShieldConfig.simulated_traffic())
before, asked = compiled(), 0
action = [1.0, 0.2] if {inputs} else env.unwrapped.action_type.actions_indexes["FASTER"]
for seed in range(3):
    env.reset(seed=seed)
    for _ in range(10):
        _, _, terminated, truncated, _ = env.step(action)
        if env.last_decision.overridden:
            asked += bool(str(env.last_decision.explain()))
        if terminated or truncated:
            break
assert asked and before and compiled() == before, compiled() - before
"""


@pytest.mark.parametrize(
    ("env_id", "inputs", "part"),
    [
        ("highway-fast-v0", False, "simulated explanations on highways"),
        ("highway-fast-v0", True, "simulated explanations on networks"),
        ("roundabout-v1", False, "simulated explanations on networks"),
    ],
)
def test_no_explanation_in_simulated_traffic_reads_a_kernel(env_id, inputs, part):
    """Compiled ahead by `shield warm`, the kernels are read when the wrapper is made, and not at an explanation."""
    PARTS[part]()
    code = COMPILED + EXPLAIN.replace("{env_id}", env_id).replace("{inputs}", str(inputs))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture
def slow_machine(monkeypatch, tmp_path):
    """One on which the part takes 40 s, its kernels are not on the disk, and no other process compiles."""
    monkeypatch.setattr(compiling.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(compiling, "compile_units", lambda: {"a part": {}})
    monkeypatch.setattr(compiling, "estimated_units", lambda part: 20.0)
    monkeypatch.setattr(compiling, "reference_seconds", lambda: 2.0)


def trigger(event):
    """As numba does where it compiles a kernel."""
    with trigger_event(event):
        pass


def told(caplog):
    return [each.getMessage() for each in caplog.records if "compiling kernels" in each.getMessage()]


def test_a_long_compilation_is_announced_once(slow_machine, caplog):
    with caplog.at_level(logging.WARNING, "shield"), compiling.announced("a part"):
        for _ in range(3):
            trigger("numba:compile")
    (said,) = told(caplog)
    assert said.startswith("compiling kernels (a part): about 40 s, once after installation; `shield warm`")


def test_a_part_without_measured_times_is_announced_as_such(slow_machine, caplog):
    with caplog.at_level(logging.WARNING, "shield"), compiling.announced("another"), trigger_event("numba:compile"):
        pass
    (said,) = told(caplog)
    assert said == "compiling kernels (another), once after installation: how long has not been measured"


@pytest.mark.parametrize(("units", "compiles"), [(20.0, False), (0.0, True), (0.5, True)])
def test_reading_kernels_or_a_short_compilation_is_not_announced(slow_machine, monkeypatch, caplog, units, compiles):
    monkeypatch.setattr(compiling, "estimated_units", lambda part: units)
    event = trigger_event("numba:compile") if compiles else nullcontext()
    with caplog.at_level(logging.WARNING, "shield"), compiling.announced("a part"), event:
        pass
    assert told(caplog) == []


def test_one_of_two_compiling_processes_makes_the_announcement(slow_machine, caplog):
    """The workers of `shield evaluate` once printed it twice. (A lock belongs to an open file: one process can hold
    two.)"""
    other = compiling._progress_lock()
    assert other is not None
    for spoken, lock in ((0, other), (1, nullcontext())):
        with lock, caplog.at_level(logging.WARNING, "shield"), compiling.announced("a part"):
            trigger("numba:compile")
        assert len(told(caplog)) == spoken


def test_the_progress_is_shown_on_a_terminal(slow_machine, monkeypatch):
    shown = StringIO()
    shown.isatty = lambda: True
    monkeypatch.setattr(compiling.sys, "stderr", shown)
    with compiling.announced("a part"), trigger_event("numba:compile"):
        sleep(2.3)
    assert "compiling kernels (a part): 1 of about 40 s" in shown.getvalue()
    assert "compiling kernels (a part): 2 of about 40 s" in shown.getvalue()


def test_every_part_has_measured_times_of_existing_kernels():
    """If this fails, `python benchmarks/compile_times.py --write` measures them anew."""
    source = "".join(
        Path(module.__file__).read_text(encoding="utf-8") for module in (warm_filters, warm_parts, warm_up)
    )
    said = set(re.findall(r'"((?:worst case|simulated|compiled) [a-z, ]+)"', source))
    assert compiling.compile_units().keys() == said == PARTS.keys()
    for part, kernels in compiling.compile_units().items():
        found = 0.0
        for kernel, units in kernels.items():
            module, _, name = kernel.partition(":")[0].rpartition(".")
            found += units * hasattr(import_module(module), name) if find_spec(module) else 0.0
        assert found > 0.8 * sum(kernels.values()), part


def test_kernels_that_are_on_the_disk_do_not_count(monkeypatch):
    part = "worst case on highways"
    PARTS[part]()
    assert compiling.estimated_units(part) == 0
    kernel, units = next(iter(compiling.compile_units()[part].items()))
    module, _, name = kernel.partition(":")[0].rpartition(".")
    kept = getattr(import_module(module), name)._cache._cache_file
    monkeypatch.setattr(kept, "_load_index", dict)
    assert compiling.estimated_units(part) == units > 0


def test_a_command_compiles_all_kernels_ahead(monkeypatch, capsys):
    made = []
    monkeypatch.setattr(warm_parts, "PARTS", {"one": lambda: made.append(1), "two": lambda: made.append(2)})
    warm_command()
    assert made == [1, 2]
    said = capsys.readouterr().out
    assert "1/2 one: ready after 0 s" in said
    assert "all kernels are compiled" in said


@pytest.mark.slow
@pytest.mark.parametrize("part", ["worst case on highways", "simulated networks"])
def test_the_estimate_is_correct_within_thirty_percent(part):
    """CPU seconds with no kernel on the disk. The estimate was once 15 s for 46 s, and 30 s for 109 s."""
    done = subprocess.run([sys.executable, str(BENCHMARK), part], capture_output=True, text=True, check=True)
    found = re.search(r": ([\d.]+) s of CPU, estimated ([\d.]+) s", done.stdout)
    took, estimated = map(float, found.groups())
    assert 0.7 * took < estimated < 1.3 * took, done.stdout
