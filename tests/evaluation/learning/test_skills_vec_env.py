"""Skills in compiled environments against `Skills` around single ones, and learning with SB3."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.learning.fast_road_vec_env import FastRoadVecEnv
from evaluation.learning.fast_vec_env import FastHighwayVecEnv
from evaluation.learning.shielded_vec_env import ShieldedVecEnv
from evaluation.learning.skills_vec_env import SkillsVecEnv
from evaluation.wrappers import REPORT_SKILLS, Skills, nearer_than, overridden
from evaluation.wrappers.skill_progress import SkillProgress
from shield import ShieldedEnv
from shield.errors import ConfigError

CONFIG = {"vehicles_count": 10, "lanes_count": 3, "duration": 8, "vehicles_density": 1.5}
SKILLS = {"FOLLOW": ["IDLE"] * 3, "RUSH": ["FASTER"] * 4, "PASS": ["LANE_LEFT", 3, "LANE_RIGHT"], "SLOW": ["SLOWER"]}


def shielded():
    return Monitor(ShieldedEnv(CompiledHighwayEnv("highway-fast-v0", CONFIG)))


def bare():
    return Monitor(CompiledHighwayEnv("highway-fast-v0", CONFIG))


def merging():
    return Monitor(gym.make("merge-v0"))


def several(skill_env, count):
    return DummyVecEnv([skill_env] * count)


def fast(env, info):
    """Of one environment: whether its speed is above 26 m/s."""
    return info["speed"] > 26.0


def fast_of_many(world, which, infos):
    return [info["speed"] > 26.0 for info in infos]


@pytest.mark.parametrize(
    ("one", "compiled", "interrupt", "interrupt_many"),
    [
        (shielded, lambda: ShieldedVecEnv(3, "highway-fast-v0", CONFIG), overridden, overridden),
        (bare, lambda: FastHighwayVecEnv(3, "highway-fast-v0", CONFIG), nearer_than(12.0), nearer_than(12.0)),
        (bare, lambda: FastHighwayVecEnv(3, "highway-fast-v0", CONFIG), fast, fast_of_many),
        (merging, lambda: FastRoadVecEnv(3, "merge-v0"), nearer_than(20.0), nearer_than(20.0)),
        (bare, lambda: FastHighwayVecEnv(3, "highway-fast-v0", CONFIG), None, None),
    ],
    ids=["verdict", "distance", "function", "network", "never"],
)
def test_skills_of_a_batch_are_those_of_single_environments(one, compiled, interrupt, interrupt_many):
    """Observations, rewards, ends and the info of each skill are the same to the bit, in episodes that end."""
    theirs = several(lambda: Skills(one(), SKILLS, interrupt, discount=0.9), 3)
    mine = SkillsVecEnv(compiled(), SKILLS, interrupt_many, discount=0.9)
    for world in (theirs, mine):
        world.seed(50)
    assert np.array_equal(theirs.reset(), mine.reset())
    rng, cut, ended, steps = np.random.default_rng(0), 0, 0, set()
    first = True
    while first:
        skills = rng.integers(len(SKILLS), size=3)
        (obs, rewards, dones, infos), found = theirs.step(skills), mine.step(skills)
        assert np.array_equal(rewards, found[1])
        assert np.array_equal(dones, found[2])
        for a, b in zip(infos, found[3], strict=True):
            assert a["skill"] == b["skill"]
            assert a.get("shield") == b.get("shield")
            assert (a["speed"], a["crashed"], a["TimeLimit.truncated"]) == (
                b["speed"],
                b["crashed"],
                b["TimeLimit.truncated"],
            )
            cut += a["skill"]["interrupted"]
            steps.add(a["skill"]["steps"])
            if "episode" in a:
                ended += 1
                assert (a["episode"]["r"], a["episode"]["l"]) == (b["episode"]["r"], b["episode"]["l"])
                assert np.array_equal(a["terminal_observation"], b["terminal_observation"])
        # The next scene is drawn from another generator here.
        first = not dones.any()
        assert np.array_equal(obs[~dones], found[0][~dones])
    assert ended > 0
    assert len(steps) > 1
    assert (cut > 0) == (interrupt is not None)


@given(st.data())
@settings(max_examples=50, deadline=None)
def test_progress_is_that_of_each_environment_alone(data):
    """Compiled environments and the report's experiments carry skills out by it."""
    skills = data.draw(st.lists(st.lists(st.integers(0, 4), min_size=1, max_size=4), min_size=1, max_size=4))
    envs, steps = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 10))
    progress, left = SkillProgress(skills, envs), [[] for _ in range(envs)]
    for _ in range(steps):
        chosen = data.draw(st.lists(st.integers(0, len(skills) - 1), min_size=envs, max_size=envs))
        progress.choose(np.array(chosen))
        left = [mine or list(skills[k]) for mine, k in zip(left, chosen, strict=True)]
        assert progress.primitive.tolist() == [mine[0] for mine in left]
        stopped = data.draw(st.lists(st.booleans(), min_size=envs, max_size=envs))
        progress.advance()
        progress.stop(np.array(stopped))
        left = [[] if ends else mine[1:] for mine, ends in zip(left, stopped, strict=True)]
        assert progress.over.tolist() == [not mine for mine in left]


def test_a_predicate_that_raised_leaves_no_skill_half_way():
    def failing(world, which, infos):
        raise ValueError("broken")

    world = SkillsVecEnv(FastHighwayVecEnv(2, "highway-fast-v0"), {"LONG": [1] * 4, "SHORT": [1]}, failing)
    world.seed(7)
    world.reset()
    with pytest.raises(ValueError, match="broken"):
        world.step([0, 0])
    world.reset()
    *_, infos = world.step([1, 1])
    assert [info["skill"]["actions"] for info in infos] == [[1], [1]]


def test_an_environment_with_a_finished_skill_waits():
    """Its state and observation are those of the end of its skill."""
    world = SkillsVecEnv(FastHighwayVecEnv(2, "highway-fast-v0"), {"LONG": [1] * 4, "SHORT": [1]})
    alone = FastHighwayVecEnv(2, "highway-fast-v0")
    for each in (world, alone):
        each.seed(7)
        each.reset()
    observations, _, _, infos = world.step([0, 1])
    first = alone.step([1, 1])[0]
    assert np.array_equal(observations[1], first[1])
    for _ in range(3):
        last = alone.step([1, 1])[0]
    assert np.array_equal(observations[0], last[0])
    assert [info["skill"]["steps"] for info in infos] == [4, 1]


def test_masks_are_those_of_the_first_actions():
    world = SkillsVecEnv(ShieldedVecEnv(2, "highway-fast-v0"), SKILLS, overridden)
    world.seed(3)
    world.reset()
    env = Skills(ShieldedEnv(CompiledHighwayEnv("highway-fast-v0")), SKILLS, overridden)
    env.reset(seed=3)
    assert is_masking_supported(world)
    seen = set()
    for _ in range(6):
        masks = get_action_masks(world)
        actions = world.venv.action_masks()
        expected = actions[:, [1, 3, 0, 4]]
        expected[~expected.any(axis=1)] = True
        assert np.array_equal(masks, expected)
        assert np.array_equal(world.get_attr("action_masks")[1](), masks[1])
        assert np.array_equal(env.action_masks(), masks[0])
        seen.update(masks.ravel().tolist())
        world.step([1, 1])
        env.step(1)
    assert seen == {True, False}


@pytest.mark.parametrize("algorithm", [PPO, DQN, MaskablePPO])
def test_stable_baselines_learns_over_skills_of_a_batch(algorithm):
    world = SkillsVecEnv(ShieldedVecEnv(2, "highway-fast-v0", CONFIG), interrupt=overridden)
    options = {"learning_starts": 4, "buffer_size": 100} if algorithm is DQN else {"n_steps": 8, "batch_size": 8}
    model = algorithm("MlpPolicy", world, device="cpu", **options).learn(16)
    assert model.action_space.n == len(REPORT_SKILLS)


def test_maskable_ppo_learns_over_skills_of_single_environments():
    world = several(lambda: Skills(shielded(), interrupt=overridden), 2)
    assert MaskablePPO("MlpPolicy", world, n_steps=8, batch_size=8, device="cpu").learn(16).num_timesteps == 16


def test_invalid_skills_of_a_batch_are_refused():
    world = FastHighwayVecEnv(2, "highway-fast-v0")
    with pytest.raises(ConfigError, match="have Skills around each"):
        SkillsVecEnv(several(bare, 2))
    with pytest.raises(ConfigError, match="which is no action"):
        SkillsVecEnv(world, {"a": ["IDEL"]})
    with pytest.raises(ConfigError, match="interrupt is a function"):
        SkillsVecEnv(world, interrupt=3)
    skills = SkillsVecEnv(world, interrupt=overridden)
    skills.reset()
    with pytest.raises(ConfigError, match="no skill; have 0 FOLLOW"):
        skills.step([0, 9])
    with pytest.raises(ConfigError, match="a skill for each of 2"):
        skills.step([0])
    with pytest.raises(ConfigError, match=r"ShieldedEnv\(env\)"):
        skills.step([0, 0])
    assert not is_masking_supported(skills)
    with pytest.raises(ConfigError, match=r"Skills\(ShieldedEnv\(env\)\)"):
        Skills(bare()).action_masks()


@pytest.mark.parametrize("which", [[1, 0], [2], [-1]])
def test_some_environments_are_named_in_order(which):
    world = FastHighwayVecEnv(2, "highway-fast-v0")
    world.reset()
    with pytest.raises(ConfigError, match="in increasing order"):
        world.step_some(np.array([1, 1]), which)
