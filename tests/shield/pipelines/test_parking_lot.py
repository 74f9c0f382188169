"""In a parking lot: no executed input brings the ego nearer than the clearance, and a stop always exists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cores import LotCore
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from lot_world import DT, Driver, advance, clearance_of, random_lot

from dynamics.scenes.parking_lot import ParkingScene
from dynamics.state import State
from dynamics.vehicle.actuators import Actuators
from shield import Reason, ShieldConfig, Tier
from shield.errors import ConfigError

SEEDS, STYLES = st.integers(0, 2**32 - 1), st.sampled_from(Driver.STYLES)
CLEARANCE = st.sampled_from([0.01, 0.1, 0.5])
ACTUATORS = Actuators()
OPEN = ParkingScene(np.array([0.0, 0, 0, 0, 5, 2]), np.array([[20.0, 0, np.pi / 2, 0, 4000, 1]]), DT)
WALL_AT = 19.5 - 2.5
"""Where the ego's centre is when its front touches the wall of `OPEN` [m]."""


def at(x=0.0, speed=0.0, lot=OPEN):
    return replace(lot, ego=np.array([x, 0, 0, speed, 5, 2]))


def core_of(period, clearance=0.1):
    return LotCore(ShieldConfig(clearance=clearance), ACTUATORS, period)


def admits_a_plan(core, lot):
    """Whether braking with some wheel angle verifies; this does not depend on the proposal."""
    brake = float(core.brake(lot)[0])
    wheels = np.linspace(-1, 1, 13) * np.pi / 4
    return bool((core.judge(lot, np.stack([np.full(13, brake), wheels], axis=1)).margin >= 1e-6).any())


def drive(core, lot, driver, period, decisions):
    """Each decision, its record, and the lots of the frames in which it was carried out."""
    hold = period or 1
    for k in range(decisions):
        proposal = ACTUATORS.physical(ACTUATORS.read(driver.act(lot, k)))
        inputs, decision = core.filter(lot, proposal)
        if period is not None and decision.tier is not Tier.PASSED:
            # Through actions alone only values of single precision can be executed.
            inputs = ACTUATORS.physical(ACTUATORS.normalised(inputs))
        lots = [lot]
        for _ in range(hold):
            lots.append(advance(lots[-1], inputs))
        yield proposal, inputs, decision, lots
        lot = lots[-1]


@settings(deadline=None, max_examples=40)
@given(SEEDS, STYLES, CLEARANCE, st.sampled_from([None, 3, 15]))
def test_no_body_comes_nearer_than_the_clearance_after_a_verified_state(seed, style, clearance, period):
    rng = np.random.default_rng(seed)
    lot, driver, core = random_lot(rng), Driver(rng, style), core_of(period, clearance)
    assume(admits_a_plan(core, lot))
    for proposal, inputs, decision, lots in drive(core, lot, driver, period, 16):
        # The stop of the frame before always exists: no input is executed without a certificate.
        assert decision.tier.verified or decision.tier is Tier.STORED_PLAN
        assert core.stored is not None
        if decision.tier is Tier.PASSED:
            assert inputs is proposal
        for after in lots[1:]:
            gap, coming = clearance_of(after)
            assert gap >= clearance - 1e-6
            assert coming > 0  # otherwise highway-env would count a crash


@settings(deadline=None, max_examples=60)
@given(SEEDS, STYLES, st.sampled_from([None, 3]))
def test_the_verified_stop_can_be_driven_from_any_frame(seed, style, period):
    """Induction: brake from now on, as after a failure of the policy, and end at rest and clear."""
    rng = np.random.default_rng(seed)
    lot, driver, core = random_lot(rng), Driver(rng, style), core_of(period)
    assume(admits_a_plan(core, lot))
    *_, (_, _, _, lots) = drive(core, lot, driver, period, int(rng.integers(1, 12)))
    lot = lots[-1]
    for _ in range(60 if period is None else 20):
        inputs = core.brake(lot)
        for _ in range(period or 1):
            lot = advance(lot, inputs)
            gap, coming = clearance_of(lot)
            assert gap >= 0.1 - 1e-6
            assert coming > 0
    assert abs(lot.ego[State.SPEED]) < 1e-9


@settings(deadline=None, max_examples=40)
@given(SEEDS, STYLES)
def test_the_margin_is_that_of_the_plan(seed, style):
    rng = np.random.default_rng(seed)
    lot, driver, core = random_lot(rng), Driver(rng, style), core_of(None)
    proposal = ACTUATORS.physical(ACTUATORS.read(driver.act(lot, 0)))
    inputs, decision = core.filter(lot, proposal)
    assume(decision.tier.verified)
    margin, now = np.inf, lot
    for state in decision.plan[1:]:
        now = advance(now, inputs)
        assert now.ego[:4] == pytest.approx(state, abs=1e-9)
        gap, coming = clearance_of(now)
        margin = min(margin, gap - 0.1, coming)
        v = float(now.ego[State.SPEED])
        inputs = np.array([np.clip(-v / DT, -9.8, 9.8), inputs[1]])
    assert decision.margin == pytest.approx(margin, abs=2e-5)
    assert decision.margin >= 0


@pytest.mark.parametrize("style", Driver.STYLES)
def test_a_verified_input_is_executed_if_braking_with_some_wheel_angle_verifies(style):
    found = 0
    for seed in range(250):
        rng = np.random.default_rng(seed)
        lot, driver, core = random_lot(rng), Driver(rng, style), core_of(None)
        if admits_a_plan(core, lot):
            found += 1
            proposal = ACTUATORS.physical(ACTUATORS.read(driver.act(lot, 0)))
            assert core.filter(lot, proposal)[1].tier.verified, seed
    assert found > 100


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_a_repair_is_about_as_near_as_the_nearest_on_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    lot, driver, core = random_lot(rng, speed=2.0), Driver(rng, "ram"), core_of(None)
    assume(admits_a_plan(core, lot))
    for proposal, inputs, decision, lots in drive(core, lot, driver, None, 90):  # noqa: B007
        if decision.tier is Tier.GOVERNED:
            break
    lot = lots[0]
    assume(decision.tier is Tier.GOVERNED)
    spans = np.array([10.0, np.pi / 2])
    grid = np.stack(np.meshgrid(np.linspace(-5, 5, 41), np.linspace(-1, 1, 41) * np.pi / 4), axis=-1).reshape(-1, 2)
    good = core.judge(lot, grid).margin >= 0
    assume(good.any())
    nearest = np.hypot(*((grid[good] - proposal) / spans).T).min()
    assert np.hypot(*((inputs - proposal) / spans)) <= 1.1 * nearest + 0.08


def test_every_proposal_far_from_obstacles_passes_bit_for_bit():
    core = core_of(None)
    for proposal in ACTUATORS.physical(np.random.default_rng(0).uniform(-1, 1, (50, 2))):
        inputs, decision = core.filter(at(-10.0), proposal)
        assert inputs is proposal
        assert (decision.tier, decision.reason) == (Tier.PASSED, Reason.NONE)
        assert not decision.overridden


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("period", [None, 3])
def test_the_ego_comes_up_to_the_clearance_and_not_further(way, period):
    turned = replace(OPEN, ego=np.array([WALL_AT - 0.6, 0, 0 if way > 0 else np.pi, 0, 5, 2]))

    class Ram:
        def act(self, lot, k):
            return np.array([way, 0.0], dtype=np.float32)

    driven = list(drive(core_of(period), turned, Ram(), period, 60))
    gaps = [clearance_of(lot)[0] for *_, lots in driven for lot in lots]
    assert 0.1 - 1e-6 <= min(gaps) < 0.15
    assert all(decision.tier.verified for _, _, decision, _ in driven)


def test_a_brake_harder_than_the_policys_is_used_at_every_frame_only():
    lot, proposal = at(WALL_AT - 3.5, 7.0), np.array([0.0, 0.0])  # 2.7 m at 9.8 m/s^2, 5.2 m at 5
    assert core_of(None).filter(lot, proposal)[1].tier is Tier.PASSED
    assert core_of(3).filter(lot, proposal)[1].tier is not Tier.PASSED
    for speed in (7.0, -7.0):
        brakes = [core_of(p).brake(at(0, speed))[0] for p in (None, 3)]
        assert brakes == [-np.sign(speed) * 9.8, -np.sign(speed) * 5.0]


def test_reset_forgets():
    core, lot = core_of(None), at(WALL_AT - 1.0, 1.0)
    core.filter(lot, np.array([5.0, 0.3]))
    moved = replace(lot, obstacles=lot.obstacles + np.array([0, 0, 0, 0.5, 0, 0]))
    core.filter(moved, np.zeros(2))
    core.filter(lot, np.array([0.0, 0.3]))
    assert core.stored is not None
    assert core.violations == 1
    core.reset()
    assert core.stored is None
    assert core.violations == 0
    fresh = core_of(None)
    for k in range(5):
        proposal = np.array([5.0, 0.1 * k])
        assert np.array_equal(core.filter(lot, proposal)[0], fresh.filter(lot, proposal)[0])


# -- fallbacks -------------------------------------------------------------------------------------------------------


def test_a_start_without_a_verified_plan_is_recorded():
    core, lot = core_of(None), at(WALL_AT + 0.2, 0.0)
    inputs, decision = core.filter(lot, np.array([5.0, 0.0]))
    assert (decision.reason, decision.tier) == (Reason.NO_SAFE_PLAN, Tier.LARGEST_MARGIN)
    assert decision.margin < 0
    assert core.stored is None
    assert np.isfinite(inputs).all()


@pytest.mark.parametrize("speed", [6.0, -6.0])
def test_a_moving_body_makes_the_ego_brake_against_its_velocity(speed):
    core, lot = core_of(None), at(0.0, speed)
    core.filter(lot, np.array([0.0, 0.2]))
    moving = replace(lot, obstacles=lot.obstacles + np.array([0, 0, 0, 1.0, 0, 0]))
    for _ in range(2):
        inputs, decision = core.filter(moving, np.array([5.0, 0.0]))
        assert (decision.reason, decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)
        assert inputs[0] == pytest.approx(-np.sign(speed) * 9.8)
    assert core.violations == 1
    assert core.stored is None
    assert core.filter(lot, np.zeros(2))[1].tier is Tier.PASSED
    core.filter(moving, np.zeros(2))
    assert core.violations == 2


@pytest.mark.parametrize("column", range(6))
@pytest.mark.parametrize("who", ["ego", "obstacles"])
def test_a_lot_that_is_not_finite_brakes_with_finite_inputs(who, column):
    value = getattr(OPEN, who).copy()
    value[..., column] = np.nan
    inputs, decision = core_of(None).filter(replace(at(0.0, 3.0), **{who: value}), np.array([5.0, 0.3]))
    assert (decision.reason, decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)
    assert np.isfinite(inputs).all()
    assert inputs[0] <= 0


@pytest.mark.parametrize("speed", [40.5, -40.5, 1e12])
def test_no_plan_is_verified_above_the_speed_limit_of_the_bicycle_model(speed):
    inputs, decision = core_of(None).filter(at(-500.0, speed), np.zeros(2))
    assert (decision.reason, decision.tier) == (Reason.BAD_SCENE, Tier.EMERGENCY)
    assert inputs[0] * speed < 0


def test_no_input_passes_that_exceeds_the_speed_limit_of_the_bicycle_model():
    lot = at(-500.0, 39.9)
    assert core_of(None).filter(lot, np.array([0.0, 0.0]))[1].tier is Tier.PASSED
    inputs, decision = core_of(None).filter(lot, np.array([5.0, 0.0]))
    assert decision.tier is Tier.GOVERNED
    assert inputs[0] <= 1.5 + 1e-9


@pytest.mark.parametrize(
    ("actuators", "message"),
    [
        (Actuators(longitudinal=False), "longitudinal is False"),
        (Actuators(acceleration=(0.0, 5.0)), "0 to 5"),
        (Actuators(acceleration=(-5.0, 0.0)), "-5 to 0"),
    ],
)
def test_actions_that_cannot_brake_are_refused_where_they_must(actuators, message):
    with pytest.raises(ConfigError, match=message):
        LotCore(ShieldConfig(), actuators, period=3)
    LotCore(ShieldConfig(), actuators)
    LotCore(ShieldConfig(mode="none"), actuators, period=3)


@pytest.mark.parametrize("mode", ["distance", "rss", "ttc"])
def test_rules_for_meta_actions_are_refused(mode):
    with pytest.raises(ConfigError, match="none or full"):
        LotCore(ShieldConfig(mode=mode))


def test_the_repair_does_not_steer_without_a_steering_input():
    core = LotCore(ShieldConfig(), Actuators(lateral=False), period=3)
    lot = at(WALL_AT - 0.5, 1.0)
    inputs, decision = core.filter(lot, np.array([5.0, 0.0]))
    assert decision.tier is Tier.GOVERNED
    assert inputs[1] == 0


def test_nothing_verifies_in_a_parking_lot_within_the_clearance():
    """At rest, 3 cm nearer to a wall ahead and to one behind than it should be."""
    walls = np.array([[4.07 * i, 0.0, np.pi / 2, 0.0, 40.0, 3.0] for i in (-1, 1)])
    lot = ParkingScene(np.array([0.0, 0, 0, 0, 5, 2]), walls, DT)
    assert not LotCore().filter(lot, np.array([1.0, 0.0]))[1].tier.verified
