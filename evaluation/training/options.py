"""`TrainingOptions`: all options of `shield train`. One field is one option of the command and one TOML key."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from evaluation.names import (
    FIRST_EVALUATION_SEED,
    NORMALISABLE,
    SIMULATORS,
    TRAINABLE,
    check_name,
    check_penalty,
    check_sensor,
    read_toml,
)
from evaluation.settings import Setting, get_setting, setting_of
from shield.config import PROFILES
from shield.errors import ConfigError

__all__ = ["LEARN_FROM", "ON_POLICY", "TrainingOptions"]

ON_POLICY = ("a2c", "ppo", "maskableppo")
"""Algorithms with normalisation of observations and rewards."""
LEARN_FROM = ("proposed", "executed")
"""Action that a transition is stored with, if the shield replaced the proposal."""


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """Options of the training of one policy.

    Attributes
    ----------
    setting : the environment, by name or as a `Setting`.
    env_id : any environment by its Gymnasium id, instead of `setting`.
    env_config : a TOML file with changes to its configuration.
    algorithm : one of `TRAINABLE`.
    steps : number of decisions; PPO and A2C round up to whole rollouts.
    seed : training seed, 0 to 9,999.
    output : path of the zip file; the suffix is added if it is missing.
    envs : number of environments in a batch, with consecutive seeds from `seed` on.
    hyperparameters : keyword arguments of the algorithm; by default those of Stable-Baselines3, with "MlpPolicy".
    normalise : any of "observations" and "rewards", for PPO and A2C; the saved policy takes raw observations.
    exploration : initial standard deviation of each continuous action, for PPO and A2C.
    fast : whether to compute observations faster (`FastObservations`), with equal values.
    simulator : one of `SIMULATORS`; "auto" uses the compiled copy where supported, with the same result.
    shield : a profile of `ShieldConfig` to learn inside the shield, or "none".
    sensor : sensor of the policy.
    override_penalty : deduction from the reward of each overridden step.
    masks : whether PPO chooses among the actions that verify (MaskablePPO).
    learn_from : whether a transition is stored with the "proposed" or the "executed" action.
    tensorboard : folder of logs.
    checkpoint_every : steps between two checkpoints, in the folder `OUTPUT-checkpoints`; 0 for none.
    resume : whether to continue from the last checkpoint, if there is one.
    evaluate_every : steps between two evaluations during training; 0 for none.
    evaluation_episodes : episodes of each evaluation.
    videos : whether one of them is filmed.

    Raises
    ------
    ConfigError
        If a value is not valid, or two are inconsistent.

    Examples
    --------
    >>> TrainingOptions(setting="highway-fast", steps=20_000).differing()
    {'setting': 'highway-fast', 'steps': 20000}
    """

    setting: str | Setting | None = None
    env_id: str | None = None
    env_config: Path | None = None
    algorithm: str = "ppo"
    steps: int = 10_000
    seed: int = 0
    output: Path | None = None
    envs: int = 4
    hyperparameters: Mapping[str, Any] = field(default_factory=dict, hash=False)
    normalise: tuple[str, ...] = ()
    exploration: tuple[float, ...] = ()
    fast: bool = False
    simulator: str = SIMULATORS[0]
    shield: str = "none"
    sensor: str = "exact"
    override_penalty: float = 0.0
    masks: bool = False
    learn_from: str = LEARN_FROM[0]
    tensorboard: Path | None = None
    checkpoint_every: int = 0
    resume: bool = False
    evaluate_every: int = 0
    evaluation_episodes: int = 100
    videos: bool = False

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, _field_value(each, getattr(self, each.name)))
        _check_place(self)
        _check_numbers(self)
        _check_shield(self)

    @classmethod
    def names(cls) -> list[str]:
        """Names of the options."""
        return [each.name for each in fields(cls)]

    @classmethod
    def read(cls, path: str | Path) -> dict[str, Any]:
        """Read the options in a TOML file, by name.

        Raises
        ------
        ConfigError
            If there is no such file, it is no TOML, or it has an unknown key.
        """
        found = read_toml(path)
        for key in found:
            check_name("training option", key, cls.names())
        return found

    def differing(self) -> dict[str, Any]:
        """The options that differ from the defaults, as plain values."""
        return {
            each.name: value
            for each in fields(self)
            if (value := _plain(getattr(self, each.name))) != _plain(_default(each))
        }

    def plain(self) -> dict[str, Any]:
        """All options as plain values."""
        return {each.name: _plain(getattr(self, each.name)) for each in fields(self)}

    def over(self, **changes: Any) -> TrainingOptions:
        """A copy with other values."""
        return replace(self, **changes)

    @property
    def environment(self) -> Setting:
        """The environment to train in."""
        if isinstance(self.setting, Setting):
            return self.setting
        if self.setting is not None:
            return get_setting(self.setting)
        assert self.env_id is not None
        return setting_of(self.env_id, self.env_config)

    @property
    def learner(self) -> str:
        """Name of the algorithm; with masks MaskablePPO."""
        return "maskableppo" if self.masks else self.algorithm

    @property
    def path(self) -> Path:
        """Path of the zip file."""
        if self.output is None:
            seen = "" if self.sensor == "exact" else f"-{self.sensor}"
            name = self.environment.name.replace(":", "-").replace("/", "-")
            return Path("runs", "policies", f"{self.learner}-{name}{seen}.zip")
        return self.output if self.output.suffix == ".zip" else self.output.with_name(self.output.name + ".zip")


def _check_place(options: TrainingOptions) -> None:
    if (options.setting is None) == (options.env_id is None):
        raise ConfigError("give either a setting or an env_id to train in (--setting, --env-id)")
    if options.env_config is not None and options.env_id is None:
        raise ConfigError("env_config goes with env_id")
    check_name("algorithm", options.algorithm, TRAINABLE)
    check_name("simulator", options.simulator, SIMULATORS)
    check_sensor(options.sensor)
    if isinstance(options.setting, str):
        get_setting(options.setting)


def _check_numbers(options: TrainingOptions) -> None:
    if options.steps <= 0:
        raise ConfigError(f"steps must be positive, not {options.steps}")
    if not 0 <= options.seed < FIRST_EVALUATION_SEED:
        raise ConfigError(
            f"training seeds are 0 to {FIRST_EVALUATION_SEED - 1}, not {options.seed}: the others are kept for "
            "evaluation"
        )
    if options.envs < 1:
        raise ConfigError(f"envs must be 1 or more, not {options.envs}")
    normalise = set(options.normalise)
    if normalise and (options.algorithm not in ON_POLICY or not normalise <= set(NORMALISABLE)):
        raise ConfigError(
            f"{options.algorithm} cannot normalise {', '.join(options.normalise)}; {', '.join(ON_POLICY)} can normalise"
            f" {' and '.join(NORMALISABLE)}"
        )
    for name in ("checkpoint_every", "evaluate_every"):
        if getattr(options, name) < 0:
            raise ConfigError(f"{name} is a number of steps, or 0 for none, not {getattr(options, name)}")
    if not 1 <= options.evaluation_episodes <= FIRST_EVALUATION_SEED // 2:
        raise ConfigError(
            f"evaluation_episodes is 1 to {FIRST_EVALUATION_SEED // 2}, not {options.evaluation_episodes}"
        )
    if options.videos and not options.evaluate_every:
        raise ConfigError("videos are of evaluations: give evaluate_every with them")


def _check_shield(options: TrainingOptions) -> None:
    check_name("way to learn", options.learn_from, LEARN_FROM)
    penalty = check_penalty(options.override_penalty)
    if options.masks and options.algorithm not in ("ppo", "maskableppo"):
        raise ConfigError(f"masks are for ppo, not {options.algorithm}")
    if options.shield == "none":
        for requested, what in (
            (penalty, "override_penalty"),
            (options.learner == "maskableppo", "masks"),
            (options.learn_from == "executed", "learn_from='executed'"),
        ):
            if requested:
                raise ConfigError(f"{what} goes with a shield to train inside: have shield={', '.join(PROFILES)}")
    if options.learn_from == "executed" and options.learner == "maskableppo":
        raise ConfigError("with masks every proposal is one that verifies: learn from what is proposed")


def _field_value(one: Field[Any], value: Any) -> Any:
    """Convert a value from TOML or the command line, a text or a list, to the type of the field."""
    if one.name in ("output", "tensorboard", "env_config"):
        return None if value is None else Path(value)
    if one.name in ("normalise", "exploration"):
        listed = [value] if isinstance(value, str | float | int) else value
        return tuple(listed) if isinstance(listed, Collection) else value
    if one.name == "hyperparameters":
        return MappingProxyType(dict(value or {}))
    return value.lower() if one.name == "algorithm" and isinstance(value, str) else value


def _default(one: Field[Any]) -> Any:
    return one.default_factory() if one.default_factory is not MISSING else one.default


def _plain(value: Any) -> Any:
    """A value as a JSON value."""
    if isinstance(value, Setting):
        return {"name": value.name, "env_id": value.env_id, "config": dict(value.config)}
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
