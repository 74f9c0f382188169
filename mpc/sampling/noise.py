"""Coloured noise in tables, so that a planner's random numbers are independent of other code and cost no time."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["NoiseBank", "coloured"]


def coloured(generator: np.random.Generator, shape: tuple[int, ...], exponent: float) -> Any:
    """Normal noise with spectrum 1/f^exponent along the last axis but one, of unit variance.

    Exponent 0 is white noise. Source: Timmer and Koenig 1995; used for planning by Pinneri et al. 2020 (iCEM).
    """
    length = shape[-2]
    if exponent == 0 or length < 2:
        return generator.standard_normal(shape)
    frequency = np.fft.rfftfreq(length)
    frequency[0] = 1.0 / length
    scale = frequency ** (-exponent / 2)
    real, imaginary = generator.standard_normal((2, *shape[:-2], len(scale), shape[-1]))
    imaginary[..., 0, :] = 0
    real[..., 0, :] *= np.sqrt(2)
    if length % 2 == 0:
        imaginary[..., -1, :] = 0
        real[..., -1, :] *= np.sqrt(2)
    series = np.fft.irfft((real + 1j * imaginary) * scale[:, None], n=length, axis=-2)
    # Real components (the lowest, and the highest of an even length) count once, the others with their conjugates.
    power = 4 * scale**2
    power[0] /= 2
    power[-1] /= 2 - length % 2
    return series * (length / np.sqrt(power.sum()))


class NoiseBank:
    """Fixed tables of noise; a search selects them by the number of earlier searches in its episode.

    Parameters
    ----------
    shape : shape of one table.
    tables : number of tables; they repeat after the last.
    exponent : exponent of the spectrum.
    seed : seed of the generator.
    """

    def __init__(self, shape: tuple[int, ...], tables: int, exponent: float, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self._bank = coloured(generator, (tables, *shape), exponent).astype(np.float32)

    def take(self, index: Any) -> Any:
        """Tables by index (E,), modulo their number: (E, *shape)."""
        return self._bank[np.asarray(index) % len(self._bank)]
