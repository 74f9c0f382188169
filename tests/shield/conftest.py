"""What the tests of both doors share."""

import pytest
from policies import KINDS, make, model_of


@pytest.fixture(scope="module")
def env():
    env = make()
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module")
def models():
    return {name: model_of(name, make()) for name in KINDS}
