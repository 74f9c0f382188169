"""Crashes caused by a noisy sensor: episodes that are repeated with other noise from some decision on.

On a straight highway the traffic is a function of the scene, but sensor noise is random in every frame. So paths can be
split: an episode that came near a crash is repeated with other noise from there on. The episode is driven again from
its seeds and from the start. The alternative would be a copy of the whole state of the shield.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import gymnasium as gym
import joblib
import numpy as np

from dynamics.compiled import kernel_no_refcount
from dynamics.state import FloatArray
from evaluation.falsification.splitting import Split, SplitPath, multilevel_splitting
from evaluation.measuring.recorder import Track
from evaluation.measuring.tally import HORIZON, SOON, time_to_collision
from evaluation.running.driver import Driver, DriverSpec
from evaluation.running.identity import check_files, hash_of_files
from evaluation.threads import one_thread
from evaluation.wrappers.sensor_noise import SensorNoise
from shield.errors import ConfigError

__all__ = ["NoisyEpisodes", "crash_probability_through"]


@kernel_no_refcount
def _nearest(states: FloatArray, out: FloatArray) -> None:
    """Least time to a collision of the ego in each frame, at constant velocities.

    Parameters
    ----------
    states : states of all vehicles, the ego first, (frames, vehicles, 8).
    out : result, (frames,) [s]; 0 from a crash on.
    """
    for k in range(states.shape[0]):
        out[k] = HORIZON
        for i in range(1, states.shape[1]):
            out[k] = min(out[k], max(time_to_collision(states[k, 0], states[k, i]), SOON))
        if states[k, 0, Track.CRASHED] > 0:
            out[k] = 0.0


class NoisyEpisodes:
    """Episodes as functions of a `SplitPath`: seeds of the scene and of the noise.

    Parameters
    ----------
    spec : the environment, the policy and the shield, with a noisy sensor (see `evaluation.wrappers.split_sensor`).

    Raises
    ------
    ConfigError
        If the sensor is exact, so that nothing is random after the reset.
    """

    def __init__(self, spec: DriverSpec) -> None:
        self._driver = Driver(spec)
        env: gym.Env = self._driver.env
        while not isinstance(env, SensorNoise):
            if not isinstance(env, gym.Wrapper):
                raise ConfigError(
                    f"nothing is random after the reset through the sensor {spec.sensor!r}; have a noisy one"
                )
            env = env.env
        self._sensor = env

    def drive(self, path: SplitPath) -> FloatArray:
        """Negative of the least time to a collision, at the reset and within each decision, (decisions + 1,) [s].

        It is 0 in a crash.
        """
        forks = dict(path.forks)

        def before(decision: int) -> None:
            if decision in forks:
                self._sensor.redraw(forks[decision])

        with one_thread():
            steps = sum(1 for _ in self._driver.decisions(path.seed, before))
        states = self._driver.recorder.history().states
        times = np.empty(len(states))
        _nearest(np.ascontiguousarray(states), times)
        frames = -(-(len(states) - 1) // steps)
        within = [times[1 + k * frames : 1 + (k + 1) * frames].min() for k in range(steps)]
        return -np.array([times[0], *within])

    def close(self) -> None:
        """Close the environment."""
        self._driver.env.close()


def crash_probability_through(
    spec: DriverSpec,
    paths: int = 200,
    share: float = 0.1,
    seed: int = 0,
    most: int | None = None,
    jobs: int = 1,
) -> Split:
    """Estimate the probability that an episode with a noisy sensor ends in a crash, by splitting paths near a crash.

    The score is the least time to a collision at constant velocities, as in
    `evaluation.falsification.falsify.crash_probability`.

    Parameters
    ----------
    spec : see `NoisyEpisodes`.
    paths, share, seed, most : see `multilevel_splitting`; the first scenes have the seeds from `seed` on.
    jobs : processes; -1 for one per core.

    Raises
    ------
    ConfigError
        If the sensor is exact, or a policy object would have to drive in several processes.
    """
    if joblib.effective_n_jobs(jobs) == 1:
        episodes = NoisyEpisodes(spec)
        try:
            return multilevel_splitting(lambda ways: [episodes.drive(x) for x in ways], 0.0, paths, share, seed, most)
        finally:
            episodes.close()
    files = hash_of_files(_policy(spec))
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1), joblib.Parallel(n_jobs=jobs) as pool:

        def drive(ways: Sequence[SplitPath]) -> Sequence[FloatArray]:
            found: list[FloatArray] = pool(joblib.delayed(_drive)(spec, files, x) for x in ways)
            return found

        return multilevel_splitting(drive, 0.0, paths, share, seed, most)


@lru_cache(maxsize=1)
def _kept(spec: DriverSpec, files: str) -> NoisyEpisodes:
    """Episodes of a spec, cached while `files`, the hashes of the policy's files, stay the same."""
    check_files(_policy(spec), None, files)
    return NoisyEpisodes(spec)


def _drive(spec: DriverSpec, files: str, path: SplitPath) -> FloatArray:
    return _kept(spec, files).drive(path)


def _policy(spec: DriverSpec) -> str:
    """Policy of the spec, by name or path; a policy object has no files to compare, and raises `ConfigError`."""
    if not isinstance(spec.policy, str):
        raise ConfigError(
            f"a {type(spec.policy).__name__} drives in one process only; have a policy by name or a zip file"
        )
    return spec.policy
