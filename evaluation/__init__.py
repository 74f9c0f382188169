"""Evaluation: settings, training, episodes, statistics and the command line.

Modules are imported on use only, except Gymnasium, with which the environments of `evaluation.scenarios` are
registered.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

from evaluation.registration import register_environments

try:
    from dynamics import __version__ as __version__
    from dynamics.packages import refuse_hidden
except ImportError as error:
    import dynamics

    raise ImportError(
        f"{dynamics.__file__} hides the package 'dynamics' of highway-shield: rename or move that file"
    ) from error

refuse_hidden("dynamics", "mpc", "shield")
register_environments()

if TYPE_CHECKING:
    from evaluation.experiments.api import compare, evaluate
    from evaluation.experiments.experiment import Experiment
    from evaluation.experiments.result import Result, merge
    from evaluation.learning.algorithms import load_model
    from evaluation.learning.fast_road_vec_env import FastRoadVecEnv
    from evaluation.learning.fast_vec_env import FastHighwayVecEnv
    from evaluation.learning.shielded_vec_env import ShieldedVecEnv
    from evaluation.measuring.metrics import summarise
    from evaluation.policies import list_references, load_reference
    from evaluation.report.overlay import ShieldOverlay
    from evaluation.report.plots import plot_episodes
    from evaluation.report.table import read_episodes
    from evaluation.report.video import film_override
    from evaluation.reproduction.api import reproduce
    from evaluation.running.batch_episodes import Many
    from evaluation.running.episodes import RunOptions, run_episode, run_paired
    from evaluation.running.named_policies import make_policy
    from evaluation.running.records import make_variants
    from evaluation.settings import Setting, get_setting, setting_of
    from evaluation.training.train import train

__all__ = [
    "Experiment",
    "FastHighwayVecEnv",
    "FastRoadVecEnv",
    "Many",
    "Result",
    "RunOptions",
    "Setting",
    "ShieldOverlay",
    "ShieldedVecEnv",
    "compare",
    "evaluate",
    "film_override",
    "get_setting",
    "list_references",
    "load_model",
    "load_reference",
    "make_policy",
    "make_variants",
    "merge",
    "plot_episodes",
    "read_episodes",
    "reproduce",
    "run_episode",
    "run_paired",
    "setting_of",
    "summarise",
    "train",
]

__getattr__, _, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "experiments.api": ["compare", "evaluate"],
        "experiments.experiment": ["Experiment"],
        "experiments.result": ["Result", "merge"],
        "learning.algorithms": ["load_model"],
        "learning.fast_road_vec_env": ["FastRoadVecEnv"],
        "learning.fast_vec_env": ["FastHighwayVecEnv"],
        "learning.shielded_vec_env": ["ShieldedVecEnv"],
        "measuring.metrics": ["summarise"],
        "policies": ["list_references", "load_reference"],
        "report.overlay": ["ShieldOverlay"],
        "report.plots": ["plot_episodes"],
        "report.table": ["read_episodes"],
        "report.video": ["film_override"],
        "reproduction.api": ["reproduce"],
        "running.episodes": ["RunOptions", "run_episode", "run_paired"],
        "running.batch_episodes": ["Many"],
        "running.named_policies": ["make_policy"],
        "running.records": ["make_variants"],
        "training.train": ["train"],
        "settings": ["Setting", "get_setting", "setting_of"],
    },
)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
