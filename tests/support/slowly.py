"""Parameters of a test that only the slow suite goes through."""

from __future__ import annotations

from typing import Any

import pytest

__all__ = ["later"]


def later(*values: Any) -> list[Any]:
    """The same values, or tuples of values, for `make test-slow`."""
    return [pytest.param(*(v if isinstance(v, tuple) else (v,)), marks=pytest.mark.slow) for v in values]
