"""The figures of the decision are drawn from values that the shield computes."""

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from dynamics.state import RoadState
from evaluation.commands.cli import app
from evaluation.report.decision_scenes import (
    CONFIG,
    Obligation,
    bounds,
    cut_in_scene,
    input_search,
    obligation_scene,
    passing,
    tube,
)
from shield.certificate.road.memory import Memory, observe
from shield.certificate.road.verify import PathVerifier
from shield.pipelines.inputs import InputPipeline


def test_the_command_writes_five_pictures(tmp_path):
    result = CliRunner().invoke(app, ["figures", "--output", str(tmp_path / "a")], catch_exceptions=False)
    assert result.exit_code == 0
    pictures = sorted((tmp_path / "a").iterdir())
    assert [path.name for path in pictures] == ["cut-in.png", "duties.png", "occupancy.png", "search.png", "tube.png"]
    for path in pictures:
        assert path.stat().st_size < 60_000
        assert 750 < Image.open(path).width < 850


def test_the_margin_of_the_tube_is_the_clearance_of_its_path():
    found = tube()
    lanes = np.array([1])
    judged = PathVerifier(found.scene, CONFIG).clearance(found.path[None], lanes, lanes)
    assert found.margin == pytest.approx(float(judged.margin[0]))
    assert found.margin == pytest.approx(float(found.gaps.min()))
    assert found.margin > 0
    assert found.path[-1, RoadState.SPEED] == 0


def test_the_bounds_are_those_of_the_assumptions():
    found, a = bounds(), CONFIG.assumptions
    fast, _ = found.speeds
    rear, front = found.moving
    stopped = rear[-1] - rear[0] + fast / 15
    # On a free road it brakes calmly for three seconds, and as hard as can be afterwards.
    then = fast - 3 * a.comfortable_braking
    lost = a.turning_loss * (1 + 3.5 / 15) + a.turning_loss_back * (3 + then / a.braking)
    assert stopped == pytest.approx(3 * (fast + then) / 2 + then**2 / (2 * a.braking) - lost, abs=1.5)
    assert np.diff(front).max() * 15 <= min(a.max_speed, fast + a.acceleration * found.time[-1])
    assert found.queueing[0][-1] < found.queueing[0][0] - 1
    assert found.queueing[0][-1] > found.stands - a.queue_distance - 5
    middle, off, across = found.around.high - found.around.low
    assert middle == pytest.approx(2 + 2 * a.lateral_deviation)
    assert middle < off < 4 + 2 * a.marking_tolerance < across


def test_only_vehicles_with_an_obligation_are_left_out_of_the_margin():
    found = obligation_scene()
    assert set(found.obligations) == set(Obligation)
    owing = np.array([duty is Obligation.DISTANCE for duty in found.obligations])
    assert np.isposinf(found.separations[owing]).all()
    assert found.margin == pytest.approx(found.separations[~owing].min())
    assert found.margin > 0
    assert found.verifier.others.comes[found.goal, found.obligations.index(Obligation.ENTERS)]


def test_the_drawn_separations_are_those_of_the_clause():
    """The precaution of cut-ins refuses a plan in the scene drawn; without it the stored plan still verifies."""
    found = cut_in_scene(0.5)
    centred, off = found.separations[:, found.at]
    assert centred >= 0 > off
    now = observe(Memory(), passing(float(found.ahead[found.at]), found.offsets[1]), CONFIG)
    assert np.array_equal(now.scene.ego, found.shown.ego)
    fail_safe = now.fail_safe()
    assert fail_safe.binding.clause != "cut-in"
    assert fail_safe.margin >= 0
    lanes = np.array([fail_safe.lane])
    refused = now.verifier.clearance(fail_safe.path[None], lanes, lanes)
    assert refused.binding(0).clause == "cut-in"
    assert float(refused.margin[0]) == pytest.approx(off, abs=0.1)


def test_the_drawn_answer_verifies_and_nothing_on_the_grid_is_much_nearer():
    found = input_search((61, 81))
    inputs = InputPipeline(CONFIG, predictive=False)
    now, _ = inputs.observe(Memory(), found.scene)
    both = inputs.judge(now, np.array([found.proposal, found.decision.executed]), inputs.stop_lanes(now))
    assert both.margin[0] < 0 <= both.margin[1]
    grid = np.stack(np.meshgrid(found.accelerations, found.wheels, indexing="ij"), axis=-1)
    spans = np.ptp([inputs.actuators.acceleration, inputs.actuators.steering], axis=1)
    distance = np.hypot(*((grid - found.proposal) / spans).T).T
    reached = np.hypot(*((found.decision.executed - found.proposal) / spans))
    assert distance[found.margins >= 0].min() > reached - 0.02
    assert any(np.array_equal(found.decision.executed, x) for x in np.concatenate([found.linearised, found.strewn]))
