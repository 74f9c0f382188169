"""Transitions as a Minari data set, and back. Minari is an extra: pip install -e ".[minari]".

An episode of a data set has one observation more than actions: the states, and the last next state. The duration of a
decision and the origin are stored in the description, as JSON; data sets from other sources have none. Data sets are in
Minari's local store: $MINARI_DATASETS_PATH, or its folder in the home directory.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from dynamics.errors import ConfigError, DataError
from dynamics.learned.data.transitions import Transitions
from dynamics.state import FloatArray

__all__ = ["FORMAT", "from_minari", "to_minari"]

FORMAT = "transitions-minari/1"
"""Value of "format" in the description of a data set made by `to_minari`."""

_NAME = re.compile(r"^([\w-]+/)*[\w-]+-v\d+$")


def to_minari(data: Transitions, name: str) -> None:
    """Write transitions as a data set in Minari's local store.

    Rewards are zero (they are no part of the dynamics) and every episode ends truncated, because terminations are not
    recorded.

    Parameters
    ----------
    name : the data set's id, such as "highway/random-v0".

    Raises
    ------
    ConfigError
        If Minari is not installed, the name is invalid, or a data set of that name exists.
    """
    minari = _minari()
    if not _NAME.match(name):
        raise ConfigError(f"a data set's id is [NAMESPACE/]NAME-vNUMBER, such as highway/random-v0; got {name!r}")
    if name in minari.list_local_datasets():
        raise ConfigError(f"there is a data set {name!r} already; take another version, or `minari delete` it")
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    buffers = []
    for number, episode in enumerate(np.unique(data.episodes)):
        rows = data.episodes == episode
        states = np.concatenate([data.states[rows], data.next_states[rows][-1:]])
        n = int(rows.sum())
        ends = [False] * (n - 1) + [True]
        buffers.append(
            EpisodeBuffer(
                id=number,
                observations=states,
                actions=data.actions[rows],
                rewards=[0.0] * n,
                terminations=[False] * n,
                truncations=ends,
            )
        )
    d, m = data.widths
    minari.create_dataset_from_buffers(
        dataset_id=name,
        buffer=buffers,
        observation_space=spaces.Box(-np.inf, np.inf, (d,), np.float64),
        action_space=spaces.Box(-1.0, 1.0, (m,), np.float64),
        description=json.dumps({"format": FORMAT, "dt": data.dt, "origin": dict(data.origin)}),
        data_format="arrow",
    )


def from_minari(
    name: str, dt: float | None = None, state: Callable[[Any], FloatArray] | None = None, download: bool = False
) -> Transitions:
    """Read a data set from Minari's local store.

    The last transition of an episode that terminated is left out, as in `dynamics.learned.data.collect.collect`.

    Parameters
    ----------
    name : the data set's id.
    dt : duration of a decision [s]. It is needed for data sets that `to_minari` did not write; for others it has to
        equal the stored value.
    state : reads the states (n + 1, d) of an episode from its observations. Without it, the observations are the states
        and have to be arrays.
    download : whether to download a missing data set from Minari's server.

    Raises
    ------
    ConfigError
        If Minari is not installed, or dt is missing or differs.
    DataError
        If there is no such data set, or it yields no transitions.
    """
    minari = _minari()
    try:
        dataset = minari.load_dataset(name, download=download)
    except Exception as error:
        have = ", ".join(minari.list_local_datasets()) or "none"
        raise DataError(
            f"there is no readable data set {name!r} in Minari's local store; have {have} ({error})"
        ) from error
    described = _description(dataset)
    said = described.get("dt")
    step = said if dt is None else dt
    if step is None:
        raise ConfigError(f"{name} does not say how long a decision lasts; give dt [s]")
    if dt is not None and said is not None and abs(dt - said) > 1e-9:
        raise ConfigError(f"{name} has decisions of {said} s, not of {dt} s; leave dt out")
    space = dataset.spec.action_space
    encode = _encoder(space, name)
    parts: list[tuple[FloatArray, FloatArray, FloatArray, Any]] = []
    for number, episode in enumerate(dataset.iterate_episodes()):
        if state is None and isinstance(episode.observations, dict | tuple):
            raise DataError(f"{name} has observations of several parts; give state, which reads (n + 1, d) of them")
        states = np.asarray(episode.observations if state is None else state(episode.observations), dtype=float)
        actions = encode(episode.actions)
        if states.ndim != 2 or len(states) != len(actions) + 1:
            raise DataError(
                f"episode {number} of {name} has states {states.shape} for actions {actions.shape}; (n + 1, d) and "
                "(n, m) are needed"
            )
        keep = len(actions) - bool(np.asarray(episode.terminations)[-1])
        parts.append((states[:keep], actions[:keep], states[1 : keep + 1], np.full(keep, number)))
    if not parts:
        raise DataError(f"{name} has no episodes")
    origin = described.get("origin", {"minari": name})
    x, u, y, episodes = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Transitions(x, u, y, episodes, float(step), origin)


def _minari() -> Any:
    try:
        import minari
    except ImportError as error:
        raise ConfigError(
            'Minari is not installed: pip install "minari>=0.5.4,<0.6", or this project with its extra, '
            'pip install -e ".[minari]"'
        ) from error
    return minari


def _description(dataset: Any) -> dict[str, Any]:
    """The description that `to_minari` wrote; empty for other data sets."""
    try:
        values = json.loads(dataset.storage.metadata.get("description") or "")
    except (TypeError, ValueError):
        return {}
    return values if isinstance(values, dict) and values.get("format") == FORMAT else {}


def _encoder(space: Any, name: str) -> Callable[[Any], FloatArray]:
    """A function from actions (n, …) to rows (n, m) in [-1, 1]: actions of a bounded Box scaled by its bounds, discrete
    ones one-hot."""
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        identity = np.eye(int(space.n))
        return lambda actions: identity[np.asarray(actions, dtype=int) - int(space.start)]
    if isinstance(space, spaces.Box) and len(space.shape) == 1 and space.is_bounded():
        low, high = space.low.astype(float), space.high.astype(float)
        if np.all(low == -1) and np.all(high == 1):
            return lambda actions: np.asarray(actions, dtype=float)
        return lambda actions: np.clip(2 * (np.asarray(actions, dtype=float) - low) / (high - low) - 1, -1.0, 1.0)
    raise DataError(f"the actions of {name} must be Discrete or a bounded Box with one axis, not {space}")
