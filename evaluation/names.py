"""Names and numbers that the command line shows before anything that is slow to import is needed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dynamics.errors import ConfigError, perhaps

__all__ = [
    "ANY",
    "BASELINES",
    "CHANNEL_NAMES",
    "ENGINES",
    "FIRST_EVALUATION_SEED",
    "MODELS",
    "NORMALISABLE",
    "SENSOR_NAMES",
    "SIMULATORS",
    "TABLE_ENDINGS",
    "TRAFFIC",
    "TRAINABLE",
    "check_name",
    "check_penalty",
    "check_policy",
    "check_sensor",
    "list_references",
    "policy_label",
    "read_toml",
]

FIRST_EVALUATION_SEED = 10_000
"""Seeds below it are for training and choosing, from it on for evaluation."""
TRAINABLE = ("a2c", "dqn", "maskableppo", "ppo", "sac", "td3", "trpo")
"""The algorithms that `shield train` knows."""
NORMALISABLE = ("observations", "rewards")
"""What training can normalise by running means and variances."""
ENGINES = ("processes", "ray")
"""What episodes are spread by: processes of this machine, or tasks of a Ray cluster."""
SIMULATORS = ("auto", "compiled", "highway-env")
"""What episodes are driven in: highway-env's own code, its compiled copy, or that one where it serves."""
SENSOR_NAMES = (
    *("exact", "metric-0.5", "metric-2", "metric-2-late", "normalised-0.2", "normalised-0.5"),
    *("heavy-0.5", "biased-0.5", "worsening-0.5", "ghosts", "range-60"),
)
"""The sensors in `evaluation.wrappers.SENSORS`."""
_ANY_NOISE = re.compile(r"(metric|normalised)-\d+(\.\d+)?")
CHANNEL_NAMES = ("confidence", "tracked-confidence", "intent")
"""What can be added to what they show, `evaluation.wrappers.channels.CHANNELS`."""
TABLE_ENDINGS = (".csv", ".parquet")
"""File endings that `evaluation.report.table.write_table` knows."""
ANY = "any"
"""The policy that may propose anything: its actions are searched too. Drawn evenly, they are those of `random`."""
TRAFFIC = ("idm", "bold", "wild", "mixed")
"""Drivers of the other vehicles: highway-env's own, or drivers as reckless as the rules permit
(`evaluation.falsification.compliant_traffic`). On road networks: `evaluation.falsification.network_adversaries`."""
MODELS = ("bicycle", "learned")
"""What the predictive filter can plan with; a folder of models is the third."""
BASELINES = (
    "faster",
    "idle",
    "slower",
    "throttle",
    "random",
    "weaving",
    "left",
    "right",
    "lookahead",
    "lookahead-shielded",
    "mpc",
    "cem",
    "cem-fast",
    "cem-oracle",
    "cem-notebook",
    "cem-mppi",
    "cem-cautious",
)
"""Policies that need no training: `faster` and `slower` for meta-actions, `throttle` (full throttle, the wheel
straight) for continuous actions, `idle` and `random` for both; `left` and `right` change lanes
wherever they can, `weaving` to and fro; `lookahead` knows
the future (`mpc.lookahead_policy`, on the simulator's true state), and `lookahead-shielded` that behind the shield
(`shield.batch.lookahead`); `mpc` drives with continuous actions by itself
(`mpc.MPCPolicy`, on the simulator's true state); the others park (`evaluation.running.parking_planner`), and `cem`
drives on a highway and in a roundabout with meta-actions as well."""


def list_references() -> list[str]:
    """The names of the reference policies."""
    return sorted(path.stem for path in Path(__file__).with_name("policies").glob("*.zip"))


def check_name(what: str, name: str, valid: Iterable[str], more: str = "") -> None:
    """Raise where a name is none of the valid ones.

    Parameters
    ----------
    what : what it names, for the message. more : what else would be valid, in words.

    Raises
    ------
    ConfigError
        That lists them, and says which is the nearest.
    """
    names = list(valid)
    if name not in names:
        raise ConfigError(f"unknown {what} {name!r}{perhaps(name, names)}; have {', '.join(names)}{more}")


def check_penalty(penalty: float) -> float:
    """What an overridden step costs in training, where it is a number that can be taken from a reward.

    Raises
    ------
    ConfigError
        If it is negative or not finite.
    """
    if not 0.0 <= penalty < float("inf"):
        raise ConfigError(f"an override penalty is a finite number from 0 on, not {penalty!r}")
    return float(penalty)


def check_sensor(name: str) -> None:
    """Raise where no sensor has the name, or nothing that is added to what it shows.

    Parameters
    ----------
    name : of `SENSOR_NAMES`, or metric-S or normalised-S of any number S; and of `CHANNEL_NAMES`, with a + before each.

    Raises
    ------
    ConfigError
        That lists those that there are.
    """
    sensor, *channels = name.split("+")
    for each in channels:
        check_name("channel", each, CHANNEL_NAMES)
    if not _ANY_NOISE.fullmatch(sensor):
        check_name("sensor", sensor, SENSOR_NAMES, ", and metric-S and normalised-S of any number S")


def check_policy(name: str) -> None:
    """Raise where no policy has the name.

    Parameters
    ----------
    name : of `BASELINES`, of a reference policy, or the path of a zip file.

    Raises
    ------
    ConfigError
        That lists the names, or says that there is no such file.
    """
    known = [*BASELINES, *list_references()]
    if name in known:
        return
    if name.endswith(".zip"):
        if not Path(name).is_file():
            raise ConfigError(f"there is no policy file {name}")
        return
    file = Path(f"{name}.zip")
    meant = f"; perhaps {str(file)!r} is meant" if file.is_file() else perhaps(name, known)
    raise ConfigError(f"unknown policy {name!r}{meant}; have {', '.join(known)}, or the path of an SB3 .zip file")


def policy_label(name: str) -> str:
    """The name that results are reported under: of a zip file, its stem."""
    return Path(name).stem if name.endswith(".zip") else name


def read_toml(path: str | Path) -> dict[str, Any]:
    """The keys of a TOML file.

    Raises
    ------
    ConfigError
        If there is no such file, or it is no TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as TOML: {error}") from None
