"""The import packages of this project, and files of the user that hide one of them by the same name."""

from __future__ import annotations

import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

__all__ = ["hiding_file", "refuse_hidden", "warn_of_hidden"]

_ROOT = Path(__file__).parents[1]


def refuse_hidden(*names: str) -> None:
    """Check that the packages of these names are those of this project.

    Raises
    ------
    ImportError
        If Python finds another file first, such as `mpc.py` beside the user's script.
    """
    for name in names:
        if other := hiding_file(name):
            raise ImportError(
                f"{other} hides the package {name!r} of highway-shield, which is imported by this name: "
                "rename or move that file",
                name=name,
                path=str(other),
            )


def warn_of_hidden(*names: str) -> None:
    """Warn (`UserWarning`) where `refuse_hidden` would raise: for packages that the importing one does not need."""
    for name in names:
        if other := hiding_file(name):
            warnings.warn(
                f"{other} hides the package {name!r} of highway-shield: `import {name}` finds that file. To use the "
                "package, rename or move the file",
                stacklevel=3,
            )


def hiding_file(name: str) -> Path | None:
    """The file that `import name` finds instead of this project's package; None where it finds the package."""
    own = _ROOT / name / "__init__.py"
    loaded = sys.modules.get(name)
    if loaded is not None:
        found = getattr(loaded, "__file__", None)
    else:
        spec = find_spec(name)
        found = None if spec is None else spec.origin
    if found is None or not own.is_file() or not Path(found).is_file():
        return None
    return None if Path(found).samefile(own) else Path(found)
