"""Dynamics of vehicles, roads, scenes and traffic, and predictions of them, mostly as pure functions of arrays."""

from __future__ import annotations

__version__ = "0.1.0"
"""The version of the distribution highway-shield, of which this is the lowest package."""
