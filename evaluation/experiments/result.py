"""The episodes of an experiment, with their tables and pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from evaluation.measuring.metrics import compare, summarise
from evaluation.report.plots import plot_episodes
from evaluation.report.table import COMPARISON, SUMMARY, finished, latex, markdown, write_table
from evaluation.running.identity import differences
from evaluation.running.store_rows import KEY
from shield.errors import ConfigError

__all__ = ["Result", "merge"]

_FORMS = {"summary": SUMMARY, "comparison": COMPARISON}


@dataclass(frozen=True, eq=False)
class Result:
    """The episodes of an experiment.

    Attributes
    ----------
    episodes : one row for each episode, with the columns of `evaluation.running.records.EpisodeRecord`.
    made : manifest: specification, command, versions, commit and machine.
    """

    episodes: pd.DataFrame
    made: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def summary(self) -> pd.DataFrame:
        """One row for each setting, policy and shield (see `evaluation.measuring.metrics.summarise`)."""
        return summarise(self.episodes)

    @cached_property
    def comparison(self) -> pd.DataFrame:
        """Each shielded row against the unshielded one, paired by seed (see `evaluation.measuring.metrics.compare`).

        It is empty without unshielded episodes.
        """
        return compare(self.episodes)

    def table(self, of: str = "summary") -> pd.DataFrame:
        """The numbers of a table.

        Parameters
        ----------
        of : "summary" or "comparison".

        Raises
        ------
        ConfigError
            If `of` has another value.
        """
        if of not in _FORMS:
            raise ConfigError(f"unknown table {of!r}; valid are {', '.join(_FORMS)}")
        found: pd.DataFrame = getattr(self, of)
        return found

    def to_markdown(self, of: str = "summary") -> str:
        """A table in Markdown, with intervals; `of` as in `table`."""
        return markdown(self.table(of), _FORMS[of])

    def to_latex(self, of: str = "summary") -> str:
        """A table in LaTeX, for the package booktabs; `of` as in `table`."""
        return latex(self.table(of), _FORMS[of])

    def plot(self, path: str | Path) -> Path:
        """Draw crash rates, returns, overrides and gaps to a file (see `evaluation.report.plots.plot_episodes`)."""
        return plot_episodes(self.episodes, path)

    def write(self, path: str | Path) -> Path:
        """Write the episodes to a .parquet or .csv file, with their manifest; `Result.read` reads them back."""
        frame = self.episodes.copy()
        frame.attrs["made"] = dict(self.made)
        return write_table(frame, path)

    @classmethod
    def read(cls, path: str | Path) -> Result:
        """Read episodes that `write` or `shield evaluate --output` wrote.

        Raises
        ------
        ConfigError
            If there is no such file, or it is no table of episodes.
        """
        found = finished(path)
        if found is None:
            raise ConfigError(f"there is no file {path}")
        made, rows = found
        return cls(pd.DataFrame(rows), made)

    def __str__(self) -> str:
        """The tables in Markdown."""
        return "\n\n".join(self.to_markdown(of) for of in _FORMS if len(self.table(of)))

    def _repr_html_(self) -> str:
        return str(self.summary.to_html(index=False))


def merge(parts: Iterable[Result]) -> Result:
    """Merge the shards of an experiment (see `Experiment.shard`).

    Raises
    ------
    ConfigError
        If they are not all shards of one experiment, a shard is missing or duplicated, or an episode is missing.
    """
    parts = list(parts)
    if not parts:
        raise ConfigError("nothing to merge: no parts")
    shards = []
    for part in parts:
        specification = dict(part.made.get("asked", {}))
        shard = specification.pop("shard", None)
        if shard is None:
            raise ConfigError("a part does not say which shard of an experiment it is; it was made without a shard")
        shards.append((tuple(shard), specification, part))
    (_, count), first, _ = shards[0]
    for (_, other), specification, part in shards[1:]:
        differ = differences({"shards": count, **first}, {"shards": other, **specification})
        differ += differences({"version of": parts[0].made["versions"]}, {"version of": part.made["versions"]})
        if differ:
            raise ConfigError(f"these are parts of two experiments: {', '.join(differ[:6])}")
    numbers = sorted(number for (number, _), _, _ in shards)
    if numbers != list(range(1, count + 1)):
        raise ConfigError(f"an experiment of {count} shards has shards 1 to {count}; these are {numbers}")
    episodes = pd.concat([part.episodes for part in parts], ignore_index=True)
    if episodes.duplicated(list(KEY)).any():
        raise ConfigError("an episode is in two parts")
    groups = list(KEY)[:-1]
    seeds = range(first["seed"], first["seed"] + first["episodes"])
    for key, group in episodes.groupby(groups, sort=False):
        missing = sorted(set(seeds) - set(group["seed"]))
        if missing:
            names = ", ".join(map(str, key))
            raise ConfigError(f"{len(missing)} episodes of {names} are missing, the first has seed {missing[0]}")
    place = {key: i for i, key in enumerate(episodes.groupby(groups, sort=False).groups)}
    order = [(place[tuple(row[:-1])], row[-1]) for row in episodes[list(KEY)].itertuples(index=False, name=None)]
    episodes = episodes.iloc[sorted(range(len(order)), key=order.__getitem__)].reset_index(drop=True)
    return Result(episodes, {**parts[0].made, "asked": first})
