"""Objects in a model's file, read one by one; an object that cannot be unpickled here is reported by its name."""

from __future__ import annotations

import base64
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle

from shield.errors import PolicyError

__all__ = ["SavedObjects", "misfits", "read_data", "read_objects"]

_SERIALIZED = ":serialized:"


class SavedObjects(NamedTuple):
    """The pickled objects of a file by name: those that were read, and the exceptions of the others."""

    read: dict[str, Any]
    unreadable: dict[str, Exception]


def read_data(path: Path) -> Mapping[str, Any]:
    """The settings of a saved model in its file, with pickled objects still encoded.

    Raises
    ------
    PolicyError
        If the file is no saved model.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
    except (OSError, zipfile.BadZipFile, KeyError, ValueError) as error:
        raise PolicyError(
            f"{path} is not a model saved by Stable-Baselines3: it holds no readable 'data' ({error})"
        ) from None
    return data if isinstance(data, dict) else {}


def read_objects(data: Mapping[str, Any], given: Mapping[str, Any]) -> SavedObjects:
    """Unpickle the objects of a file, except those that are given. Unpickling can run code.

    Parameters
    ----------
    data : result of `read_data`.
    given : objects by name that replace those in the file.
    """
    read, unreadable = dict(given), dict[str, Exception]()
    for name, item in data.items():
        if name in given or not isinstance(item, dict) or _SERIALIZED not in item:
            continue
        try:
            read[name] = cloudpickle.loads(base64.b64decode(item[_SERIALIZED]))
        except Exception as error:
            unreadable[name] = error
    # The pickle may load but hold another type than was saved.
    if "policy_kwargs" in read and not isinstance(read["policy_kwargs"], dict):
        kind = type(read.pop("policy_kwargs")).__name__
        unreadable["policy_kwargs"] = TypeError(f"it holds a {kind} instead of a dict")
    return SavedObjects(read, unreadable)


def misfits(saved: Any, space: Any) -> list[str]:
    """Differences of a space from the plain-text description of a space that cannot be unpickled.

    Parameters
    ----------
    saved : the entry of the file.
    space : the environment's space.
    """
    if not isinstance(saved, dict):
        return []
    shape, count = saved.get("_shape"), saved.get("n")
    different = []
    if isinstance(shape, list) and tuple(shape) != space.shape:
        different.append(f"its shape is {tuple(shape)}, the environment's {space.shape}")
    if count is not None and str(count) != str(getattr(space, "n", None)):
        different.append(f"it is Discrete({count}), the environment's {space}")
    return different
