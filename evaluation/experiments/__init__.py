"""Experiments in Python: `Experiment`, `evaluate`, `compare` and their `Result`."""

from __future__ import annotations

from evaluation.experiments.experiment import Experiment, compare, evaluate
from evaluation.experiments.result import Result, merge

__all__ = ["Experiment", "Result", "compare", "evaluate", "merge"]
