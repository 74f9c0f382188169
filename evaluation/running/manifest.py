"""The manifest of a run: the origin of its rows, and the check whether another run may add to them."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from dynamics.errors import ConfigError
from dynamics.traffic.assumptions import FORMER_ASSUMPTIONS
from evaluation.running.identity import differences, versions
from shield.config import FORMER_SETTINGS

__all__ = ["SECTIONS", "check_fits", "commit", "extended", "provenance", "with_present_settings"]

SECTIONS = {"settings": "setting", "policies": "policy", "shields": "shield"}
"""Sections with named entries. A continued run may have other entries; entries of the same name have to be equal."""
_FREE = ("episodes", *SECTIONS)
"""Sections that a continued run may extend."""
_SHOWN = 6
"""Largest number of differences that are listed."""


def provenance(
    specification: Mapping[str, Any], earlier: Iterable[str] = (), models: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Make the manifest of a run.

    Parameters
    ----------
    specification : values that determine the rows, as plain values.
    earlier : command lines of the runs that this one continues.
    models : hash of each model file, by name (see `evaluation.running.identity.file_hash`).

    Returns
    -------
    The parameters, the command line, the date, versions of the libraries, the commit of the library's source, and the
    machine.
    """
    return {
        "asked": dict(specification),
        "command": " ".join(["shield", *sys.argv[1:]]),
        "earlier": list(earlier),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": sys.version.split()[0],
        "versions": versions(),
        "commit": commit(),
        "models": dict(models or {}),
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }


@lru_cache(maxsize=1)
def commit() -> str:
    """Commit of the library's source, with "+" if files have changed since; "" without git."""
    folder = Path(__file__).parent
    answers = []
    for command in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no")):
        try:
            done = subprocess.run(["git", *command], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
        except (OSError, subprocess.SubprocessError):
            return ""
        answers.append(done.stdout.strip())
    return answers[0] + ("+" if answers[1] else "")


def check_fits(name: str, before: Mapping[str, Any], now: Mapping[str, Any], instead: str) -> None:
    """Check that rows of a run may be added to those of another.

    Parameters
    ----------
    name : name of the store of the rows.
    before : manifest of the rows.
    now : manifest of the run.
    instead : advice for the message, if the manifests differ.

    Raises
    ------
    ConfigError
        With the differences, in the specification, in entries of the same name, or in the versions.
    """
    was = before.get("asked")
    if was is None:
        raise ConfigError(f"{name} does not say how it was made, and nothing can be added to it; {instead}")
    differ = _differences(was, now["asked"])
    differ += differences({"version of": before.get("versions", {})}, {"version of": now["versions"]})
    if differ:
        more = f" and {len(differ) - _SHOWN} more" if len(differ) > _SHOWN else ""
        raise ConfigError(
            f"{name} holds episodes of another comparison: {', '.join(differ[:_SHOWN])}{more} differ; {instead}"
        )


def extended(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """Manifest of a run that continues another (see `check_fits`): the specifications of both together."""
    was, specification = before["asked"], now["asked"]
    whole = {
        **specification,
        **{key: {**was.get(key, {}), **specification[key]} for key in SECTIONS if key in specification},
    }
    if "episodes" in was and "episodes" in specification:
        whole["episodes"] = max(was["episodes"], specification["episodes"])
    commands = dict.fromkeys([*before.get("earlier", ()), before.get("command", "")])
    models = {**before.get("models", {}), **now["models"]}
    return {**now, "asked": whole, "earlier": list(commands), "models": models}


def with_present_settings(settings: Any) -> Any:
    """Settings of a shield from a manifest, which may be of an earlier version, with the present names."""
    if not isinstance(settings, Mapping):
        return settings
    named = {FORMER_SETTINGS.get(name, name): value for name, value in settings.items()}
    if isinstance(named.get("assumptions"), Mapping):
        named["assumptions"] = {FORMER_ASSUMPTIONS.get(name, name): x for name, x in named["assumptions"].items()}
    return named


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences of two specifications, in words; named entries are compared if both have them."""
    found = differences(*({key: value for key, value in each.items() if key not in _FREE} for each in (before, now)))
    for key, word in SECTIONS.items():
        one, two = before.get(key, {}), now.get(key, {})
        if not (isinstance(one, Mapping) and isinstance(two, Mapping)):
            found += differences({key: one}, {key: two})
            continue
        if key == "shields":
            one, two = ({name: with_present_settings(table) for name, table in each.items()} for each in (one, two))
        for name in sorted(one.keys() & two.keys()):
            found += [f"{word} {name}: {each}" for each in differences(one[name], two[name])]
    return found
