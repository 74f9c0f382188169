"""The command `warm`, which compiles all kernels in advance."""

from __future__ import annotations

from time import perf_counter

import typer
from rich.console import Console

__all__ = ["add_warming"]

_out = Console()


def warm_command() -> None:
    """Compile all kernels in advance: once after installation, and after an update of this library.

    Compiled kernels are read in seconds. Slow parts print their approximate duration and their progress.
    """
    from shield.wrappers.warm_parts import PARTS

    begun = perf_counter()
    for number, (name, compile_part) in enumerate(PARTS.items(), 1):
        start = perf_counter()
        _out.print(f"{number}/{len(PARTS)} {name} …", highlight=False)
        compile_part()
        _out.print(f"{number}/{len(PARTS)} {name}: ready after {perf_counter() - start:.0f} s", highlight=False)
    _out.print(f"all kernels are compiled ({perf_counter() - begun:.0f} s)", highlight=False)


def add_warming(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("warm")(warm_command)
