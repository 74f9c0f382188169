"""The command `shield train`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from evaluation.commands.options_command import options_of, with_options
from evaluation.commands.reporting import check_writable
from evaluation.commands.shared_options import read_hyperparameters
from evaluation.learning.recipes import RECIPES, get_recipe
from evaluation.names import FIRST_EVALUATION_SEED, NORMALISABLE, SIMULATORS, TRAINABLE
from evaluation.training.options import LEARN_FROM, ON_POLICY, TrainingOptions
from shield.config import PROFILES
from shield.errors import ConfigError

__all__ = ["add_training"]

_WITH_RECIPE = ("steps", "simulator", "sensor", "output")
"""Options that may be given with a recipe."""

_HELP: Mapping[str, str] = {
    "setting": "Environment setting to train in (see `shield settings`); NAME+5x9 for a grid of throttle and steering.",
    "env_id": "Any environment by its Gymnasium id instead, such as highway-v0 or module:id.",
    "env_config": "TOML file with changes to the configuration of --env-id.",
    "algorithm": f"One of {', '.join(TRAINABLE)}.",
    "steps": "Training steps (decisions).",
    "seed": f"Training seed, below {FIRST_EVALUATION_SEED}.",
    "output": "The zip file to write, with a manifest beside it.",
    "envs": "Number of environments in a batch; a recipe has one.",
    "hyperparameters": "TOML file of the algorithm's keyword arguments.",
    "normalise": f"{' or '.join(NORMALISABLE)}, by running statistics ({', '.join(ON_POLICY)}; repeatable).",
    "exploration": "Standard deviation of each continuous action at the start.",
    "fast": "Compute highway-env's observations faster, with equal values.",
    "simulator": f"One of {', '.join(SIMULATORS)}; training in the compiled highway is equal to the last bit.",
    "shield": f"Train inside the shield: {', '.join(PROFILES)}; or none. Compiled on straight highways with"
    " meta-actions.",
    "sensor": "Sensor of the policy, such as normalised-0.5+intent; as in evaluate.",
    "override_penalty": "Deduction for each overridden step, in units of the reward.",
    "masks": "PPO chooses among the actions that verify (MaskablePPO, the extra `contrib`).",
    "learn_from": f"Store transitions with the {' or '.join(LEARN_FROM)} action.",
    "tensorboard": "Folder to log to for TensorBoard (the extra `tensorboard`).",
    "checkpoint_every": "Steps between two checkpoints for --resume.",
    "resume": "Continue from the last checkpoint in OUTPUT-checkpoints, if there is one.",
    "evaluate_every": "Steps between two evaluations during training; the best model is kept.",
    "evaluation_episodes": "Episodes of each of these evaluations.",
    "videos": "Film one episode of each evaluation.",
}
"""Help text of each field of `TrainingOptions`."""

_out = Console()


def train_command(
    recipe: Annotated[str | None, typer.Option(help=f"Train a reference policy: {', '.join(RECIPES)}.")] = None,
    options: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of the options below, by name; options given here replace it.", show_default=False
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="A hyperparameter, such as n_steps=1024 or policy_kwargs.net_arch=[64,64] (repeatable)."
        ),
    ] = None,
    **given: Any,
) -> None:
    """Train a policy on one core, and save it with a manifest."""
    options_given = {key: value for key, value in given.items() if value is not None}
    if recipe is not None:
        _train_recipe(recipe, options_given, bool(set_ or options))
        return
    found = {**({} if options is None else TrainingOptions.read(options)), **options_given}
    if not (found.get("setting") or found.get("env_id")):
        raise ConfigError("give either --recipe or --setting, or --env-id")
    if options_given.get("setting") or options_given.get("env_id"):
        # Options given here replace the file's environment, by either name.
        found = {key: value for key, value in found.items() if key in options_given or key not in ("setting", "env_id")}
    base = dict(found.get("hyperparameters", {})) if "hyperparameters" not in options_given else {}
    file = options_given.get("hyperparameters")
    found["hyperparameters"] = read_hyperparameters(file, set_ or [], base)
    whole = TrainingOptions(**found)
    check_writable(whole.path)
    from evaluation.training.train import train_with

    _tell(train_with(whole))


def _train_recipe(recipe: str, options_given: dict[str, Any], more: bool) -> None:
    if "setting" in options_given or "env_id" in options_given:
        raise ConfigError("give either --recipe or --setting")
    own = [key for key in options_given if key not in _WITH_RECIPE]
    if own or more:
        named = ", ".join("--" + key.replace("_", "-") for key in own) or "--set and --options"
        raise ConfigError(f"a recipe has its own hyperparameters and options; give --setting with {named}")
    get_recipe(recipe)
    output = options_given.get("output")
    if output is not None:
        check_writable(output)
    from evaluation.training.train import train_recipe

    _tell(train_recipe(recipe, **options_given))


def _tell(trained: Any) -> None:
    manifest = trained.manifest
    resumed = f", resumed at {', '.join(map(str, manifest['resumed']))}" if manifest.get("resumed") else ""
    _out.print(f"wrote {trained.path} ({manifest['training_seconds']} s in {manifest['simulator']}{resumed})")


def add_training(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("train")(with_options(train_command, options_of(TrainingOptions, _HELP)))
