"""Former names of public functions, keywords, members and values: they work for one release and warn."""

from __future__ import annotations

import warnings

__all__ = ["warn_of_former_name"]


def warn_of_former_name(former: str, remedy: str, stacklevel: int = 3) -> None:
    """Warn that a name is deprecated, and say what to write.

    Parameters
    ----------
    former : as users write it.
    remedy : a clause such as "write Guarantee.ALL_SEEN".
    stacklevel : frames between this function and the user's line.
    """
    warnings.warn(f"{former} is deprecated: {remedy}", DeprecationWarning, stacklevel=stacklevel)
