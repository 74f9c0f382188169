"""The filter for throttle and steering in simulated traffic, frame by frame."""

from __future__ import annotations

from copy import copy
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np

from dynamics.errors import ConfigError
from dynamics.highway_simulator.env import CompiledHighwayEnv
from dynamics.highway_simulator.layout import CONTINUOUS, KIND, TARGET, TARGET_SPEED
from dynamics.road_networks.geometry.layout import USES_CONTROLLERS
from dynamics.road_networks.simulation.simulator import NetworkSimulator
from dynamics.scenes.parking_lot import is_parking_lot
from dynamics.state import FloatArray
from shield.batch.codes import TIERS
from shield.certificate.simulated.input_verification import BackupSequence, advance_backup, decide_inputs, empty_tail
from shield.certificate.simulated.workspace import TrafficSearch
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.explaining.simulated import copy_of
from shield.filters.input_frames import InputFrames
from shield.filters.simulated.predicted_scene import (
    STATE,
    LoadedSearch,
    PredictedScene,
    PredictingFilter,
    check_traffic,
    scene_failure,
    simulate_network,
)
from shield.supported_environments import check

__all__ = ["SimulatedInputFilter"]

_HOLD = 1.0
"""Duration for which the lane-and-speed controllers keep a target command before the next one [s]."""


class SimulatedInputFilter(PredictingFilter, InputFrames):
    """Filters throttle and steering where the traffic consists of known classes and follows from its state.

    At every frame the proposal is simulated for that frame. After it the lane-and-speed controllers track a sequence of
    target commands, for `ShieldConfig.horizon`. They brake at most at `ShieldConfig.braking`.

    Parameters
    ----------
    base : highway-env's environment, unwrapped.
    config : settings with `Assumptions.simulated_traffic()`.

    Raises
    ------
    ConfigError
        If the simulator does not support the environment, or the settings are for another kind of verification.
    SceneError
        If it has unknown vehicles or lanes.
    """

    supervising = True

    def __init__(self, base: Any, config: ShieldConfig) -> None:
        check(config)
        if isinstance(base, CompiledHighwayEnv):
            raise ConfigError(
                "throttle and steering are verified by simulation in highway-env, not in its compiled copy"
            )
        if is_parking_lot(base):
            raise ConfigError(
                f"nothing is simulated in a parking lot, {type(base).__name__}: leave ShieldConfig.simulated_traffic() "
                "out; ShieldedEnv(env) and Shield(policy, env) filter ContinuousAction there"
            )
        super().__init__(base, config)
        self._scene = PredictedScene(base, config, self._simulate, self._verifies)
        self._inputs = np.zeros(2)
        self.reset()
        if base.road is not None:
            self._scene.read()

    def _simulate(self, base: Any, like: Any) -> NetworkSimulator:
        """Simulator with the limits of the lane-and-speed controllers."""
        control_limits = self.config.braking, self.actuators.acceleration[1], _HOLD
        return simulate_network(base, like, control_limits=control_limits)

    def reset(self) -> None:
        """Clear everything about the episode.

        Raises
        ------
        ConfigError
            If the environment's present configuration is not supported.
        """
        check_traffic(self._base)
        self._begin()
        self._scene.forget()
        self._search: TrafficSearch | None = None
        self._present: TrafficSearch | None = None
        self._tail: BackupSequence = empty_tail(1)

    def _physical(self, action: Any, read: FloatArray) -> FloatArray:
        """Acceleration [m/s^2] and wheel angle [rad], (2,), from highway-env's own code: in the precision of the
        action, since the simulation has to be exact."""
        given: dict[str, float] = {}
        kind = copy(self._base.action_type)
        kind.controlled_vehicle = SimpleNamespace(act=given.update)
        kind.act(action)
        return np.array([float(given["acceleration"]), float(given["steering"])])

    def _filter(self, begins: bool) -> tuple[FloatArray, Decision]:
        start, self.cause = perf_counter(), ""
        try:
            search, present = self._read(begins)
        except Exception as error:
            reason, self.cause = scene_failure(error)
            return self._last_resort(reason, start)
        known, proposal, tail = self._proposal is not None, np.zeros(2), self._tail
        # The decision advances `present`.
        before, planned, length = copy_of(present.futures), tail.actions.copy(), int(tail.counts[0])
        if self._proposal is not None:
            proposal = self._speed_recovery.proposal(self._proposal, float(self._base.vehicle.speed))
        code, margin = decide_inputs(search, present, self._tail, proposal, known, self._inputs)
        self._scene.expect(present.futures.f[0][STATE])
        tier = TIERS[code]
        # A stored plan is for this scene, which is as predicted.
        reason = Reason.NO_SAFE_PLAN if tier is Tier.LARGEST_MARGIN else Reason.UNVERIFIED
        if tier is Tier.PASSED:
            reason = Reason.NONE
        if not known:
            reason = Reason.BAD_ACTION
        elif tier is Tier.PASSED and proposal is not self._proposal:
            tier, reason = Tier.GOVERNED, Reason.RESUME
        plan, areas = None, None
        if self.config.record and self._tail.counts[1] == 0:
            search.futures.f[0], search.futures.g[0] = present.futures.f[0], present.futures.g[0]
            plan, areas = self._scene.shown(search, self._tail.actions, int(self._tail.counts[0]))
        inputs, source = self._inputs.copy(), None
        if tier is not Tier.PASSED and known:
            source = self._scene.kept(search, before, proposal.copy(), planned, length)
        latency = perf_counter() - start
        return inputs, Decision(inputs, inputs, reason, tier, margin, latency, plan, areas, source=source)

    def _last_resort(self, reason: Reason, start: float) -> tuple[FloatArray, Decision]:
        """Inputs without a readable scene: the stored plan, or braking with the wheel straight."""
        tier, present = Tier.EMERGENCY, self._present
        if present is not None and self._tail.counts.any():
            advance_backup(present, self._tail, self._inputs)
            tier = Tier.STORED_PLAN
        else:
            speed = float(getattr(self._base.vehicle, "speed", np.nan))
            stopping = -speed * self._base.config["simulation_frequency"]
            hardest = self.config.braking
            self._inputs[:] = np.clip(stopping, -hardest, hardest) if np.isfinite(speed) else 0.0, 0.0
        self._scene.expect_nothing()
        inputs = self._inputs.copy()
        return inputs, Decision(inputs, inputs, reason, tier, np.nan, perf_counter() - start)

    def _verifies(self, base: Any, loaded: LoadedSearch) -> bool:
        """Whether the lane-and-speed controllers verify in a scene, without an input before them. Read-only."""
        simulator, search = loaded
        present = search._replace(futures=copy_of(simulator.worlds))
        search.futures.p[:], search.futures.routes[:] = present.futures.p, present.futures.routes
        tail = empty_tail(search.bounds.depth)
        code, _ = decide_inputs(search, present, tail, np.zeros(2), False, np.zeros(2))
        return TIERS[code].verified

    def _controller_state(self) -> tuple[int, int, float] | None:
        """Whether the lane-and-speed controllers acted in the last frame, their target lane and speed [m/s]; None
        without a scene. They may continue from there, also after an action has ended."""
        if self._present is None:
            return None
        futures = self._present.futures
        ego = int(np.flatnonzero(futures.g[0, KIND] == CONTINUOUS)[0])
        return (
            int(futures.g[0, USES_CONTROLLERS, ego]),
            int(futures.g[0, TARGET, ego]),
            float(futures.f[0, TARGET_SPEED, ego]),
        )

    def _read(self, begins: bool) -> tuple[TrafficSearch, TrafficSearch]:
        """Search buffers, and the present scene.

        Between two frames of a decision the scene is the predicted one if all states are as predicted. It is read again
        only at a mismatch, since some vehicles have already acted for the coming frame.
        """
        search, present = self._search, self._present
        if begins or search is None or present is None or not self._scene.is_as_predicted():
            controllers, predicted = self._controller_state(), self._scene.has_prediction
            simulator, search = self._scene.read()
            present = search._replace(futures=simulator.worlds)
            if self._scene.mismatched or not predicted:
                # The stored plan was for another scene.
                self._tail.counts[:] = 0
            elif controllers is not None:
                # highway-env has no state of these controllers: restore it.
                f, g, ego = simulator.worlds.f[0], simulator.worlds.g[0], self._scene.ego(self._scene.bodies())
                g[USES_CONTROLLERS, ego], g[TARGET, ego], f[TARGET_SPEED, ego] = controllers
            if len(self._tail.actions) != search.bounds.depth:
                self._tail = empty_tail(search.bounds.depth)
            self._search, self._present = search, present
            # Constant properties are the same in all futures.
            search.futures.p[:], search.futures.routes[:] = present.futures.p, present.futures.routes
        return search, present
