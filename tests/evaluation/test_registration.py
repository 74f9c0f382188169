"""Gymnasium knows the environments of this package once it is imported."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("name", ["ComplexRoads-v0", "ComplexRoads", "lane-keeping-half-minute-v0"])
def test_an_import_of_the_package_registers_its_environments(name):
    made = f"env = gymnasium.make({name!r}); env.reset(seed=0); print(env.unwrapped.spec.id)"
    code = f"import evaluation, gymnasium; {made}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().startswith(name)


def test_a_second_registration_changes_nothing(monkeypatch):
    import gymnasium as gym

    from evaluation.registration import register_environments

    before = gym.registry["ComplexRoads-v0"]
    register_environments()
    assert gym.registry["ComplexRoads-v0"] is before
