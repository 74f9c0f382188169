"""Fixtures of the tests of both wrappers."""

import pytest
from faults import spied
from policies import KINDS, make, model_of

from shield import ShieldedEnv


@pytest.fixture(scope="module")
def env():
    env = make()
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module")
def models():
    return {name: model_of(name, make()) for name in KINDS}


@pytest.fixture
def spy():
    return spied()


@pytest.fixture
def shielded(spy):
    env = ShieldedEnv(spy)
    env.reset(seed=0)
    return env
