"""The report's noise, confidence, intent, override and skills, as in its script and in its text."""

import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slowly import later

from dynamics.highway_simulator.env import CompiledHighwayEnv
from evaluation.reproduction import script, text
from evaluation.reproduction.batch import ReportBatch
from evaluation.reproduction.driving import drive_many
from evaluation.reproduction.env import ReportEnv
from evaluation.reproduction.presets import PRESETS, ROUNDABOUT_PRESETS
from evaluation.reproduction.skilled import SkillRun
from evaluation.reproduction.variants import VARIANTS
from evaluation.running.episodes import run_episode
from evaluation.wrappers import Confidence, Intent, Skills, overridden
from shield import ShieldedEnv

CODED, WRITTEN = PRESETS["as-coded"], PRESETS["as-written"]
UNITS = ("noise-override", "noise-override-skills", "noise-intent")


def scene(*rows):
    return np.array(rows, np.float32)


def test_the_scripts_noise_is_on_all_rows_and_spares_the_presence_flag():
    """The ego's row and an absent one are as noisy as the others, and nothing is clipped afterwards."""
    rows = scene([1, 1, 0, 0.3, 0], [0, 0, 0, 0, 0])
    shown = script.noise_on_all_rows(rows, np.ones((2, 4)), 0.5)
    np.testing.assert_allclose(shown, [[1, 1.5, 0.5, 0.8, 0.5], [0, 0.5, 0.5, 0.5, 0.5]], rtol=1e-6)


def test_the_texts_noise_is_on_others_that_are_present():
    rows = scene([1, 1, 0, 0.3, 0], [1, 0.1, 0, 0, 0], [0, 0, 0, 0, 0])
    shown = text.noise_on_others(rows, np.ones((3, 4)), 0.2)
    assert shown[0].tolist() == rows[0].tolist()
    assert shown[1].tolist() == pytest.approx([1, 0.3, 0.2, 0.2, 0.2])
    assert not shown[2].any()


def test_the_scripts_confidence_is_a_variance_across_one_row():
    """For x, y, vx, vy = 1, 0, 1, 0 the mean is 1/2 and the population variance 1/4."""
    assert script.confidence_across_features(scene([1, 1, 0, 1, 0]))[0] == pytest.approx(math.exp(-0.25))
    assert script.confidence_across_features(scene([0, 0, 0, 0, 0]))[0] == 1.0


def test_the_scripts_intent_compares_the_normalised_speed():
    """20 m/s sideways, 0.25 in normalised units, is no intent; 25 m/s is."""
    rows = scene([1, 0, 0, 0, 0.25], [1, 0, 0, 0, 0.3125], [1, 0, 0, 0, -0.5])
    assert script.intent_of_normalised(rows).tolist() == [0.0, 1.0, -1.0]


@pytest.mark.parametrize(
    ("ego_x", "other", "score"),
    [
        (0.9, [1, 0.2, 0, 0, 0, 0.5], 0.4),  # int(0.9) = int(0.2): r = 0
        (1.1, [1, 0.2, 0, 0, 0, 0.5], 0.9),  # int(1.1) = 1 and no row has it: r = 1
        (0.9, [0, 0.2, 0, 0, 0, 0.5], 0.9),  # absent: its flag is 1 less than the ego's
        (-0.9, [1, 0.9, 0, 0, 0, 0.5], 0.4),  # int() goes towards 0
    ],
)
def test_the_override_score_reads_one_column_too_early(ego_x, other, score):
    rows = scene([1, ego_x, 0, 0.3, 0, 0.8], other)
    assert script.override_score(rows) == pytest.approx(score)


@pytest.mark.parametrize(("y", "action"), [(0.4, 3), (0.5, 1), (1.0, 1), (1.1, 4)])
def test_the_override_takes_y_for_the_speed_and_replaces_every_action(y, action):
    rows = scene([1, 0.9, y, 0.3, 0, 0.8], [1, 0.2, 0, 0, 0, 0.5])
    for proposed in range(5):
        given, acts = script.overriding_action(rows, np.array(proposed))
        assert acts
        assert given == action
    alone = scene([1, 1.1, y, 0.3, 0, 0.8], [1, 0.2, 0, 0, 0, 0.5])
    assert script.overriding_action(alone, np.array(2))[0] == 2


@given(
    st.lists(st.floats(-3, 3, width=32), min_size=8, max_size=8),
    st.lists(st.booleans(), min_size=3, max_size=3),
    st.floats(0, 1, width=32),
)
def test_the_override_score_is_half_the_confidence_or_a_half_more(numbers, present, confidence):
    """r is 0 or 1 for any observation, as the presence flags are."""
    rows = np.zeros((4, 6), np.float32)
    rows[:, 1:3] = np.array(numbers).reshape(4, 2)
    rows[:, 0], rows[0, 5] = [1, *present], confidence
    extra = script.override_score(rows) - 0.5 * np.float64(np.float32(confidence))
    assert min(abs(extra), abs(extra - 0.5)) < 1e-12


def test_a_skill_is_gated_by_the_last_column_of_the_ego():
    rows = np.zeros((2, 1, 6), np.float32)
    rows[:, 0, 5] = [0.64, 0.66]
    chosen, gated = script.gate_skills(rows, np.array([1, 1]), 3)
    assert chosen.tolist() == [3, 1]
    assert gated.tolist() == [True, False]


def test_the_texts_override_stops_lane_changes_near_a_vehicle():
    rows = scene([1, 1, 0, 0.3, 0], [1, 0.05, 0, 0, 0])  # 10 m ahead
    assert text.override_lane_changes(rows, np.array(0), 20.0)[0] == 4
    assert text.override_lane_changes(rows, np.array(3), 20.0)[0] == 3
    assert text.override_lane_changes(rows, np.array(0), 9.0)[0] == 0
    assert text.vehicle_near(rows, 11.0)
    assert not text.vehicle_near(rows, 9.0)


def test_confidence_over_time_and_intent_are_those_of_the_wrappers():
    """To 32 bits, in an episode of the compiled highway, independent of other environments."""
    env = CompiledHighwayEnv("highway-fast-v0")
    wrapped = Intent(Confidence(env))
    shown, _ = wrapped.reset(seed=4)
    over_time = text.ConfidenceOverTime(2, 5)
    over_time.begin(1)
    for _ in range(7):
        rows = shown[None, :, :5]
        assert over_time.add(rows, np.array([1]))[0].astype(np.float32).tolist() == shown[:, 5].tolist()
        over_time.add(np.zeros((1, 5, 5), np.float32), np.array([0]))
        assert text.intent_in_metres(rows)[0].tolist() == shown[:, 6].tolist()
        shown, *_ = wrapped.step(0)


class Hashing:
    """Chooses by the observation, so that a wrong order or a wrong observation gives other episodes."""

    def __init__(self, actions):
        self.actions = actions

    def predict(self, observation, deterministic=True):
        each = np.abs(np.asarray(observation, float)[..., 0, :]).sum(axis=-1)
        return (1e4 * each).astype(int) % self.actions, None


@pytest.mark.parametrize(
    ("preset", "name"),
    [
        *((preset, name) for preset in (CODED, WRITTEN) for name in UNITS),
        (CODED, "skills-inside"),
        *later((WRITTEN, "skills-inside")),  # 400 decisions of 50 vehicles behind the shield
    ],
    ids=lambda each: getattr(each, "name", each),
)
def test_rows_do_not_depend_on_how_many_are_driven_at_once(preset, name):
    seeds, model = range(11, 16), Hashing(5)
    alone = drive_many(preset, VARIANTS[name], model, seeds, envs=1)
    assert alone.equals(drive_many(preset, VARIANTS[name], model, seeds, envs=3))


@pytest.mark.parametrize("name", ["slower", "faster"])
def test_baselines_are_the_episodes_of_highway_env(name):
    rows = drive_many(CODED, VARIANTS[name], None, [970_123, 970_124]).set_index("seed")
    for seed in rows.index:
        record = run_episode("highway-fast", name, seed=seed, simulator="highway-env")
        assert (rows.loc[seed, "return"], rows.loc[seed, "crashed"]) == (record.return_, record.crashed)


def test_a_car_that_stops_stops():
    rows = drive_many(CODED, VARIANTS["stopped"], None, range(20))
    assert rows["mean_speed"].max() < 8.0  # from 25 m/s, over 30 s


def test_skills_of_many_are_those_of_the_wrapper():
    """Skills inside the shield, each interrupted by an override: one environment at a time through `Skills`."""
    seeds, variant, model = [21, 22, 23], VARIANTS["skills-inside"], Hashing(5)
    rows = drive_many(CODED, variant, model, seeds)
    env = Skills(ShieldedEnv(CompiledHighwayEnv("highway-fast-v0")), CODED.skills, interrupt=overridden)
    sensor = ReportBatch(CODED, variant, 1)._sensor
    for seed, (_, row) in zip(seeds, rows.iterrows(), strict=True):
        observation, _ = env.reset(seed=seed)
        sensor.begin(0, seed)
        total, steps, decisions, done = 0.0, 0, 0, False
        while not done:
            shown = sensor.of(observation[None], np.array([steps]), np.array([0]))
            observation, reward, terminated, truncated, info = env.step(int(model.predict(shown)[0][0]))
            total, steps, decisions = total + reward, steps + info["skill"]["steps"], decisions + 1
            done = terminated or truncated
        assert (steps, decisions) == (row["steps"], row["decisions"])
        assert total == pytest.approx(row["return"], abs=1e-9)


def test_the_reports_skills_are_never_interrupted_in_its_script():
    batch = ReportBatch(CODED, VARIANTS["noise-override-skills"], 1)
    skills = SkillRun(batch)
    done, asked = [], 0
    while asked < 3:
        if skills.over[0]:
            skills.choose(np.array([1]))
            asked += 1
        done.append(int(skills.primitive[0]))
        gated = bool(skills.gated[0])
        batch.step(skills.primitive)
        skills.step()
        assert gated == (done[4 * (asked - 1)] == 4)
    first = done[:4]
    assert first in ([2, 3, 3, 0], [4, 4, 4, 4])


@given(st.integers(1, 4), st.floats(-1, 1))
def test_a_steady_reward_is_worth_the_same_however_often_skills_are_interrupted(k, reward):
    """Semi-Markov: the reward of a skill of k steps is scaled to the discount of a whole skill."""
    env = _env("skills-inside")
    whole = env._paid([reward] * 4)
    assert env._paid([reward] * k) == pytest.approx(whole, abs=1e-12)
    g = CODED.gamma**0.25
    assert whole == pytest.approx(reward * (1 + g + g**2 + g**3), abs=1e-12)


_MADE = {}


def _env(name):
    if name not in _MADE:
        _MADE[name] = ReportEnv(CODED, VARIANTS[name])
    return _MADE[name]


def test_an_override_costs_its_penalty():
    bare, paid = ReportEnv(CODED, VARIANTS["trained-inside"]), ReportEnv(CODED, VARIANTS["trained-inside-penalty"])
    for env in (bare, paid):
        env.reset(seed=3)
    seen = set()
    for _ in range(20):
        _, one, _, over, info = bare.step(3)
        _, two, *_ = paid.step(3)
        cost = VARIANTS["trained-inside-penalty"].penalty * info["shield"]["overridden"]
        assert one - two == pytest.approx(cost, abs=1e-12)
        seen.add(info["shield"]["overridden"])
        if over:
            break
    assert seen == {False, True}


def test_the_environment_passes_gymnasiums_check():
    from stable_baselines3.common.env_checker import check_env

    env = ReportEnv(CODED, VARIANTS["noise-intent"])
    assert isinstance(env, gym.Env)
    check_env(env)
    assert env.observation_space.shape == (5, 7)


def test_nearness_on_the_roundabout_is_in_metres():
    """Its rows are absolute; 1 means 100 m and 15 m/s."""
    rows = scene([1, 0.5, -0.1, 0, 0.01], [1, 0.56, -0.02, 0, 0.03])  # 6 m and 8 m away, at 0.15 and 0.45 m/s
    assert text.vehicle_near(rows, 10.1, text.ROUNDABOUT)
    assert not text.vehicle_near(rows, 9.9, text.ROUNDABOUT)
    assert text.override_lane_changes(rows, np.array(2), 10.1, text.ROUNDABOUT)[0] == 4
    assert text.override_lane_changes(rows, np.array(2), 9.9, text.ROUNDABOUT)[0] == 2
    assert text.intent_in_metres(rows, scale=text.ROUNDABOUT).tolist() == [0.0, 1.0]


@pytest.mark.parametrize("name", ["as-coded", "as-written"])
def test_the_roundabout_is_that_of_highway_env(name):
    """Returns, lengths and crashes of a constant policy are those of the environment itself."""
    preset, variant = ROUNDABOUT_PRESETS[name], VARIANTS["faster"]
    rows, env = drive_many(preset, variant, None, [5, 6]), preset.setting.make()
    for _, row in rows.iterrows():
        env.reset(seed=int(row["seed"]))
        total, steps, done = 0.0, 0, False
        while not done:
            _, reward, terminated, truncated, info = env.step(3)
            total, steps, done = total + reward, steps + 1, terminated or truncated
        assert (row["return"], row["steps"], row["crashed"]) == (pytest.approx(total), steps, info["crashed"])


def test_undisturbed_the_scripts_car_leaves_the_roundabout_after_124_steps():
    """The fact that the page states: on the road for 124 of 900 steps, then at reward 0."""
    env = ROUNDABOUT_PRESETS["as-coded"].setting.make()
    env.reset(seed=0)
    env.unwrapped.road.vehicles = [env.unwrapped.vehicle]
    rewards, done = [], False
    while not done:
        _, reward, terminated, truncated, _ = env.step(3)
        rewards.append(reward)
        done = terminated or truncated
    assert len(rewards) == 900
    assert abs(sum(reward != 0.0 for reward in rewards) - 124) <= 1
    assert not any(rewards[130:])


def test_the_provided_baselines_return_is_that_of_a_stopped_car():
    """Published as 9.17 with no crash."""
    rows = drive_many(ROUNDABOUT_PRESETS["as-coded"], VARIANTS["provided-baseline"], None, range(3))
    assert rows["return"].tolist() == pytest.approx([9.17] * 3, abs=0.01)
    assert not rows["crashed"].any()


def test_skills_and_the_shield_drive_on_the_roundabout():
    """The statistics of a short episode behind the shield; an overridden skill ends at that step."""
    preset = ROUNDABOUT_PRESETS["as-coded"]
    preset = replace(preset, setting=preset.setting.override({"duration": 3}))
    rows = drive_many(preset, VARIANTS["skills-inside"], Hashing(5), [11, 12])
    assert (rows["decisions"] < rows["steps"]).all()
    assert (rows["steps"] <= 45).all()
    assert (rows["overridden"] <= rows["decisions"]).all()
    assert rows["overridden"].sum() > 0
    bare = drive_many(preset, VARIANTS["noise"], Hashing(5), [11, 12])
    assert not bare["overridden"].any()
