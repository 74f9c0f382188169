"""Compiles the large kernels before the tests, each in one process: workers of pytest would all compile the same ones.

python tests/support/warm_kernels.py
"""

from __future__ import annotations

from joblib import Parallel, delayed

from shield.wrappers.warm_parts import PARTS


def compile_part(part: str) -> None:
    """Compile one part, or read it from the disk."""
    PARTS[part]()


if __name__ == "__main__":
    Parallel(n_jobs=-1)(delayed(compile_part)(part) for part in PARTS)
