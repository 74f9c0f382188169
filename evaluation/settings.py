"""Named environment settings, so that one word identifies the conditions of a result.

A setting is an environment id and changes to highway-env's default configuration:

>>> setting = get_setting("abz-idm")
>>> setting.env_id, setting.config["simulation_frequency"]
('highway-fast-v0', 15)
>>> setting.with_traffic("aggressive", vehicles=30).config["vehicles_count"]
30

The `abz` family is the highway of the ABZ 2025 case study: three lanes, target speeds
0, 5, …, 40 m/s. `abz` and `abz-adversarial` are for training (5 Hz), `abz-idm` and
`abz-aggressive` for testing (15 Hz). The two tests and `abz` share one reward, so that returns
can be compared across them.

`racetrack`, both `parking` settings and all that end in `-continuous` have throttle and steering, or steering alone.
Parking has a goal, and its results contain the success rate.

Slow imports happen only when an environment is made, so wrong names are reported at once.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from dynamics.errors import ConfigError
from evaluation.named_settings import SETTINGS
from evaluation.names import check_name
from evaluation.setting import TRAFFIC, Setting

__all__ = ["SETTINGS", "TRAFFIC", "Setting", "get_setting", "setting_of"]


def setting_of(env_id: str, config: Path | None = None) -> Setting:
    """Any environment as a setting.

    Parameters
    ----------
    env_id : Gymnasium id; "module:id" imports a module first. An id that ends in a grid of actions, such as
        "highway-v0+5x9", has that grid (`Setting.with_action_grid`).
    config : a TOML file with changes to the registered configuration.

    Raises
    ------
    ConfigError
        If there is no such file, it is no TOML, or the grid has another form.
    """
    env_id, _, grid = env_id.partition("+")
    found = _setting_of(env_id, config)
    return found.with_action_grid(grid) if grid else found


def _setting_of(env_id: str, config: Path | None) -> Setting:
    if config is None:
        return Setting(env_id, env_id)
    try:
        keys = tomllib.loads(config.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"there is no environment configuration {config}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{config} is no TOML file: {error}") from None
    return Setting(f"{env_id}+{config.stem}", env_id, keys)


def get_setting(name: str) -> Setting:
    """The setting with that name; raises a `ConfigError` with the valid names if there is none.

    A name that ends in a grid of actions, such as "highway-fast+5x9", has that grid (`Setting.with_action_grid`).
    """
    name, _, grid = name.partition("+")
    check_name("setting", name, sorted(SETTINGS))
    return SETTINGS[name].with_action_grid(grid) if grid else SETTINGS[name]
