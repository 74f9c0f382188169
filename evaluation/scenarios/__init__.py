"""Additional environments: `ComplexRoads-v0` and `lane-keeping-half-minute-v0`, which `evaluation` registers."""

from __future__ import annotations

from evaluation.scenarios.complex_roads import ComplexRoadsEnv

__all__ = ["ComplexRoadsEnv"]
