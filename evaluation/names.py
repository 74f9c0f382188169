"""Names and numbers for the command line, in a module that imports quickly."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dynamics.errors import ConfigError, nearest_name_hint

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
"""First seed of evaluations; lower seeds are for training and selection."""
TRAINABLE = ("a2c", "dqn", "maskableppo", "ppo", "sac", "td3", "trpo")
"""Algorithms that `shield train` supports."""
NORMALISABLE = ("observations", "rewards")
"""Quantities that training can normalise by running means and variances."""
ENGINES = ("processes", "ray")
"""Engines that run episodes in parallel: processes of this machine, or tasks of a Ray cluster."""
SIMULATORS = ("auto", "compiled", "highway-env")
"""Simulators of episodes: highway-env's own code, its compiled copy, or the copy where supported (`auto`)."""
SENSOR_NAMES = (
    *("exact", "metric-0.5", "metric-2", "metric-2-late", "normalised-0.2", "normalised-0.5"),
    *("heavy-0.5", "biased-0.5", "worsening-0.5", "ghosts", "range-60"),
)
"""Names of the sensors in `evaluation.wrappers.SENSORS`."""
_ANY_NOISE = re.compile(r"(metric|normalised)-\d+(\.\d+)?")
CHANNEL_NAMES = ("confidence", "tracked-confidence", "intent")
"""Names of the channels in `evaluation.wrappers.channels.CHANNELS`, which add to a sensor's observations."""
TABLE_ENDINGS = (".csv", ".parquet")
"""File endings that `evaluation.report.table.write_table` supports."""
ANY = "any"
"""Name for a search over all actions in place of a policy. Uniformly drawn actions are those of `random`."""
TRAFFIC = ("idm", "bold", "wild", "mixed")
"""Drivers of the other vehicles: highway-env's own (`idm`), worst-case compliant ones (`bold`), unconstrained ones
(`wild`), or both kinds (`mixed`). See `evaluation.falsification.compliant_traffic` for straight highways, and
`evaluation.falsification.network_adversaries` for road networks."""
MODELS = ("bicycle", "learned")
"""Dynamics models of the predictive filter; a folder of models is also valid."""
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
"""Policies that need no training.

- `faster` and `slower` for meta-actions; `throttle` (full throttle, straight steering) for continuous actions; `idle`
  and `random` for both. `left` and `right` change lanes whenever possible, `weaving` to both sides.
- `lookahead` predicts the future from the simulator's true state (`mpc.lookahead_policy`); `lookahead-shielded` does so
  with the shield (`shield.batch.lookahead`).
- `mpc` drives with continuous actions, from the simulator's true state (`mpc.MPCPolicy`).
- The others are for parking (`evaluation.running.parking_planner`); `cem` also drives with meta-actions on a highway
and
  in a roundabout.
"""


def list_references() -> list[str]:
    """Names of the reference policies."""
    return sorted(path.stem for path in Path(__file__).with_name("policies").glob("*.zip"))


def check_name(what: str, name: str, valid: Iterable[str], more: str = "") -> None:
    """Check that a name is one of the valid ones.

    Parameters
    ----------
    what : kind of the name, for the message.
    name : the name.
    valid : the valid names.
    more : other valid values, in words.

    Raises
    ------
    ConfigError
        With the valid names, and the nearest one.
    """
    names = list(valid)
    if name not in names:
        raise ConfigError(f"unknown {what} {name!r}{nearest_name_hint(name, names)}; have {', '.join(names)}{more}")


def check_penalty(penalty: float) -> float:
    """Check an override penalty, and return it.

    Raises
    ------
    ConfigError
        If it is negative or not finite.
    """
    if not 0.0 <= penalty < float("inf"):
        raise ConfigError(f"an override penalty is a finite number from 0 on, not {penalty!r}")
    return float(penalty)


def check_sensor(name: str) -> None:
    """Check the name of a sensor with channels.

    Parameters
    ----------
    name : a name in `SENSOR_NAMES`, or metric-S or normalised-S with any number S, followed by names in
        `CHANNEL_NAMES` with a + before each.

    Raises
    ------
    ConfigError
        With the valid names.
    """
    sensor, *channels = name.split("+")
    for each in channels:
        check_name("channel", each, CHANNEL_NAMES)
    if not _ANY_NOISE.fullmatch(sensor):
        check_name("sensor", sensor, SENSOR_NAMES, ", and metric-S and normalised-S of any number S")


def check_policy(name: str) -> None:
    """Check the name of a policy.

    Parameters
    ----------
    name : a name in `BASELINES`, of a reference policy, or the path of a zip file.

    Raises
    ------
    ConfigError
        With the valid names, or if the file does not exist.
    """
    known = [*BASELINES, *list_references()]
    if name in known:
        return
    if name.endswith(".zip"):
        if not Path(name).is_file():
            raise ConfigError(f"there is no policy file {name}")
        return
    file = Path(f"{name}.zip")
    meant = f"; perhaps {str(file)!r} is meant" if file.is_file() else nearest_name_hint(name, known)
    raise ConfigError(f"unknown policy {name!r}{meant}; have {', '.join(known)}, or the path of an SB3 .zip file")


def policy_label(name: str) -> str:
    """Name of a policy in reports; for a zip file its stem."""
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
