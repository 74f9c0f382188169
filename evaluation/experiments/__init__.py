"""Experiments in Python: `Experiment`, `evaluate`, `compare` and their `Result`."""

from __future__ import annotations

from evaluation.experiments.api import compare, evaluate
from evaluation.experiments.experiment import Experiment
from evaluation.experiments.result import Result, merge

__all__ = ["Experiment", "Result", "compare", "evaluate", "merge"]
