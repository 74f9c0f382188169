"""The replacement of a proposal is as near to it as any verified input, up to two percent of the actuators' ranges."""

from __future__ import annotations

import numpy as np
import pytest
from continuous_world import STYLES, Adversary, propose, random_continuous_world
from cores import ContinuousCore
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynamics.scenes.scene import Scene
from shield import Tier

RANGES = np.array([10.0, np.pi / 2])
GRID = np.stack(np.meshgrid(np.linspace(-5, 5, 41), np.linspace(-np.pi / 4, np.pi / 4, 41)), axis=-1).reshape(-1, 2)
CHUNK = 120


def distance(inputs: np.ndarray, proposal: np.ndarray) -> np.ndarray:
    return np.hypot(*((inputs - proposal) / RANGES).T)


def verified(core: ContinuousCore, scene: Scene, inputs: np.ndarray) -> np.ndarray:
    """Mask of the inputs (n, 2) that verify, each in any lane in which it can stop."""
    lanes = core.inputs.stop_lanes(core.observe(scene))
    chunks = [inputs[i : i + CHUNK] for i in range(0, len(inputs), CHUNK)]
    return np.concatenate([core.judge(scene, chunk, lanes).margin >= 0 for chunk in chunks])


def shortfall(seed: int, style: str, mood: str, predictive: bool) -> float | None:
    """How much nearer than the filter's answer the nearest verified point of a dense grid is, as a share of the
    ranges; None where no proposal of this drive had to be replaced."""
    rng = np.random.default_rng(seed)
    world, adversary = random_continuous_world(rng, predictive=predictive), Adversary(rng, mood)
    first = int(rng.integers(15))
    for k in range(first + 25):
        scene, proposal, stored = world.scene(), propose(rng, style, world, k), world.core.stored
        inputs, decision = world.core.filter(scene, proposal)
        if k == 0 and decision.tier.fallback:
            return None
        if k >= first and decision.tier is Tier.GOVERNED:
            world.core.stored = stored
            mine = float(distance(inputs, proposal))
            nearer = GRID[distance(GRID, proposal) < mine - 0.02]
            nearer = nearer[verified(world.core, scene, nearer)] if nearer.size else nearer
            return mine - float(distance(nearer, proposal).min()) if nearer.size else 0.0
        world.claim(world.core.stored)
        world.move_cars(adversary.wishes(world))
        world.move_inputs(inputs)
    return None


def share_beyond(drives: int, predictive: bool) -> tuple[int, float]:
    """Of how many replaced proposals, and which share of them had a verified input nearer by more than 2 %."""
    kinds = [(style, mood) for style in STYLES for mood in Adversary.moods]
    found = [shortfall(seed, *kinds[seed % len(kinds)], predictive) for seed in range(drives)]
    replaced = np.array([x for x in found if x is not None])
    return replaced.size, float(np.mean(replaced > 0.02))


@pytest.mark.parametrize("predictive", [False, True])
def test_hardly_any_verified_input_is_nearer_by_more_than_two_percent(predictive: bool) -> None:
    """The set that verifies has slivers that a search of some 130 inputs can miss: measured 2 times in 465."""
    replaced, share = share_beyond(45, predictive)
    assert replaced >= 25
    assert share <= 0.03


@pytest.mark.slow
@pytest.mark.parametrize("predictive", [False, True])
def test_hardly_any_verified_input_is_nearer_in_many_scenes(predictive: bool) -> None:
    replaced, share = share_beyond(600, predictive)
    assert replaced >= 300
    assert share <= 0.01


@settings(deadline=None, max_examples=40, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32 - 1), st.sampled_from(STYLES), st.sampled_from(Adversary.moods))
def test_the_replacement_of_a_proposal_verifies(seed: int, style: str, mood: str) -> None:
    rng = np.random.default_rng(seed)
    world = random_continuous_world(rng)
    proposal = propose(rng, style, world, 0)
    inputs, decision = world.core.filter(world.scene(), proposal)
    if decision.tier is Tier.GOVERNED:
        world.core.reset()
        world.core.filter(world.scene(), np.zeros(2))
        assert verified(world.core, world.scene(), inputs[None]).all()
