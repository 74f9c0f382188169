"""Replay of an episode of a stored run, of `shield evaluate` or `shield certify`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import tomli_w

from evaluation.names import BASELINES, check_policy
from evaluation.policies import list_references
from evaluation.replay.collect import ReplayRequest, collect
from evaluation.replay.html import write_page
from evaluation.report.table import made_of, read_episodes
from evaluation.running.driver import policy_name
from evaluation.running.identity import differences, of_environment, policy_files, versions
from evaluation.running.manifest import with_present_settings
from evaluation.running.parts import Parts
from evaluation.running.records import EpisodeRecord, ShieldVariant, variant_for
from evaluation.running.store_rows import is_store
from evaluation.settings import SETTINGS, Setting
from shield.config import ShieldConfig
from shield.errors import ConfigError, ShieldError

__all__ = ["RecordedEpisode", "check_same", "episode_of", "run_file", "write_replay"]

_COMPARED = ("crashed", "off_road", "return", "steps", "overridden", "held_back", "frames", "frames_overridden")
"""Columns that have to be equal in a replay."""
_SHOWN = 4
_CERTIFIED = "asked.json"
"""File with the manifest of a run of `shield certify`, beside its table, in versions before the store."""


@dataclass(frozen=True, slots=True)
class RecordedEpisode:
    """An episode of a run: its specification, its row, and differences of the library versions, in words."""

    request: ReplayRequest
    row: Mapping[str, Any]
    changed: tuple[str, ...]


def run_file(run: str | Path) -> Path:
    """Path of the table of a run: the file itself, or episodes.parquet in its folder.

    Raises
    ------
    ConfigError
        If there is no such file.
    """
    path = Path(run)
    path = path / "episodes.parquet" if path.is_dir() else path
    if not path.is_file():
        raise ConfigError(
            f"there is no run {path}; have what `shield evaluate --output` or `shield certify` wrote, or a seed"
        )
    return path


def episode_of(run: str | Path, number: int, policy: str | None = None) -> RecordedEpisode:
    """Read an episode of a run of `shield evaluate` or `shield certify`.

    Parameters
    ----------
    run : see `run_file`.
    number : index of its row.
    policy : file of the policy, if the row's policy is a model of the user.

    Raises
    ------
    ConfigError
        If there is no such row, the episode has no shield, the run has no manifest, or its environment or policy has
        changed.
    """
    path = run_file(run)
    table = read_episodes(path)
    made, rows = made_of(table, path), table.to_dict("records")
    if path.name == "episodes.parquet" and is_store(path.parent):
        made = Parts(path.parent).manifest or {}
    elif (certified := path.with_name(_CERTIFIED)).is_file() and path.name == "episodes.parquet":
        made = _as_compared(json.loads(certified.read_text(encoding="utf-8")), rows)
    if not 0 <= number < len(rows):
        raise ConfigError(f"{path.name} has the episodes 0 to {len(rows) - 1}, not {number}")
    row, specification = rows[number], made.get("asked")
    if row.get("placement") == "none":
        raise ConfigError(f"episode {number} of {path.name} was driven without a shield; {_shielded(rows)}")
    if not isinstance(specification, Mapping) or "shields" not in specification:
        raise ConfigError(f"{path.name} does not say how it was made; replay the seed {row['seed']} instead")
    name, _, sensor = row["setting"].partition(", ")
    setting = _setting(name, specification["settings"])
    if "placement" in row:
        placement, _, perception = row["placement"].partition(", ")
        config = _config(specification["shields"][f"{name}, {row['placement']}, {row['mode']}"])
        variant = ShieldVariant(placement, config, perception or "simulator", row["mode"].partition(", ")[2])
    else:
        variant = variant_for(_config(specification["shields"]), setting)
    chosen = _policy(row["policy"], policy, specification["policies"])
    changed = differences({"version of": made.get("versions", {})}, {"version of": versions()})
    return RecordedEpisode(
        ReplayRequest(setting, chosen, variant, int(row["seed"]), sensor=sensor or "exact"),
        row,
        tuple(changed[:_SHOWN]),
    )


def check_same(recorded: RecordedEpisode, record: EpisodeRecord) -> list[str]:
    """Differences of an episode's row and its repetition, in words."""
    again = record.row()
    return differences(
        *({key: each[key] for key in _COMPARED if key in recorded.row} for each in (recorded.row, again))
    )


def write_replay(run: Path, number: int, policy: str, page: Path) -> str:
    """Drive an episode again and write its page.

    Parameters
    ----------
    run, number : as in `episode_of`.
    policy : file of the user's model that drives, or "".
    page : path of the .html file.

    Returns
    -------
    The reason why there is no page, or the differences from the recorded episode, in words; "" if they are equal.
    """
    try:
        recorded = episode_of(run, number, policy or None)
        replay, record = collect(recorded.request)
    except ShieldError as error:
        return f"no replay: {error}"
    write_page(replay, page)
    differ = check_same(recorded, record)
    return f"another episode than the run's: {', '.join(differ)}" if differ else ""


def _as_compared(made: Mapping[str, Any], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The manifest of an old run of `shield certify` in the format of `shield evaluate`: one setting, one policy."""
    was, row = made["asked"], rows[0]
    named = {"settings": {row["setting"]: was["setting"]}, "policies": {row["policy"]: was["policy"]}}
    return {"asked": {**named, "shields": was["shield"]}, "versions": was["version of"]}


def _config(shield: Mapping[str, Any]) -> ShieldConfig:
    return ShieldConfig.from_toml(tomli_w.dumps(with_present_settings(shield)))


def _shielded(rows: list[dict[str, Any]]) -> str:
    """Text about the rows that can be replayed."""
    numbers = [k for k, row in enumerate(rows) if row.get("placement") != "none"]
    return f"with one were {numbers[0]} to {numbers[-1]}" if numbers else "none has one"


def _setting(name: str, settings: Mapping[str, Any]) -> Setting:
    """The setting of that name; raises `ConfigError` if it has changed since the run."""
    was = settings[name]
    setting = SETTINGS[name] if name in SETTINGS else Setting(name, _importable(name, was), was["configuration"])
    try:
        now = of_environment(setting)
    except (gym.error.Error, ImportError) as error:
        raise ConfigError(
            f"the environment {name} of the run cannot be made: {error}; run this in the folder of the module that "
            "registers it"
        ) from None
    if differ := differences(was, json.loads(json.dumps(now))):
        raise ConfigError(f"the environment {name} is another than that of the run: {', '.join(differ[:_SHOWN])}")
    return setting


def _importable(name: str, was: Mapping[str, Any]) -> str:
    """The id of a recorded environment, as "module:id" if a module has to be imported to register it.

    The module is that of the setting's name if it has one, else that of the environment's class.
    """
    env_id: str = was["id"]
    module, colon, _ = name.partition(":")
    if colon:
        return f"{module}:{env_id}"
    return env_id if env_id in gym.registry else f"{was['class'].rpartition('.')[0]}:{env_id}"


def _policy(label: str, given: str | None, policies: Mapping[str, Any]) -> str:
    """The policy of a row: its name, or the given file; raises `ConfigError` if it is another policy."""
    if given is None:
        if label not in (*BASELINES, *list_references()):
            raise ConfigError(
                f"the episode was driven by {label}, which is a model: hand in its file, --policy FILE.zip"
            )
        given = label
    check_policy(given)
    if policy_name(given, None) != label:
        raise ConfigError(f"the episode was driven by {label}, not by {policy_name(given, None)}")
    was, now = ({"file": each.get("file")} for each in (policies.get(label, {}), policy_files(given)))
    if differ := differences(was, now):
        raise ConfigError(f"{given} is another file than the one that drove: {', '.join(differ)}")
    return given
