"""Throttle and steering frame by frame: the common part of the filters for inputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.state import FloatArray
from dynamics.vehicle.actuators import Actuators
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.environments import check_configuration, frames_of
from shield.filters.speed_recovery import SpeedRecovery

__all__ = ["InputFrames"]


class InputFrames(ABC):
    """Filters the action of a decision at its first frame, and highway-env's repeated low-level action at the others.

    Parameters
    ----------
    base : the highway-env environment, unwrapped.
    config : settings.

    Attributes
    ----------
    actuators : the policy's actuators.
    cause : why the scene of the last frame could not be read; "" if it could.
    """

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        self.config, self._base = config, base
        self._off = config.mode == "none"
        self.cause = ""
        self._begin()

    def _begin(self) -> None:
        """Begin an episode.

        Raises
        ------
        ConfigError
            If the environment's present configuration is not supported.
        """
        base = self._base
        check_configuration(base, self.config)
        self.actuators = Actuators.of(base.action_type)
        self._period = frames_of(base)
        self._speed_recovery = SpeedRecovery(self.actuators)
        self._untouched = True
        self._proposal: FloatArray | None = None
        self._first: tuple[FloatArray, Decision] | None = None

    @abstractmethod
    def _filter(self, begins: bool) -> tuple[FloatArray, Decision]:
        """Inputs of the coming frame in place of `_proposal`, (2,), and the record.

        Parameters
        ----------
        begins : whether the frame is the first of a decision.
        """

    def _physical(self, action: Any, read: FloatArray) -> FloatArray:
        """Acceleration [m/s^2] and wheel angle [rad] of an action, (2,); `read` has the action's normalised values."""
        return self.actuators.physical(read)

    def decide(self, action: Any, order: Any = None) -> Decision:
        """Filter an action for its first frame; `executed` is the action itself if it verifies.

        Otherwise `executed` is the action nearest to the inputs, which may brake harder than the policy's actions can.
        `order` is not used: inputs have no order of preference.
        """
        self._untouched = True
        if self._off:
            return Decision(action, action, Reason.NONE, Tier.OFF, np.nan, 0.0)
        read = self.actuators.read(action)
        self._proposal = None if read is None else self._physical(action, read)
        inputs, decision = self._filter(True)
        self._first = inputs, replace(decision, latency=0.0)
        executed = self.actuators.normalised(inputs)
        if decision.tier is Tier.PASSED:
            # The index may have come in an array or a list, which the environment does not accept.
            executed = action if self.actuators.choices is None else int(np.asarray(action).item())
        return replace(decision, proposed=action, executed=executed, refusal=(decision, 0))

    def frame(self) -> tuple[dict[str, float] | None, Decision]:
        """Low-level action of the next frame, None to keep the environment's own; and the record.

        highway-env repeats its last low-level action. So after an overridden frame, all later frames get their
        low-level action from here, including verified proposals. Until then the proposal is the low-level action that
        highway-env has computed. (It repeats an acceleration that it has limited above `MAX_SPEED`.)
        """
        first, self._first = self._first, None
        if first is None and self._untouched:
            low = self._base.vehicle.action
            self._proposal = np.array([float(low["acceleration"]), float(low["steering"])])
        inputs, decision = first if first is not None else self._filter(False)
        self._untouched = self._untouched and decision.tier is Tier.PASSED
        if self._untouched:
            return None, decision
        return {"acceleration": float(inputs[0]), "steering": float(inputs[1])}, decision
