"""The filter for `ContinuousAction`: from normalised actions to filtered inputs, frame by frame."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.errors import ConfigError, SceneError
from dynamics.scenes.parking_lot import ParkingSceneReader, is_parking_lot
from dynamics.scenes.scene import SceneReader
from dynamics.state import FloatArray, State
from dynamics.vehicle.actuators import Actuators
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.explaining.scenes import explain_scene
from shield.filters.input_frames import InputFrames
from shield.filters.simulated.remedies import simulation_advice
from shield.pipelines.decide import DecisionCore, Unreadable, read
from shield.pipelines.inputs import InputPipeline
from shield.pipelines.parking_lot import ParkingLotPipeline
from shield.supported_environments import refuse_simulated

if TYPE_CHECKING:
    from mpc.filter.program.road_step import StageModel

__all__ = ["InputFilter"]


class InputFilter(InputFrames):
    """Filters the throttle and steering of one environment: on its road, or in its parking lot (`is_parking_lot`).

    Parameters
    ----------
    base : the highway-env environment, unwrapped.
    config : settings.
    agent : whether the shield acts through the actions only, instead of at every frame.
    model : model of the predictive filter, on a road with supervised frames; the bicycle by default.

    Raises
    ------
    ConfigError
        If the mode is a rule for meta-actions, the actions cannot be verified (with `agent`: `DiscreteAction`), or a
        model is given although no predictive filter uses it.
    SceneError
        If the environment has several controlled vehicles, or its road is not supported.
    """

    def __init__(self, base: Any, config: ShieldConfig, agent: bool = False, model: StageModel | None = None) -> None:
        refuse_simulated(config)
        super().__init__(base, config)
        self._lot, self._agent, self._model = is_parking_lot(base), agent, model
        if model is not None and (self._lot or agent):
            raise ConfigError("a model is for the predictive filter of ShieldedEnv on a road; leave it out here")
        # The core judges the kind of scene that the reader returns.
        self._reader: Any = ParkingSceneReader(base) if self._lot else SceneReader(base, curved=True)
        self.core: DecisionCore[Any] = self._new_core()
        if base.road is not None and not self._off:
            self._check()
        _refuse_tyres(base)
        _refuse_speed_range(base)
        # Last, because its message suggests supervision, which the checks above would refuse as well.
        self._refuse_choices()

    def _new_core(self) -> DecisionCore[Any]:
        """Decision core for the present actuators and frequencies of the environment."""
        self._made_for = self.actuators, self._period
        hold = self._period if self._agent else None
        if self._lot:
            return DecisionCore(ParkingLotPipeline(self.config, self.actuators, hold), explain_scene)
        return DecisionCore(InputPipeline(self.config, self.actuators, hold, model=self._model), explain_scene)

    def _refuse_choices(self) -> None:
        """Raise `ConfigError` for `DiscreteAction` without supervised frames."""
        if self._agent and self.actuators.choices is not None:
            raise ConfigError(
                "with frames=False the fail-safe goes through the policy's actions, and DiscreteAction has but a few; "
                "take Shield(policy, env=env), ShieldedEnv(env), or ContinuousAction"
            )

    def record(self) -> None:
        """Keep in each decision the data for drawings, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)
        procedure: Any = self.core.procedure
        procedure.config = procedure.config.replace(record=True)

    def reset(self) -> None:
        """Clear everything about the episode, and compute the road-dependent tables.

        Raises
        ------
        SceneError
            If the episode's road is not supported.
        ConfigError
            If the environment's present configuration is not supported.
        """
        self._begin()
        _refuse_tyres(self._base)
        _refuse_speed_range(self._base)
        if not _same(self._made_for, (self.actuators, self._period)):
            self._refuse_choices()
            self.core = self._new_core()
        self.core.reset()
        procedure = self.core.procedure
        if self._off:
            return
        self._check()
        if not isinstance(procedure, InputPipeline):
            return
        # An unreadable scene is handled by the first decision, which fails closed.
        with suppress(SceneError):
            procedure.prepare(self._reader.read())

    @property
    def violations(self) -> int:
        """Number of violations of the assumptions by the traffic."""
        return self.core.violations

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by rule."""
        return self.core.by_rule

    @property
    def supervising(self) -> bool:
        """Whether `frame` is called between decisions."""
        return not (self._off or self._agent)

    def monitor_last_frame(self) -> None:
        """Run the monitor on the last frame of an episode, after which there is no decision."""
        if not self._off:
            self.core.observe(read(self._reader))

    def _filter(self, begins: bool) -> tuple[FloatArray, Decision]:
        start, proposal = perf_counter(), self._proposal
        scene = read(self._reader, self._stopping())
        self.cause = scene.cause if isinstance(scene, Unreadable) else ""
        if proposal is not None and not isinstance(scene, Unreadable) and scene.finite and not self._agent:
            proposal = self._speed_recovery.proposal(proposal, float(scene.ego[State.SPEED]))
        decision = self.core.decide(scene, proposal)
        inputs: FloatArray = decision.executed
        if decision.tier is Tier.PASSED and self._proposal is not None and inputs[0] != self._proposal[0]:
            decision = replace(decision, reason=Reason.RESUME, tier=Tier.GOVERNED)
        return inputs, replace(decision, latency=perf_counter() - start)

    def _check(self) -> None:
        """Compute the road-dependent tables. An error names the settings that support this road."""
        try:
            self._reader.check()
        except SceneError as error:
            instead = "" if self._base.road is None else simulation_advice(self._base)
            if not instead:
                raise
            raise SceneError(f"without simulation this road is not supported: {instead}. ({error})") from error

    def _stopping(self) -> float:
        """Acceleration that stops the ego by the next scene, from its speed alone [m/s^2]; NaN if the speed is
        unknown."""
        speed = float(getattr(self._base.vehicle, "speed", np.nan))
        frames = self._period if self._agent else 1
        return float(-speed * self._base.config["simulation_frequency"] / frames)


def _same(a: tuple[Actuators, int], b: tuple[Actuators, int]) -> bool:
    """Whether the actuators and the numbers of frames in a decision are equal."""
    names = [each.name for each in fields(Actuators)]
    return a[1] == b[1] and all(np.array_equal(getattr(a[0], name), getattr(b[0], name)) for name in names)


def _refuse_speed_range(base: Any) -> None:
    """Raise `ConfigError` if the action has a speed range of its own."""
    if getattr(base.action_type, "speed_range", None):
        raise ConfigError(
            f"the shield's rollouts assume highway-env's own speed limits; this environment's ContinuousAction has "
            f"speed_range {base.action_type.speed_range}. Leave speed_range out of the action's config"
        )


def _refuse_tyres(base: Any) -> None:
    """Raise `ConfigError` if the vehicle model has tyre slip, and name the remedies.

    One remedy is to leave "dynamical" out, if the user has set it; a road that has it by default supports no other
    model. The other is simulation, where that is supported.
    """
    if not getattr(base.action_type, "dynamical", False):
        return
    own = base.default_config()["action"].get("dynamical", False)
    kinematic = "" if own else 'pass config={"action": {"type": "ContinuousAction", "dynamical": False}} to gym.make'
    mends = "; or ".join(each for each in (simulation_advice(base), kinematic) if each)
    raise ConfigError(
        "without simulation the shield knows highway-env's kinematic bicycle only, and this environment's "
        f"ContinuousAction is dynamical{': ' if mends else ''}{mends}"
    )
