"""What a decision costs; compare the groups' members with each other, not with another machine's numbers."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import pytest
import torch
from cores import MetaCore, ShieldCore
from stable_baselines3 import PPO

from dynamics.scenes.scene import Scene, SceneReader
from shield import Shield, ShieldedEnv

IDLE, FASTER, SLOWER = 1, 3, 4


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def env():
    env = gym.make("highway-fast-v0", config={"duration": 10_000})
    env.reset(seed=0)
    yield env
    env.close()


def first_scene(env, core, action, tier):
    """A scene in which `core` answers `action` with `tier`."""
    for seed in range(50):
        env.reset(seed=seed)
        for _ in range(5):
            scene = Scene.from_env(env)
            if core().decide(scene, action).tier == tier:
                return scene
            if env.step(IDLE)[2]:
                break
    raise LookupError(f"no scene with {tier} for action {action} in 50 seeds")


@pytest.mark.benchmark(group="one decision")
def test_the_policys_predict(benchmark, env):
    model = PPO("MlpPolicy", env, policy_kwargs={"net_arch": [256, 256]}, device="cpu", seed=0)
    obs, _ = env.reset(seed=0)
    benchmark(model.predict, obs, deterministic=True)


@pytest.mark.benchmark(group="one decision")
def test_the_shielded_predict_of_that_policy(benchmark, env):
    model = PPO("MlpPolicy", env, policy_kwargs={"net_arch": [256, 256]}, device="cpu", seed=0)
    obs, _ = env.reset(seed=0)
    benchmark(Shield(model, env=env).predict, obs, deterministic=True)


@pytest.mark.benchmark(group="one decision")
def test_reading_the_scene(benchmark, env):
    benchmark(SceneReader(env).read)


@pytest.mark.benchmark(group="verification")
@pytest.mark.parametrize(("action", "tier"), [(SLOWER, "passed"), (FASTER, "alternative")])
@pytest.mark.parametrize("core", [MetaCore, ShieldCore])
def test_decide(benchmark, env, core, action, tier):
    scene = first_scene(env, core, action, tier)
    benchmark(core().decide, scene, action)


@pytest.mark.benchmark(group="verification")
def test_supervise_one_frame(benchmark, env):
    scene = first_scene(env, ShieldCore, SLOWER, "passed")
    benchmark(ShieldCore().supervise, scene)


@pytest.mark.benchmark(group="one second of highway-fast-v0")
@pytest.mark.parametrize("shielded", [False, True], ids=["bare", "shielded"])
def test_step(benchmark, env, shielded):
    env = ShieldedEnv(env) if shielded else env
    seeds = iter(range(10**6))

    def setup():
        env.reset(seed=next(seeds))
        return (SLOWER,), {}

    benchmark.pedantic(env.step, setup=setup, rounds=100, warmup_rounds=5)
