"""Several egos, each of which counts on the others' plans."""

from __future__ import annotations

from copy import deepcopy

import gymnasium as gym
import highway_env  # noqa: F401
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from input_scenes import gap
from slowly import later

from shield import ConfigError, Shield, ShieldConfig, ShieldedEnv
from shield.decision import Tier

EXACT = ShieldConfig.simulated_traffic()
IDS = ("intersection-multi-agent-v0", "intersection-multi-agent-v2")
FASTER = 2


def make(egos=2, env_id=IDS[0], **config):
    return gym.make(env_id, config={"controlled_vehicles": egos, **config})


def gaps(env):
    """The distance from each ego with its buffer to the nearest body [m]."""
    return [gap(env, EXACT.buffer, ego) for ego in env.controlled_vehicles]


def drive(egos, seed, policy, env_id=IDS[0]):
    """Yields the shield before and after each decision; at every frame of a verified one, all buffers are clear."""
    env = ShieldedEnv(make(egos, env_id), EXACT)
    env.reset(seed=seed)
    base, rng, done = env.unwrapped, np.random.default_rng(seed), False
    advance = base.road.step
    while not done:
        least = []

        def step(dt, least=least):
            advance(dt)
            least.extend(gaps(base))

        base.road.step = step
        *_, truncated, info = env.step(tuple(policy(rng) for _ in range(egos)))
        base.road.step = advance
        if all(decision.tier.verified for decision in env.last_decisions):
            assert min(least) >= -1e-9
        yield env, base, info["shield"]
        done = base._is_terminated() or truncated
        assert done == ("shield_episode" in info)
    assert not any(vehicle.crashed for vehicle in base.controlled_vehicles)
    assert env._filter.violations == 0


@pytest.mark.parametrize("egos", [4, *later(2)])
@pytest.mark.parametrize("env_id", IDS)
def test_no_ego_of_several_touches_another_vehicle(egos, env_id):
    """All egos always faster, and all at random: true rectangles in each frame, and the traffic moves as predicted."""
    overridden = 0
    for seed, policy in ((903, lambda rng: FASTER), (904, lambda rng: int(rng.integers(3)))):
        for _, _, info in drive(egos, seed, policy, env_id):
            assert len(info["agents"]) == egos
            assert info["overridden"] == any(each["overridden"] for each in info["agents"])
            overridden += info["overridden"]
    assert overridden


def test_all_egos_arrive():
    for seed in (905, 907):
        arrived = np.zeros(4, bool)
        for _, base, _ in drive(4, seed, lambda rng: FASTER):
            arrived |= [base.has_arrived(vehicle) for vehicle in base.controlled_vehicles]
        assert arrived.all()


def test_the_joint_plans_are_clear():
    """After a decision, all plans are driven at once in a copy of highway-env: no vehicle comes into an ego's
    buffer."""
    driven = 0
    for n, (env, base, _) in enumerate(drive(4, 908, lambda rng: FASTER)):
        if n % 3 or not all(decision.tier.verified for decision in env.last_decisions):
            continue
        copy, plans, driven = deepcopy(base), [p.actions[0, : p.length[0]] for p in env._filter._plans], driven + 1
        # Except vehicles that have appeared since the decision.
        known = list(env._filter._scene._predicted_columns)
        there = [v in known for v in base.road.vehicles]
        copy.road.vehicles = [v for v, old in zip(copy.road.vehicles, there, strict=True) if old]
        for actions in list(zip(*plans, strict=False))[:8]:
            copy._simulate(tuple(int(action) for action in actions))
            copy._clear_vehicles()
            assert min(gaps(copy)) >= -1e-9
    assert driven


def test_two_that_meet_do_not_both_go():
    """Two alone at a crossing: one at most is held back, and none waits for ever."""
    for seed in range(910, 914):
        env = ShieldedEnv(make(2, spawn_probability=0.0), EXACT)
        env.reset(seed=seed)
        base = env.unwrapped
        base.road.vehicles = list(base.controlled_vehicles)
        arrived = np.zeros(2, bool)
        for _ in range(13):
            *_, terminated, truncated, _ = env.step((FASTER, FASTER))
            arrived |= [base.has_arrived(vehicle) for vehicle in base.controlled_vehicles]
            if terminated or truncated:
                break
        assert arrived.all()
        assert not any(vehicle.crashed for vehicle in base.controlled_vehicles)


def test_the_plan_of_one_ego_is_verified_for_all_egos():
    """A vehicle stands in the second ego's buffer, so no plan of the first ego is clear for all egos."""
    env = ShieldedEnv(make(2), EXACT)
    env.reset(seed=920)
    base = env.unwrapped
    first, second = base.controlled_vehicles
    stander = IDMVehicle(base.road, second.position + 5.3 * second.direction, second.heading, 0.0)
    stander.target_speed = 0.0
    stander.plan_route_to("o1")
    for near in (False, True):
        base.road.vehicles = [first, second] + ([stander] if near else [])
        second.speed = 0.0
        env._filter.reset()
        decisions = env._filter.decide((FASTER, 0))
        assert np.hypot(*(first.position - second.position)) > 40
        assert decisions[0].tier is (Tier.LARGEST_MARGIN if near else Tier.PASSED)


def test_a_single_ego_with_multi_agent_actions_gets_the_decisions_of_one_ego():
    one, team = gym.make("intersection-v0"), make(1)
    alone, together = ShieldedEnv(one, EXACT), ShieldedEnv(team, EXACT)
    alone.reset(seed=921)
    together.reset(seed=921)
    for _ in range(8):
        *_, terminated, truncated, info = alone.step(FASTER)
        *_, mine = together.step((FASTER,))
        assert mine["shield"]["tier"] == info["shield"]["tier"]
        assert mine["shield"]["margin"] == info["shield"]["margin"]
        assert np.array_equal(one.unwrapped.vehicle.position, team.unwrapped.vehicle.position)
        if terminated or truncated:
            break


def test_an_invalid_action_and_an_unreadable_scene_of_several_egos_fall_back():
    env = ShieldedEnv(make(2), EXACT)
    env.reset(seed=930)
    *_, info = env.step((FASTER, 17))
    assert [each["reason"] for each in info["shield"]["agents"]][1] == "bad_action"
    base = env.unwrapped
    stranger = type("Stranger", (IDMVehicle,), {"act": lambda self, action=None: None})
    base.road.vehicles.append(stranger(base.road, [200.0, 200.0], 0.0, 0.0))
    *_, info = env.step((FASTER, FASTER))
    assert {each["reason"] for each in info["shield"]["agents"]} == {"bad_scene"}
    assert all(decision.tier in (Tier.STORED_PLAN, Tier.EMERGENCY) for decision in env.last_decisions)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ShieldedEnv(make(2), ShieldConfig()), "ShieldConfig.simulated_traffic"),
        (lambda: Shield(lambda obs: (1, 1), make(2), EXACT), "those of several"),
        (
            lambda: ShieldedEnv(
                make(2, action={"type": "MultiAgentAction", "action_config": {"type": "ContinuousAction"}}), EXACT
            ),
            "DiscreteMetaAction; here they have ContinuousAction",
        ),
        (lambda: ShieldedEnv(make(2), EXACT).step((1,)), "2 egos and 1 actions"),
    ],
)
def test_settings_that_do_not_support_several_egos_are_refused(build, message):
    with pytest.raises(ConfigError, match=message):
        build()
