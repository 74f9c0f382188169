"""Networks of a world model: encoder of frames, decoder to a grid, recurrent cell, and latents.

Sources: RSSM, categoricals with straight-through gradients and unimix: Hafner et al., DreamerV3 (2023). SimNorm:
Hansen et al., TD-MPC2 (2024). Orthogonal convolutions with zero biases: Saxe et al. (2014).
"""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn

__all__ = ["Decoder", "Encoder", "RecurrentCell", "mlp", "sample_categorical", "simnorm", "zero_bias_orthogonal"]

_DECODED_ROWS, _DECODED_COLUMNS = 4, 2
"""Rows and columns of a frame in a cell of the decoder's grid: 2 m by 4 m with the default view of 64 pixels."""
_EMPTY = -2.0
"""Initial logit of the decoder's cells."""


def zero_bias_orthogonal(module: nn.Module, gain: float = 2**0.5) -> None:
    """Initialise all convolutions and linear layers of a module: orthogonal weights, zero biases, in place."""
    for part in module.modules():
        if isinstance(part, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            nn.init.orthogonal_(part.weight, gain)
            if part.bias is not None:
                nn.init.zeros_(part.bias)


def mlp(width: int, hidden: int, outputs: int, zero: bool = False) -> nn.Sequential:
    """Network with one normalised hidden layer; `zero` makes the initial output 0."""
    net = nn.Sequential(nn.Linear(width, hidden), nn.LayerNorm(hidden), nn.SiLU(), nn.Linear(hidden, outputs))
    zero_bias_orthogonal(net, 1.0)
    if zero:
        nn.init.zeros_(cast(Tensor, net[-1].weight))
    return net


class Encoder(nn.Module):
    """Four convolutions: frames (n, channels, size, size) uint8 to embeddings (n, embedding)."""

    def __init__(self, channels: int, size: int, depth: int, embedding: int) -> None:
        super().__init__()
        wide = 3 * depth // 2
        self.first = nn.Conv2d(channels, depth, 4, 4)
        self.layers = nn.Sequential(
            nn.ReLU(),
            *(nn.Conv2d(depth, wide, 3, 2, 1), nn.ReLU()),
            *(nn.Conv2d(wide, 2 * depth, 3, 2, 1), nn.ReLU()),
            *(nn.Conv2d(2 * depth, 2 * depth, 3, 1, 1), nn.ReLU()),
            nn.Flatten(),
        )
        zero_bias_orthogonal(self.first)
        zero_bias_orthogonal(self.layers)
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.out = nn.Sequential(nn.Linear(2 * depth * (size // 16) ** 2, embedding), nn.LayerNorm(embedding))
        zero_bias_orthogonal(self.out, 1.0)

    def forward(self, frames: Tensor) -> Tensor:
        """Embeddings of frames."""
        # The weights are scaled in place of the frames, which are larger.
        weight = (self.first.weight * (1 / 255)).to(memory_format=torch.channels_last)
        pixels = frames.to(memory_format=torch.channels_last).float()
        found: Tensor = self.out(self.layers(nn.functional.conv2d(pixels, weight, self.first.bias, 4)))
        return found


class Decoder(nn.Module):
    """A linear layer: features (n, features) to a grid (n, channels, size / 4, size / 2), as logits.

    Its biases begin at few occupied cells.
    """

    def __init__(self, features: int, channels: int, size: int) -> None:
        super().__init__()
        self._grid = channels, size // _DECODED_ROWS, size // _DECODED_COLUMNS
        self.cells = nn.Linear(features, math.prod(self._grid))
        nn.init.orthogonal_(self.cells.weight)
        nn.init.constant_(self.cells.bias, _EMPTY)

    def forward(self, features: Tensor) -> Tensor:
        """Logits of the grid."""
        found: Tensor = self.cells(features).unflatten(-1, self._grid)
        return found

    @staticmethod
    def target(frames: Tensor) -> Tensor:
        """Frames (..., size, size) in the decoder's grid, (..., size / 4, size / 2): means over its cells, 0 to 1."""
        pixels = frames.float().unflatten(-1, (-1, _DECODED_COLUMNS)).unflatten(-3, (-1, _DECODED_ROWS))
        return cast(Tensor, pixels.sum((-1, -3))) * (1 / (255 * _DECODED_ROWS * _DECODED_COLUMNS))


class RecurrentCell(nn.Module):
    """Gated recurrent unit with layer normalisation, as in DreamerV3."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.inputs = nn.Sequential(nn.Linear(inputs, width), nn.LayerNorm(width), nn.SiLU())
        self.gates = nn.Sequential(nn.Linear(2 * width, 3 * width, bias=False), nn.LayerNorm(3 * width))
        zero_bias_orthogonal(self.inputs, 1.0)
        nn.init.orthogonal_(cast(Tensor, self.gates[0].weight))

    def forward(self, h: Tensor, inputs: Tensor) -> Tensor:
        """Next recurrent state, (n, width)."""
        reset, candidate, update = self.gates(torch.cat([self.inputs(inputs), h], -1)).chunk(3, -1)
        candidate = torch.tanh(torch.sigmoid(reset) * candidate)
        # The initial bias keeps most of the state.
        update = torch.sigmoid(update - 1)
        return update * candidate + (1 - update) * h


def simnorm(logits: Tensor) -> Tensor:
    """Softmax over the classes of each group, (..., groups, classes), scaled to a mean of 1.

    The scale gives the latent about the deviation of its logits: unscaled, the layers after it learn a tenth as fast.
    """
    return torch.softmax(logits, -1) * logits.shape[-1]


def sample_categorical(logits: Tensor, unimix: float) -> tuple[Tensor, Tensor]:
    """One-hot samples with straight-through gradients, and the log-probabilities, (..., groups, classes) each."""
    probabilities = (1 - unimix) * torch.softmax(logits, -1) + unimix / logits.shape[-1]
    classes = probabilities.shape[-1]
    drawn = torch.multinomial(probabilities.detach().reshape(-1, classes), 1).reshape(probabilities.shape[:-1])
    hot = nn.functional.one_hot(drawn, classes).to(probabilities.dtype)
    return hot + probabilities - probabilities.detach(), torch.log(probabilities)
