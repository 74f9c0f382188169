"""Input of the predictive filter in place of a proposal: the scene as an optimisation problem."""

from __future__ import annotations

import numpy as np

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray, RoadState, State
from dynamics.vehicle.actuators import Actuators
from mpc.filter.from_scene import curvature_ahead, edges_of, rectangles
from mpc.filter.predictive_filter import PredictiveFilter
from mpc.filter.problem import FilterProblem, FilterSettings
from mpc.filter.program.road_step import StageModel
from mpc.filter.solvers.guess import shifted
from shield.certificate.road.memory import ObservedScene
from shield.config import ShieldConfig

__all__ = ["Predictor"]

_STAGE, _STAGES = 0.2, 20
"""Duration of a stage of the predictive filter [s], and number of stages."""
_NEAREST = 12
"""Greatest number of vehicles in the problem."""


class Predictor:
    """Solves the predictive filter's problem for a scene. The caller keeps the plan from which the next solution
    starts.

    Parameters
    ----------
    config : settings. actuators : inputs of the policy.
    hold : number of simulation frames for which an input is held.
    model : prediction model; the bicycle by default.
    """

    def __init__(self, config: ShieldConfig, actuators: Actuators, hold: int, model: StageModel | None) -> None:
        self._config, self._actuators, self._hold, self.model = config, actuators, hold, model
        self._filters: dict[float, PredictiveFilter] = {}

    def prepare(self, scene: Scene) -> None:
        """Compile the programs for a scene."""
        self._filter_for(scene).prepare(_NEAREST, curved=scene.road.bends is not None)

    def plan(self, now: ObservedScene, proposal: FloatArray, lane: int) -> FloatArray | None:
        """Inputs (N, 2), near the proposal in the first stage; None if no inputs satisfy the constraints.

        Parameters
        ----------
        now : the observed scene. proposal : acceleration [m/s^2] and front wheel angle [rad], (2,).
        lane : lane that the plan may use besides the ego's own.
        """
        solver = self._filter_for(now.scene)
        settings, scene = solver.settings, now.scene
        verifier, road, dt = now.verifier, scene.road, scene.dt
        here, v = now.here, max(float(scene.ego[State.SPEED]), 0.0)
        half = verifier.size.along + verifier.size.growth_along, verifier.size.across + verifier.size.growth_across
        low, high = edges_of(road, [here, lane], float(scene.ego_road[RoadState.R]), half[1])
        owned, duration = verifier.owned[here] and verifier.owned[lane], settings.ends[-1] * dt
        rows = verifier.relevant((v + 2.0) * duration, followers=not owned)
        around = verifier.around
        # Beyond its edges the plan meets no vehicle, and need not stay behind any there either.
        rows = rows[(around.low[rows] < high) & (around.high[rows] > low)]
        rows = rows[np.argsort(np.abs(scene.others_road[rows, RoadState.S] - scene.ego_road[RoadState.S]))][:_NEAREST]
        problem = FilterProblem(
            state=scene.ego_road,
            proposal=proposal,
            occupancy=rectangles(around, rows, settings),
            half=half,
            edges=(low, high),
            curvature=curvature_ahead(scene, v, settings),
        )
        # The solver keeps no state of the problem before.
        solver.reset()
        last = now.memory.plan
        guess = None if last is None else shifted(last, settings.frames[0], settings)
        result = solver.solve(problem, guess)
        return result.inputs if result.status.usable and np.isfinite(result.inputs[0]).all() else None

    def _filter_for(self, scene: Scene) -> PredictiveFilter:
        """The predictive filter for the scene's frame duration."""
        solver = self._filters.get(scene.dt)
        if solver is None:
            substeps = max(1, round(_STAGE / scene.dt))
            settings = FilterSettings(
                dt=scene.dt,
                substeps=max(substeps, self._hold),
                hold=self._hold,
                stages=_STAGES,
                acceleration=(-self._config.braking, max(self._actuators.acceleration[1], 1.0)),
                steering=max(abs(self._actuators.steering[0]), abs(self._actuators.steering[1])),
                braking=self._config.braking,
            )
            solver = self._filters[scene.dt] = PredictiveFilter(settings, self.model)
        return solver
