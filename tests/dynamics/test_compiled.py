"""What `compiled` promises: kernels are kept on disk, and one that would go stale there is refused."""

import numpy as np
import pytest

from dynamics.compiled import compiled
from dynamics.vehicle.rollout_kernels import slip_at


def calls_another_file(x):
    return slip_at(x, x, x, x, x, np.zeros((8, 0)), 0.1)


def _half(x):
    return 0.5 * x


half = compiled(_half)


def quarter(x):
    return half(half(x))


def test_a_kernel_of_another_file_is_refused():
    with pytest.raises(TypeError, match=r"slip_at of dynamics\.vehicle\.rollout_kernels"):
        compiled(calls_another_file)


def test_a_kernel_of_the_same_file_may_be_called():
    assert compiled(quarter)(2.0) == 0.5
