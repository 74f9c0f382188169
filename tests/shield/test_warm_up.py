"""No decision waits for a compiler: everything that it needs is compiled when the door is made, and that is said."""

import logging
import subprocess
import sys
from contextlib import nullcontext
from time import sleep

import pytest
from numba.core.event import trigger_event

from shield.procedures import warm_up as module

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
shield = Shield(Faster(), env, ShieldConfig.exact(), frames=False)
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
def test_nothing_is_compiled_once_the_door_is_there(drive):
    done = subprocess.run([sys.executable, "-c", COMPILED + drive], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize(
    ("patience", "compiles", "says"),
    [(1e-4, True, True), pytest.param(1e-4, False, False, id="a slow machine that reads"), (600.0, True, False)],
)
def test_it_says_what_it_waits_for_where_that_takes_long(monkeypatch, caplog, patience, compiles, says):
    module.warm_up()
    module.warm_up.cache_clear()
    monkeypatch.setattr(module, "_PATIENCE", patience)
    scene = module._scene

    def slowly(k):
        with trigger_event("numba:compile") if compiles else nullcontext():
            sleep(0.1)
        return scene(k)

    monkeypatch.setattr(module, "_scene", slowly)
    with caplog.at_level(logging.WARNING, "shield"):
        module.warm_up()
    assert any("compiling" in record.getMessage() for record in caplog.records) is says
