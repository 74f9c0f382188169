"""`python -m shield`: the installed console command `shield`."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, distribution

_DISTRIBUTION = "highway-shield"


def main() -> None:
    """Run the console command of the installed distribution: this package imports nothing from above it."""
    try:
        (command,) = distribution(_DISTRIBUTION).entry_points.select(group="console_scripts", name="shield")
    except PackageNotFoundError:
        sys.exit(f"the command `shield` is not installed: run `pip install .` in a clone of {_DISTRIBUTION}")
    command.load()()


if __name__ == "__main__":
    main()
