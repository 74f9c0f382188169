"""Options that several commands share: settings, environments of the user, policies.

Wrong names and files are reported before slow imports.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from evaluation.commands.names import DEMO_SETTING
from evaluation.names import check_name, check_policy, read_toml
from evaluation.settings import get_setting, setting_of
from shield.config import MODES, PERCEPTIONS
from shield.errors import ConfigError

if TYPE_CHECKING:
    from evaluation.settings import Setting

__all__ = [
    "EnvConfig",
    "EnvId",
    "NamedSetting",
    "check_jobs",
    "check_modes",
    "lengths",
    "read_hyperparameters",
    "read_policies",
    "read_setting",
    "read_settings",
    "shard_of",
    "split",
]

_err = Console(stderr=True, highlight=False)

NamedSetting = Annotated[
    str | None, typer.Option(help=f"Named environment (see `shield settings`) [{DEMO_SETTING}].", show_default=False)
]
EnvId = Annotated[
    str | None,
    typer.Option(
        help="Any environment by its Gymnasium id instead, such as highway-v0 or module:id; ID+5x9 for a grid of"
        " throttle and steering."
    ),
]
EnvConfig = Annotated[
    Path | None,
    typer.Option(help="TOML file with changes to the registered configuration of --env-id."),
]


def read_settings(names: Sequence[str] | None, env_id: str | None, config: Path | None) -> list[Setting]:
    """The settings of a comparison: by name, or an environment of the user. Unknown keys are printed as warnings.

    Raises
    ------
    ConfigError
        If there is no such setting, environment or file, or both are given.
    """
    if env_id is None:
        if config is not None:
            raise ConfigError("--env-config goes with --env-id")
        return [get_setting(name) for name in split(names or [DEMO_SETTING])]
    if names is not None:
        raise ConfigError("give either --setting or --env-id")
    setting = setting_of(env_id, config)
    _ = setting.configured  # raises an error if there is no such environment, before slow imports
    if config is not None:
        from evaluation.commands.unknown_keys import unknown_keys

        for message in unknown_keys(setting):
            _err.print(message, style="yellow", markup=False, soft_wrap=True)
    return [setting]


def read_setting(name: str | None, env_id: str | None, config: Path | None) -> Setting:
    """One setting, as in `read_settings`."""
    if name is not None and env_id is None and config is None:
        return get_setting(name)
    return read_settings(None if name is None else [name], env_id, config)[0]


def read_policies(names: Sequence[str]) -> list[str]:
    """Policies by name, or as paths of zip files.

    Raises
    ------
    ConfigError
        If there is no such policy or file.
    """
    policies = split(names)
    for name in policies:
        check_policy(name)
    return policies


def read_hyperparameters(
    file: Path | None, settings: Sequence[str], base: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Keyword arguments of an algorithm from a TOML file or `base`, updated by single ones such as "n_steps=1024".

    Raises
    ------
    ConfigError
        If there is no such file, or a text is no valid TOML.

    Examples
    --------
    >>> read_hyperparameters(None, ["n_steps=64", "policy_kwargs.net_arch=[8, 8]", "policy=MlpPolicy"])
    {'n_steps': 64, 'policy_kwargs': {'net_arch': [8, 8]}, 'policy': 'MlpPolicy'}
    """
    found = deepcopy(dict(base or {})) if file is None else read_toml(file)
    for text in settings:
        key, equals, value = text.partition("=")
        if not (key.strip() and equals and value.strip()):
            raise ConfigError(f"--set is KEY=VALUE, such as n_steps=1024, not {text!r}")
        try:
            plain = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            plain = value.strip()
        *above, last = key.strip().split(".")
        place = found
        for name in above:
            place = place.setdefault(name, {})
            if not isinstance(place, dict):
                raise ConfigError(f"--set {text!r}: {name} is a value, and has no keys")
        place[last] = plain
    return found


def check_jobs(jobs: int) -> None:
    """Check a number of processes.

    Raises
    ------
    ConfigError
        If it is 0.
    """
    if jobs == 0:
        raise ConfigError("--jobs must be at least 1, or -1 for one per core")


def check_modes(modes: Sequence[str], perceptions: Sequence[str] = ()) -> None:
    """Check names of shield modes and of perceptions.

    Raises
    ------
    ConfigError
        With the valid names.
    """
    for what, names, valid in (("shield mode", modes, MODES), ("perception", perceptions, PERCEPTIONS)):
        for name in names:
            check_name(what, name, valid)


def shard_of(text: str | None) -> tuple[int, int] | None:
    """The numbers of "i/n"; None for None.

    Raises
    ------
    ConfigError
        If the text has another form.

    Examples
    --------
    >>> shard_of("2/8")
    (2, 8)
    """
    if text is None:
        return None
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ConfigError(f"--shard must be i/n with 1 <= i <= n, such as 2/8, not {text!r}")
    return int(number), int(count)


def lengths(values: Sequence[str]) -> list[float]:
    """Repeated options and comma lists of lengths [m] as numbers.

    Raises
    ------
    ConfigError
        If a value is no number.

    Examples
    --------
    >>> lengths(["0.5,2", "4"])
    [0.5, 2.0, 4.0]
    """
    try:
        return [float(each) for each in split(values)]
    except ValueError:
        raise ConfigError(f"lengths are numbers such as 0.5,2,4, not {', '.join(values)}") from None


def split(values: Sequence[str]) -> list[str]:
    """Repeated options and comma lists as one list, each value once.

    Examples
    --------
    >>> split(["none,full", " rss ", "full"])
    ['none', 'full', 'rss']
    """
    names = [name.strip() for value in values for name in value.split(",") if name.strip()]
    return list(dict.fromkeys(names))
