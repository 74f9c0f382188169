"""Training environments: compiled where supported, inside a shield, with a sensor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import gymnasium as gym
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.road_networks.simulation.supported_traffic import on_network
from evaluation.learning.observations import FastObservations
from evaluation.settings import Setting
from evaluation.simulators import compiled_if_supported, with_compiled_frames
from evaluation.training.options import TrainingOptions
from evaluation.training.penalised_vec_env import PenalisedVecEnv
from evaluation.wrappers.channels import seen_through
from shield import ShieldConfig, ShieldedEnv
from shield.errors import ConfigError

__all__ = ["TrainingEnvs", "make_training_envs"]


class TrainingEnvs(NamedTuple):
    """Environments, and the name of their simulator, as in `SIMULATORS`."""

    env: gym.Env[Any, Any] | VecEnv
    driven_in: str


def make_training_envs(options: TrainingOptions, envs: int | None = None) -> TrainingEnvs:
    """Make the environments of a training.

    Parameters
    ----------
    options : options of the training.
    envs : number of environments; that of the options by default.

    Returns
    -------
    One environment in a `Monitor`, or a VecEnv; with an override penalty always a VecEnv.
    """
    made = _make(options, options.envs if envs is None else envs)
    if not options.override_penalty:
        return made
    one = made.env if isinstance(made.env, VecEnv) else DummyVecEnv([cast(Any, lambda: made.env)])
    return made._replace(env=PenalisedVecEnv(one, options.override_penalty))


def _make(options: TrainingOptions, envs: int) -> TrainingEnvs:
    setting, sensor = options.environment, options.sensor
    settings = None if options.shield == "none" else ShieldConfig.profile(options.shield)

    def made() -> gym.Env[Any, Any]:
        env = setting.make()
        return seen_through(FastObservations(env) if options.fast else env, sensor)

    def compiled() -> tuple[gym.Env[Any, Any] | VecEnv, bool]:
        if settings is not None:
            return _shielded(setting, settings, sensor, envs)
        return _compiled(setting, made, sensor, envs)

    world = compiled_if_supported(options.simulator, compiled)
    if world is not None:
        return TrainingEnvs(world, "compiled")
    return TrainingEnvs(
        _several(lambda: made() if settings is None else ShieldedEnv(made(), settings), envs), "highway-env"
    )


def _compiled(
    setting: Setting, made: Callable[[], gym.Env[Any, Any]], sensor: str, envs: int
) -> tuple[gym.Env[Any, Any] | VecEnv, bool]:
    """Compiled environments without a shield, and whether they are exact."""
    from evaluation.learning.fast_vec_env import FastHighwayVecEnv

    def alone() -> gym.Env[Any, Any]:
        return seen_through(CompiledHighwayEnv(setting.env_id, setting.configured), sensor)

    env = setting.make() if sensor != "exact" else made()
    if on_network(env.unwrapped):
        if sensor != "exact":
            raise ConfigError(f"the sensor {sensor!r} observes highway-env itself on this road")
        whole = _whole_episodes(setting, envs)
        if whole is not None:
            return whole
        frames = with_compiled_frames(env)
        return _several(lambda: with_compiled_frames(setting.make()), envs, frames), frames.exact
    if sensor != "exact":
        first = alone()
        return _several(alone, envs, first), cast(Any, first.unwrapped).simulator.exact
    world = FastHighwayVecEnv(envs, setting.env_id, setting.configured)
    return world, world.simulator.exact


def _several(
    make: Callable[[], gym.Env[Any, Any]], envs: int, first: gym.Env[Any, Any] | None = None
) -> gym.Env[Any, Any] | VecEnv:
    """One environment, or a batch of several, with `first` among them if it is given."""
    ready = [] if first is None else [first]

    def one() -> gym.Env[Any, Any]:
        return Monitor(ready.pop() if ready else make())

    return one() if envs == 1 else DummyVecEnv([one] * envs)


def _shielded(setting: Setting, settings: ShieldConfig, sensor: str, envs: int) -> tuple[VecEnv, bool]:
    """Compiled highways inside their shields, and whether they are exact."""
    from evaluation.learning.shielded_vec_env import ShieldedVecEnv

    if sensor != "exact":
        raise ConfigError(f"inside the shield the sensor {sensor!r} observes highway-env itself")
    world = ShieldedVecEnv(envs, setting.env_id, setting.configured, settings)
    return world, world.simulator.exact


def _whole_episodes(setting: Setting, envs: int) -> tuple[VecEnv, bool] | None:
    """Environments on a road network with compiled episodes, and whether they are exact; None if only frames can be
    compiled."""
    from evaluation.learning.fast_road_vec_env import FastRoadVecEnv

    try:
        world = FastRoadVecEnv(envs, setting.env_id, setting.configured)
    except ConfigError:
        return None
    return world, world.simulator.exact
