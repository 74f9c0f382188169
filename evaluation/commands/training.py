"""The command `shield train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evaluation.commands.asking import ask_hyperparameters
from evaluation.commands.reporting import check_writable
from evaluation.learning.recipes import RECIPES, get_recipe
from evaluation.names import FIRST_EVALUATION_SEED, SIMULATORS, TRAINABLE, check_name, check_sensor
from evaluation.settings import get_setting
from shield.config import PROFILES
from shield.errors import ConfigError

__all__ = ["add_training"]

_TRAINING_ENVS = 4
"""Environments side by side in training, unless another number is asked for."""

_out = Console()


def train_command(
    recipe: Annotated[str | None, typer.Option(help=f"Train a reference policy: {', '.join(RECIPES)}.")] = None,
    setting: Annotated[str | None, typer.Option(help="Environment setting to train in, without --recipe.")] = None,
    algorithm: Annotated[str, typer.Option(help=f"One of {', '.join(TRAINABLE)}.")] = "ppo",
    steps: Annotated[
        int | None, typer.Option(help="Training steps (decisions); by default the recipe's, or 10,000.")
    ] = None,
    seed: Annotated[int, typer.Option(help=f"Training seed, below {FIRST_EVALUATION_SEED}.")] = 0,
    output: Annotated[Path | None, typer.Option(help="The zip file to write; a manifest goes beside it.")] = None,
    simulator: Annotated[
        str,
        typer.Option(help=f"One of {', '.join(SIMULATORS)}; the compiled highway teaches the same, bit for bit."),
    ] = SIMULATORS[0],
    shield: Annotated[
        str,
        typer.Option(
            help=f"Train inside the shield: {', '.join(PROFILES)}; or none. Compiled on straight highways with"
            " meta-actions. A recipe says itself."
        ),
    ] = "none",
    sensor: Annotated[
        str, typer.Option(help="Through which sensor the policy sees, such as normalised-0.5+intent; as of evaluate.")
    ] = "exact",
    envs: Annotated[
        int | None, typer.Option(min=1, help="Environments side by side [4; a recipe has one].", show_default=False)
    ] = None,
    hyperparameters: Annotated[
        Path | None, typer.Option(help="TOML file of the algorithm's keyword arguments.", show_default=False)
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="One of them, such as n_steps=1024 or policy_kwargs.net_arch=[64,64] (repeatable)."),
    ] = None,
    tensorboard: Annotated[
        Path | None,
        typer.Option(help="Folder to log to for TensorBoard (the extra `tensorboard`).", show_default=False),
    ] = None,
) -> None:
    """Train a policy on one core and save it with a manifest that says how."""
    if (recipe is None) == (setting is None):
        raise ConfigError("give either --recipe or --setting")
    if recipe is not None and shield != "none":
        raise ConfigError("a recipe says itself whether it trains inside the shield; give --setting with --shield")
    if recipe is not None and (envs or hyperparameters or set_ or tensorboard):
        raise ConfigError("a recipe has its own hyperparameters; give --setting with --envs, --set and the like")
    parameters = ask_hyperparameters(hyperparameters, set_ or [])
    check_name("algorithm", algorithm.lower(), TRAINABLE)
    check_name("simulator", simulator, SIMULATORS)
    check_sensor(sensor)
    if recipe is not None:
        get_recipe(recipe)
    if setting is not None:
        get_setting(setting)
    if output is not None:
        check_writable(output)
    from evaluation.learning.training import train, train_recipe

    if recipe is not None:
        trained = train_recipe(recipe, output, steps=steps, simulator=simulator, sensor=sensor)
    else:
        assert setting is not None
        seen = "" if sensor == "exact" else f"-{sensor}"
        path = output or Path("runs", "policies", f"{algorithm}-{setting}{seen}.zip")
        decisions = 10_000 if steps is None else steps
        trained = train(
            setting,
            algorithm,
            decisions,
            seed,
            output=path,
            hyperparameters=parameters,
            simulator=simulator,
            shield=shield,
            sensor=sensor,
            envs=envs or _TRAINING_ENVS,
            tensorboard=tensorboard,
        )
    told = f"{trained.manifest['training_seconds']} s in {trained.manifest['simulator']}"
    _out.print(f"wrote {trained.path} ({told})")


def add_training(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("train")(train_command)
