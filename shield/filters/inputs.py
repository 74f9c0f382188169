"""The door for `ContinuousAction`: from normalised actions to filtered inputs, frame by frame."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.errors import ConfigError, SceneError
from dynamics.scenes.parking_lot import LotReader, is_lot
from dynamics.scenes.scene import SceneReader
from dynamics.state import FloatArray, State
from dynamics.vehicle.actuators import Actuators
from shield.config import ShieldConfig
from shield.decision import Decision, Reason, Tier
from shield.explaining.scenes import explain_scene
from shield.filters.input_frames import InputFrames
from shield.filters.simulated.remedies import by_simulation
from shield.pipelines.decide import Core, Unreadable, read
from shield.pipelines.inputs import Inputs
from shield.pipelines.parking_lot import ParkingLot
from shield.supported_environments import refuse_simulated

if TYPE_CHECKING:
    from mpc.filter.program.road_step import StageModel

__all__ = ["InputDoor"]


class InputDoor(InputFrames):
    """Filters the throttle and steering of one environment: on its road, or in its parking lot (`is_lot`).

    Parameters
    ----------
    base : the highway-env environment, unwrapped.
    config : settings.
    agent : whether the shield acts through the actions only and not at every frame.
    model : what the predictive filter plans with on a road, at every frame; the bicycle by default.

    Raises
    ------
    ConfigError
        If the mode is one of the rules for meta-actions, the actions are none that can be verified (with `agent`, those
        of `DiscreteAction`), or a model is given where no predictive filter would use it.
    SceneError
        If the environment has several controlled vehicles, or its road is not supported.
    """

    def __init__(self, base: Any, config: ShieldConfig, agent: bool = False, model: StageModel | None = None) -> None:
        refuse_simulated(config)
        super().__init__(base, config)
        self._lot, self._agent, self._model = is_lot(base), agent, model
        if model is not None and (self._lot or agent):
            raise ConfigError("a model is for the predictive filter of ShieldedEnv on a road; leave it out here")
        # A reader and a core belong together: what the one reads, the other judges.
        self._reader: Any = LotReader(base) if self._lot else SceneReader(base, curved=True)
        self.core: Core[Any] = self._new_core()
        if base.road is not None and not self._off:
            self._check()
        _refuse_tyres(base)
        _refuse_speed_range(base)
        # Last: what supervises the frames is refused for the same reasons as above.
        self._refuse_choices()

    def _new_core(self) -> Core[Any]:
        """What decides, for the actuators and the frequencies that the environment has now."""
        self._made_for = self.actuators, self._period
        hold = self._period if self._agent else None
        if self._lot:
            return Core(ParkingLot(self.config, self.actuators, hold), explain_scene)
        return Core(Inputs(self.config, self.actuators, hold, model=self._model), explain_scene)

    def _refuse_choices(self) -> None:
        if self._agent and self.actuators.choices is not None:
            raise ConfigError(
                "with frames=False the fail-safe goes through the policy's actions, and DiscreteAction has but a few; "
                "take Shield(policy, env=env), ShieldedEnv(env), or ContinuousAction"
            )

    def record(self) -> None:
        """Keep in each decision what is drawn, as with `ShieldConfig.record`."""
        self.config = self.config.replace(record=True)
        procedure: Any = self.core.procedure
        procedure.config = procedure.config.replace(record=True)

    def reset(self) -> None:
        """Forget everything about the episode, and compute what depends on the road alone.

        Raises
        ------
        SceneError
            If the episode's road is not supported.
        ConfigError
            If the environment is now configured as the shield does not support.
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
        if not isinstance(procedure, Inputs):
            return
        # A scene that cannot be read is for the first decision to fail closed on.
        with suppress(SceneError):
            procedure.prepare(self._reader.read())

    @property
    def violations(self) -> int:
        """How often the traffic has broken the assumptions."""
        return self.core.violations

    @property
    def by_rule(self) -> dict[str, int]:
        """The same by the rule that was broken."""
        return self.core.by_rule

    @property
    def supervising(self) -> bool:
        """Whether `frame` has a say."""
        return not (self._off or self._agent)

    def look(self) -> None:
        """Judge the others in the last frame of an episode, after which nothing is decided."""
        if not self._off:
            self.core.look(read(self._reader))

    def _filter(self, begins: bool) -> tuple[FloatArray, Decision]:
        start, proposal = perf_counter(), self._proposal
        scene = read(self._reader, self._stopping())
        self.cause = scene.cause if isinstance(scene, Unreadable) else ""
        if proposal is not None and not isinstance(scene, Unreadable) and scene.finite and not self._agent:
            proposal = self._cruise.proposal(proposal, float(scene.ego[State.SPEED]))
        decision = self.core.decide(scene, proposal)
        inputs: FloatArray = decision.executed
        if decision.tier is Tier.PASSED and self._proposal is not None and inputs[0] != self._proposal[0]:
            decision = replace(decision, reason=Reason.RESUME, tier=Tier.GOVERNED)
        return inputs, replace(decision, latency=perf_counter() - start)

    def _check(self) -> None:
        """Read what depends on the road alone, or say what reads this road."""
        try:
            self._reader.check()
        except SceneError as error:
            instead = "" if self._base.road is None else by_simulation(self._base)
            if not instead:
                raise
            raise SceneError(f"without simulation this road is not supported: {instead}. ({error})") from error

    def _stopping(self) -> float:
        """The acceleration that just stops the ego until the next scene, from its speed alone [m/s^2]; NaN where that
        is not known."""
        speed = float(getattr(self._base.vehicle, "speed", np.nan))
        frames = self._period if self._agent else 1
        return float(-speed * self._base.config["simulation_frequency"] / frames)


def _same(a: tuple[Actuators, int], b: tuple[Actuators, int]) -> bool:
    """Whether actuators and frames of a decision are equal."""
    names = [each.name for each in fields(Actuators)]
    return a[1] == b[1] and all(np.array_equal(getattr(a[0], name), getattr(b[0], name)) for name in names)


def _refuse_speed_range(base: Any) -> None:
    """Raise where the ego has limits of speed of its own."""
    if getattr(base.action_type, "speed_range", None):
        raise ConfigError(
            f"the shield's rollouts assume highway-env's own speed limits; this environment's ContinuousAction has "
            f"speed_range {base.action_type.speed_range}. Leave speed_range out of the action's config"
        )


def _refuse_tyres(base: Any) -> None:
    """Raise where tyres slip, and say what mends it: leaving that out where the user has asked for it, as no road that
    has it by default is made or read without; and simulation where that serves."""
    if not getattr(base.action_type, "dynamical", False):
        return
    own = base.default_config()["action"].get("dynamical", False)
    kinematic = "" if own else 'pass config={"action": {"type": "ContinuousAction", "dynamical": False}} to gym.make'
    mends = "; or ".join(each for each in (by_simulation(base), kinematic) if each)
    raise ConfigError(
        "without simulation the shield knows highway-env's kinematic bicycle only, and this environment's "
        f"ContinuousAction is dynamical{': ' if mends else ''}{mends}"
    )
