"""The verified plan of a decision is among the candidates of its first frame: no verified plan is lost between the
two."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pytest
from hand_driven import Placed

from dynamics.errors import SceneError
from shield import ShieldedEnv
from shield.decision import Decision, Guarantee, Reason, Tier

HIGHWAY = {
    "lanes_count": 4,
    "vehicles_count": 0,
    "simulation_frequency": 5,
    "policy_frequency": 5,
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10, 15, 20, 25, 30]},
}
EGO = (328.34423672948145, 5.464903145356177, 0.1216645910955522, 29.759825929979826)
OTHER = (
    (335.65443243450443, 11.790557435658, 0.2498457428056225, 24.755683249566836),
    (340.5793327299099, 11.790557435658, -0.1475025400999838, 23.555683249566837),
    (345.2904663828233, 10.344974706962645, 0.0, 23.10226723405511),
    (349.91091982963434, 11.020467177238544, 2.540398528112465, 23.751554156764083),
)
SIZE = 2.6953449374879246, 0.9899474139252922
LEFT, RIGHT = 0, 2


def driven(actions):
    """The decisions and frames of an ego between two lanes, with a vehicle that approaches from the right."""
    env = ShieldedEnv(gym.make("highway-v0", config=HIGHWAY), "worst-case")
    env.reset(seed=0)
    base = env.unwrapped
    ego, road = base.vehicle, base.road
    ego.position, ego.heading, ego.speed = np.array(EGO[:2]), EGO[2], EGO[3]
    ego.on_state_update()
    ego.target_lane_index, ego.target_speed = ("0", "1", 2), 30.0
    road.vehicles.append(Placed(road, OTHER[0], SIZE, lambda frame: OTHER[min(frame, len(OTHER) - 1)]))
    found = []
    for action in actions:
        info = env.step(action)[-1]
        found.append((env.decisions[0], list(env.frame_decisions), info["shield"]))
    assert env.filter.violations == 0
    return found


def test_the_first_frame_finds_the_verified_plan_of_its_decision():
    """A scene from an attack: the only verified plan steered to a lane that the frame did not try."""
    for decision, frames, _ in driven([RIGHT, LEFT]):
        assert decision.tier.verified or decision.reason is Reason.PRECAUTION
        assert frames[0].reason is not Reason.NO_SAFE_PLAN
        assert frames[0].margin >= 0


@pytest.mark.parametrize("hertz", [5, 15])
def test_no_verified_decision_loses_its_plan_in_random_traffic(hertz):
    config = {**HIGHWAY, "vehicles_count": 25, "vehicles_density": 2.0, "duration": 8, "simulation_frequency": hertz}
    env = ShieldedEnv(gym.make("highway-v0", config={**config, "policy_frequency": 5}), "worst-case")
    rng, decided = np.random.default_rng(5), 0
    for seed in range(3):
        env.reset(seed=seed)
        done = False
        while not done:
            *_, terminated, truncated, _ = env.step(int(rng.integers(5)))
            done = terminated or truncated
            if env.decisions[0].tier.verified:
                decided += 1
                assert env.frame_decisions[0].reason is not Reason.NO_SAFE_PLAN
    assert decided > 50


def test_a_stored_plan_that_does_not_verify_has_no_guarantee():
    common = {"proposed": 0, "executed": 4, "tier": Tier.STORED_PLAN, "latency": 0.0}
    assert Decision(reason=Reason.NO_SAFE_PLAN, margin=-0.1, **common).guarantee is Guarantee.NONE
    assert Decision(reason=Reason.NO_SAFE_PLAN, margin=0.1, **common).guarantee is Guarantee.ALL_SEEN
    assert Decision(reason=Reason.PRECAUTION, margin=0.0, **common).guarantee is Guarantee.ALL_SEEN


def test_an_ego_of_another_length_is_refused():
    """Plans are rolled out for a vehicle of 5 m."""
    env = ShieldedEnv(gym.make("highway-v0", config=HIGHWAY), "worst-case")
    env.reset(seed=0)
    env.unwrapped.vehicle.LENGTH = 8.0
    assert env.step(1)[-1]["shield"]["reason"] == "bad_scene"
    with pytest.raises(SceneError, match="8 m long"):
        env.filter.reader.check()
