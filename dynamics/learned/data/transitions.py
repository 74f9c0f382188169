"""Recorded transitions: the training and test data of a dynamics model.

A transition is (state, action, next state) of one decision. Transitions of one episode are consecutive and in order, so
that several in a row are an open-loop trajectory.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import DataError
from dynamics.state import FloatArray

__all__ = ["FORMAT", "Transitions"]

FORMAT = "transitions/1"
"""Value of "format" in the manifest inside a file of transitions."""

_ARRAYS = ("states", "actions", "next_states", "episodes")


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """Transitions, ordered by episode and time.

    Attributes
    ----------
    states, next_states : shape (n, d), in the units of the model.
    actions : shape (n, m), normalised to [-1, 1] (one-hot for discrete actions).
    episodes : the episode of each transition, shape (n,), never decreasing.
    dt : duration of a decision [s].
    origin : source of the data; stored in the manifest of a saved file.

    Raises
    ------
    DataError
        If there are none, shapes do not fit, a number is not finite, or an episode has a gap.
    """

    states: FloatArray
    actions: FloatArray
    next_states: FloatArray
    episodes: NDArray[np.int64]
    dt: float
    origin: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            kind = np.int64 if name == "episodes" else np.float64
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=kind))
        n = len(self.states) if self.states.ndim else 0
        shapes = {name: getattr(self, name).shape for name in _ARRAYS}
        fits = (
            self.states.ndim == self.actions.ndim == 2
            and self.next_states.shape == self.states.shape
            and len(self.actions) == n
            and self.episodes.shape == (n,)
        )
        if not fits:
            raise DataError(
                f"states (n, d), actions (n, m), next_states (n, d) and episodes (n,) expected, got {shapes}"
            )
        if n == 0:
            raise DataError("there are no transitions; collect at least one")
        if not self.dt > 0:
            raise DataError(f"dt must be a positive duration [s], got {self.dt}")
        for name in _ARRAYS[:3]:
            bad = np.flatnonzero(~np.isfinite(getattr(self, name)).all(axis=1))
            if bad.size:
                raise DataError(f"{name} must be finite, but {bad.size} rows are not, the first of them row {bad[0]}")
        if (np.diff(self.episodes) < 0).any():
            raise DataError("episodes must be in order; sort the transitions by episode and time")
        broken = (np.diff(self.episodes) == 0) & (self.states[1:] != self.next_states[:-1]).any(axis=1)
        if broken.any():
            row = np.flatnonzero(broken)[0] + 1
            raise DataError(f"within an episode each state must be the next state before it; row {row} is not")

    def __len__(self) -> int:
        return len(self.states)

    def __add__(self, other: Transitions) -> Transitions:
        """Concatenate two sets of transitions, with different episodes.

        Raises
        ------
        DataError
            If their widths or durations differ.
        """
        if not isinstance(other, Transitions):
            return NotImplemented
        if (self.dt, self.widths) != (other.dt, other.widths):
            raise DataError(
                f"transitions of width {self.widths} every {self.dt} s cannot be joined with "
                f"those of width {other.widths} every {other.dt} s"
            )
        later = other.episodes - other.episodes[0] + self.episodes[-1] + 1
        states, actions, after = (np.concatenate([getattr(self, k), getattr(other, k)]) for k in _ARRAYS[:3])
        parts = [*_parts(self.origin), *_parts(other.origin)]
        episodes = np.concatenate([self.episodes, later])
        return Transitions(states, actions, after, episodes, self.dt, {"parts": parts})

    @property
    def widths(self) -> tuple[int, int]:
        """Width of a state and of an action."""
        return self.states.shape[1], self.actions.shape[1]

    def take(self, rows: Any) -> Transitions:
        """A subset of the transitions: an index array or a mask that leaves no gap in an episode.

        Raises
        ------
        DataError
            If the subset is empty or has a gap.
        """
        states, actions, after, episodes = (getattr(self, name)[rows] for name in _ARRAYS)
        return Transitions(states, actions, after, episodes, self.dt, self.origin)

    def split(self, held_out: float = 0.2, seed: int = 0) -> tuple[Transitions, Transitions]:
        """Training and held-out part; each episode is in one of them as a whole.

        Parameters
        ----------
        held_out : share of the episodes in the held-out part; at least one episode is in each part.
        seed : of the random choice.

        Raises
        ------
        DataError
            If there is only one episode, or the share is not within (0, 1).
        """
        names = np.unique(self.episodes)
        if not 0 < held_out < 1:
            raise DataError(f"the held-out share must be between 0 and 1, got {held_out}")
        if names.size < 2:
            raise DataError("a split by episode needs two episodes or more, got 1; collect more, or shorter ones")
        count = min(max(round(held_out * names.size), 1), names.size - 1)
        out = np.isin(self.episodes, np.random.default_rng(seed).permutation(names)[:count])
        return self.take(~out), self.take(out)

    def windows(self, horizon: int) -> NDArray[np.int64]:
        """First rows of all runs of `horizon` transitions within an episode. Runs may overlap.

        Raises
        ------
        DataError
            If the horizon is less than 1.
        """
        if horizon < 1:
            raise DataError(f"a window must have 1 transition or more, got {horizon}")
        first = np.arange(max(len(self) - horizon + 1, 0))
        found: NDArray[np.int64] = first[self.episodes[first] == self.episodes[first + horizon - 1]]
        return found

    def sequences(self, horizon: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """All windows: start states (w, d), actions (w, horizon, m) and states after each action (w, horizon, d)."""
        first = self.windows(horizon)
        rows = first[:, None] + np.arange(horizon)
        return self.states[first], self.actions[rows], self.next_states[rows]

    def save(self, path: str | Path) -> Path:
        """Write an .npz file with the manifest (JSON) inside."""
        manifest = {"format": FORMAT, "dt": self.dt, "transitions": len(self), "origin": dict(self.origin)}
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                manifest=np.array(json.dumps(manifest)),
                **{k: getattr(self, k) for k in _ARRAYS},
            )
        return path

    @classmethod
    def load(cls, path: str | Path) -> Transitions:
        """Read a file that `save` wrote, without unpickling.

        Raises
        ------
        DataError
            If the file is missing, damaged, foreign, or its data invalid.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                manifest = json.loads(str(file["manifest"]))
                states, actions, after, episodes = (file[name] for name in _ARRAYS)
        except FileNotFoundError:
            raise DataError(f"there is no file {path}") from None
        except Exception as error:
            raise DataError(f"{path} is no readable file of transitions ({FORMAT}): {error}") from error
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            found = manifest.get("format") if isinstance(manifest, dict) else manifest
            raise DataError(f"{path} says format {found!r}; {FORMAT!r} can be read")
        try:
            data = cls(states, actions, after, episodes, float(manifest["dt"]), manifest.get("origin", {}))
        except (KeyError, TypeError) as error:
            raise DataError(f"the manifest of {path} is incomplete: {error}") from error
        if manifest.get("transitions") != len(data):
            raise DataError(f"{path} has {len(data)} transitions, its manifest says {manifest.get('transitions')}")
        return data


def _parts(origin: Mapping[str, Any]) -> list[Any]:
    return list(origin["parts"]) if set(origin) == {"parts"} else [dict(origin)]
