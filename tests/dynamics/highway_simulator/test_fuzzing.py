"""The compiled highway equals highway-env's for any configuration and scene."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_highways import random_configuration, random_scene
from simulator_pair import Pair


def fuzz(seed, most, decisions):
    rng = np.random.default_rng(seed)
    pair = Pair(*random_configuration(rng, most))
    wild = {"dtype": rng.choice([np.float32, np.float64]), "scale": float(rng.choice([0.05, 0.3, 1, 2]))}
    pair.reset([int(rng.integers(1 << 40))])
    pair.drive(decisions, rng, **wild)
    pair.reset()
    pair.drive(decisions, rng, again=True, **wild)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_any_configuration_is_the_same(seed):
    fuzz(seed, 5, 4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_three_hundred_configurations_are_the_same(seed):
    fuzz(seed, 20, 12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1200))
def test_two_hundred_arranged_scenes_are_the_same(seed):
    rng = np.random.default_rng(seed)
    Pair.of(random_scene(rng)).drive(25, rng)
