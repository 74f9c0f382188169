"""The planner as a policy: it parks, alone and in batches; its costs are the environment's; a failed plan brakes."""

import numpy as np
import pytest
from highway_env import utils
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv

from dynamics.errors import ConfigError, DataError
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.tasks import parking_state as parking
from evaluation.settings import get_setting
from mpc.cem_policy import CEMPolicy
from mpc.sampling.plan import PlanStatus, Trajectories
from mpc.tasks.costs import DisagreementCost, InputCost, SpeedCost, Sum, TerminalWeight, TimeCost
from mpc.tasks.parking import ParkingTask, brake, parking_settings
from mpc.tasks.parking_costs import GoalCost, ObstacleCost, StopCost, SuccessMask, WallCost, goal_distance

LOT = get_setting("parking").make()
GOAL = np.array([4.0, 14.0, 0.0, 0.0, 0.0, 1.0])


def trajectories(states, spans=None):
    states = np.asarray(states, float)
    e, _, t, d = states.shape
    spans = np.ones(t) if spans is None else np.asarray(spans, float)
    return Trajectories(np.zeros((e, d)), states, np.zeros((*states.shape[:3], 2)), spans)


def pose(x, y, heading, speed=0.0):
    c, s = np.cos(heading), np.sin(heading)
    return [x, y, speed * c, speed * s, c, s]


poses = st.tuples(st.floats(-30, 30), st.floats(-18, 18), st.floats(-3.1, 3.1), st.floats(-8, 8)).map(
    lambda p: pose(*p)
)


def drive(setting, seed, policy_of=CEMPolicy.parking):
    env = get_setting(setting).make()
    observation, _ = env.reset(seed=seed)
    policy, state, steps, done = policy_of(env), None, 0, False
    while not done:
        action, state = policy.predict(observation, state, np.array([steps == 0]), deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        steps, done = steps + 1, terminated or truncated
    return info["is_success"], env.unwrapped.vehicle, steps, policy


@pytest.mark.parametrize(("setting", "seed"), [("parking", 11), ("parking", 12), ("parking-parked", 13)])
def test_the_planner_parks_and_arrives_standing(setting, seed):
    success, ego, steps, policy = drive(setting, seed)
    assert success
    assert not ego.crashed
    assert abs(ego.speed) < 1.0
    assert steps < 200
    assert policy.fallbacks == 0


def test_a_batch_of_environments_is_driven_as_each_alone():
    seeds, make = (21, 22), get_setting("parking").make
    actions = []
    for seed in seeds:
        env = make()
        observation, _ = env.reset(seed=seed)
        policy, state, taken = CEMPolicy.parking(env), None, []
        for step in range(4):
            action, state = policy.predict(observation, state, np.array([step == 0]))
            observation, *_ = env.step(action)
            taken.append(action)
        actions.append(taken)
    vec = DummyVecEnv([make, make])
    vec.seed(0)
    vec.reset()
    for env, seed in zip(vec.envs, seeds, strict=True):
        env.unwrapped.reset(seed=seed)
    observation = {
        key: np.stack([env.unwrapped.observation_type.observe()[key] for env in vec.envs])
        for key in ("observation", "achieved_goal", "desired_goal")
    }
    policy, state = CEMPolicy.parking(vec), None
    for step in range(4):
        action, state = policy.predict(observation, state, np.array([step == 0] * 2))
        assert np.allclose(action, [actions[0][step], actions[1][step]], atol=1e-6)
        observation, *_ = vec.step(action)


def test_stable_baselines_evaluates_the_planner():
    vec = DummyVecEnv([get_setting("parking").make])
    vec.seed(31)
    returns, lengths = evaluate_policy(CEMPolicy.parking(vec), vec, 2, return_episode_rewards=True, warn=False)
    assert len(returns) == 2
    assert max(lengths) < 200


def test_the_planner_keeps_its_own_state_until_the_goal_changes():
    env = get_setting("parking").make()
    observation, _ = env.reset(seed=41)
    alone, told = CEMPolicy.parking(env), CEMPolicy.parking(env)
    state = None
    for step in range(3):
        a, _ = alone.predict(observation)
        b, state = told.predict(observation, state, np.array([step == 0]))
        assert np.array_equal(a, b)
        observation, *_ = env.step(a)
    observation, _ = env.reset(seed=43)
    assert np.array_equal(alone.predict(observation)[0], CEMPolicy.parking(env).predict(observation)[0])


def test_a_model_that_fails_ends_in_braking():
    class Lost(BicycleModel):
        def rollout_held(self, states, actions, hold):
            return super().rollout_held(states, actions, hold) * np.nan

    env = get_setting("parking").make()
    observation, _ = env.reset(seed=51)
    for _ in range(5):
        observation, *_ = env.step(np.array([1.0, 0.0]))
    policy = CEMPolicy.parking(env, Lost())
    speeds = []
    for _ in range(8):
        action, _ = policy.predict(observation)
        assert policy.last_plan.status == (PlanStatus.FALLBACK,)
        observation, *_ = env.step(action)
        speeds.append(abs(env.unwrapped.vehicle.speed))
    assert policy.fallbacks == 8
    assert speeds[-1] < 1e-6
    assert speeds == sorted(speeds, reverse=True)


@settings(max_examples=50, deadline=None)
@given(poses)
def test_braking_stops_and_never_turns_back(state):
    act, model = brake(LOT), BicycleModel()
    states = np.array([state])
    before = np.hypot(states[0, 2], states[0, 3])
    after = model.step(states, act(states))
    assert np.hypot(after[0, 2], after[0, 3]) <= max(before - 1 + 1e-6, 1e-6)
    assert after[0, 2:4] @ states[0, 2:4] >= -1e-6


@settings(max_examples=50, deadline=None)
@given(poses)
def test_the_distance_to_the_goal_is_the_environments(state):
    reward = LOT.unwrapped.compute_reward(np.array(state) / parking.SCALES, GOAL / parking.SCALES, {})
    assert goal_distance(np.array([[state]]), GOAL)[0, 0] == pytest.approx(-reward)


@settings(max_examples=150, deadline=None)
@given(poses, st.tuples(st.floats(-30, 30), st.floats(-18, 18), st.floats(-3.1, 3.1)))
def test_contact_with_an_obstacle_has_a_cost(state, other):
    """Wherever highway-env's rectangles of ego and obstacle intersect, `ObstacleCost` has its step."""

    def corners(x, y, heading):
        return utils.rect_corners([x, y], 5.0, 2.0, heading, include_midpoints=False, include_center=False)

    heading = np.arctan2(state[5], state[4])
    other = (state[0] + other[0] / 6, state[1] + other[1] / 4, other[2])
    boxes = np.array([[*other, 2.5, 1.0], [np.nan] * 5])
    cost = ObstacleCost(boxes, margin=0.0).stages(trajectories([[[state]]]))[0, 0, 0]
    ego, thing = (np.array([*c, c[0]]) for c in (corners(state[0], state[1], heading), corners(*other)))
    touching, _, _ = utils.are_polygons_intersecting(ego, thing, np.zeros(2), np.zeros(2))
    if touching:
        assert cost >= 1.0
    if np.hypot(other[0] - state[0], other[1] - state[1]) > 2 * np.hypot(2.5, 1.0) + 0.4:
        assert cost == 0.0


@settings(max_examples=100, deadline=None)
@given(poses)
def test_walls_cost_exactly_where_a_corner_is_beyond_the_margin(state):
    heading = np.arctan2(state[5], state[4])
    corners = utils.rect_corners(state[:2], 5.0, 2.0, heading, include_midpoints=False, include_center=False)
    beyond = np.max(np.abs(corners) - (34.0, 20.0))
    cost = WallCost(margin=0.5).stages(trajectories([[[state]]]))[0, 0, 0]
    assert (cost > 0) == (beyond > 0)
    if beyond > 0:
        assert cost == pytest.approx(1.0 + beyond)


def test_nothing_costs_after_success_and_arriving_fast_does():
    fast, slow = pose(4.0, 12.0, np.pi / 2, 3.0), pose(4.0, 12.0, np.pi / 2, 0.3)
    far, after = pose(0.0, 0.0, 0.0), pose(4.0, 30.0, np.pi / 2, 9.0)
    cost = GoalCost(GOAL) + StopCost(GOAL, limit=0.5) + WallCost() + SuccessMask(GOAL) + TerminalWeight(10.0)
    seen = trajectories([[[far, fast, after], [far, slow, after], [far, far, far]]])
    stages = cost.stages(seen)[0]
    assert stages[0, 2] == stages[1, 2] == 0.0
    assert stages[0, 1] - stages[1, 1] == pytest.approx(2.5)
    distance = goal_distance(np.array([[far]]), GOAL)[0, 0]
    assert stages[2].tolist() == pytest.approx([distance, distance, 10 * distance])
    assert np.allclose(cost(seen), cost.stages(seen).sum(axis=2))


def test_costs_add_up_and_scale():
    seen = trajectories(np.random.default_rng(0).normal(size=(2, 3, 4, 6)), spans=[1, 1, 2, 2])
    seen.actions[:] = 0.5
    parts = (InputCost(), SpeedCost(2.0), TimeCost())
    total = 2 * parts[0] + 0.5 * (parts[1] + parts[2])
    expected = sum(w * np.broadcast_to(p.stages(seen), (2, 3, 4)) for w, p in zip((2, 0.5, 0.5), parts, strict=True))
    assert np.allclose(total.stages(seen), expected)
    assert np.allclose(TimeCost().stages(seen), [1, 1, 2, 2])
    assert np.allclose(InputCost().stages(seen)[..., 2], 1.0)

    class Doubtful:
        def disagreement(self, states, actions):
            return np.abs(states[:, :2])

    doubt = DisagreementCost(Doubtful(), scale=(1.0, 0.0)).stages(seen)
    assert np.allclose(doubt[:, :, 0], 0.0)
    assert np.allclose(doubt[:, :, 1:], np.abs(seen.states[:, :, :-1, 0]))
    with pytest.raises(ConfigError, match="Term, Factor and Sum"):
        Sum.of(3.0)
    with pytest.raises(ConfigError, match="finite"):
        InputCost() * np.nan


def test_environments_without_a_parking_goal_are_refused():
    with pytest.raises(ConfigError, match="parking-v0"):
        ParkingTask(get_setting("highway-fast").make())
    with pytest.raises(ConfigError, match="have quality, fast"):
        parking_settings("slow")
    env = get_setting("parking").make()
    observation, _ = env.reset(seed=0)
    with pytest.raises(DataError, match="observation"):
        CEMPolicy.parking(env).predict(observation["observation"])

    class Other(BicycleModel):
        state_dim = 4

    with pytest.raises(ConfigError, match="6 state variables"):
        CEMPolicy.parking(env, Other())
    batch = {key: np.stack([value] * 2) for key, value in observation.items()}
    with pytest.raises(ConfigError, match="2 observations for 1"):
        CEMPolicy.parking(env).predict(batch)
