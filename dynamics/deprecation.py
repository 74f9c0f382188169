"""Former names of public functions, members and values: they work for one release and warn."""

from __future__ import annotations

import warnings

__all__ = ["warn_of_former_name"]


def warn_of_former_name(former: str, present: str, stacklevel: int = 3) -> None:
    """Warn that a name is deprecated, and give the present name.

    Parameters
    ----------
    former, present : as users write them. stacklevel : frames between this function and the user's line.
    """
    warnings.warn(f"{former} is deprecated: write {present}", DeprecationWarning, stacklevel=stacklevel)
