"""`CEMPolicy`: a sampling planner as a policy, with SB3's `predict`.

A `Task` defines how states are read from observations, and the cost. `ParkingTask` is the one for `parking-v0`;
`CEMPolicy.parking(env)` combines model, planner and task. `HighwayTask` and `CEMPolicy.highway(env, model)` are for
meta-actions among traffic, `RoundaboutTask` and `CEMPolicy.roundabout(env, model)` for a roundabout.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np

from dynamics.errors import ConfigError
from dynamics.learned.models.bicycle import BicycleModel
from dynamics.learned.models.model import StepModel
from dynamics.learned.tasks.roundabout_model import RoundaboutModel
from dynamics.learned.tasks.traffic_model import TrafficModel
from mpc.sampling.categorical import CategoricalCEM, CategoricalSettings
from mpc.sampling.cem import CEM, PlannerSettings
from mpc.sampling.mppi import MPPI
from mpc.sampling.plan import Cost, PlanMemory, PlanStatus, SampledPlan
from mpc.tasks.cautious_parking import CautiousTask
from mpc.tasks.highway import HighwayTask
from mpc.tasks.parking import ParkingTask, brake, parking_settings
from mpc.tasks.roundabout import RoundaboutTask, roundabout_settings

__all__ = ["CEMPolicy", "Planner", "Task"]


class Planner(Protocol):
    """Planner of a policy: `CEM`, `MPPI` or `CategoricalCEM`."""

    def plan(self, state: Any, cost: Cost, memory: PlanMemory | None = None) -> SampledPlan:
        """The cheapest plan of the search."""
        ...


class Task(Protocol):
    """Task of a policy: states and cost."""

    def read(self, observation: Any) -> tuple[Any, Any, bool]:
        """States (E, d), episode marks (E, k) that change with the episode, and whether there was a single state."""
        ...

    def cost(self, observation: Any, started: Any) -> Cost:
        """The cost in this decision; `started` (E,) marks the rows in which an episode begins."""
        ...


PlannerMemory: TypeAlias = tuple[PlanMemory, Any]


class CEMPolicy:
    """Plans in each decision, and executes the first input of the plan.

    Parameters
    ----------
    planner : the planner.
    task : the task.

    Attributes
    ----------
    last_plan : the last plan, of all environments; None before the first.
    fallbacks : number of decisions, over all environments, in which no plan was usable and the fallback acted.

    Examples
    --------
    >>> import gymnasium as gym, highway_env
    >>> env = gym.make("parking-v0")
    >>> obs, _ = env.reset(seed=0)
    >>> policy = CEMPolicy.parking(env)
    >>> action, state = policy.predict(obs)
    >>> action.shape, policy.last_plan.status[0].name
    ((2,), 'PLANNED')
    """

    def __init__(self, planner: Planner, task: Task) -> None:
        self.planner, self.task = planner, task
        self.reset()

    @classmethod
    def parking(
        cls,
        env: Any,
        model: StepModel | None = None,
        settings: PlannerSettings | None = None,
        task: ParkingTask | CautiousTask | None = None,
        temperature: float | None = None,
    ) -> CEMPolicy:
        """The policy for `parking-v0`.

        Parameters
        ----------
        env : the environment or VecEnv; obstacles are read from it, and without `model` the bicycle.
        model : model of the states of `dynamics.learned.tasks.parking_state`; the true bicycle by default.
        settings : settings of the search; `parking_settings()` by default.
        task : the task; `ParkingTask(env)` by default.
        temperature : temperature of `MPPI`, which replaces `CEM` if it is given, by default with the settings
            `parking_settings("mppi")`.

        Raises
        ------
        ConfigError
            If the environment is not parking with continuous actions, or the model has other dimensions.
        """
        if settings is None:
            settings = parking_settings("quality" if temperature is None else "mppi")
        task = task if task is not None else ParkingTask(env)
        model = model if model is not None else BicycleModel.of(task.bases[0], np.float32)
        if (model.state_dim, model.action_dim) != (6, 2):
            raise ConfigError(
                f"parking has 6 state variables and 2 inputs; this model has {model.state_dim} and {model.action_dim}"
            )
        fallback = brake(task.bases[0])
        if temperature is not None:
            return cls(MPPI(model, settings, fallback, temperature), task)
        return cls(CEM(model, settings, fallback), task)

    @classmethod
    def highway(
        cls,
        env: Any,
        model: TrafficModel,
        settings: CategoricalSettings | None = None,
        task: HighwayTask | None = None,
    ) -> CEMPolicy:
        """The policy for a straight highway with meta-actions.

        Parameters
        ----------
        env : the environment.
        model : model of the scene, with as many vehicles as the observation.
        settings : settings of the search.
        task : the task; `HighwayTask(env)` by default.

        Raises
        ------
        ConfigError
            If the model has another number of actions or vehicles than the environment.
        """
        task = task if task is not None else HighwayTask(env)
        if (model.pair.action_dim, model.vehicles) != (task.actions, task.vehicles):
            raise ConfigError(
                f"this environment has {task.actions} meta-actions and shows {task.vehicles} other vehicles; the model "
                f"is of {model.pair.action_dim} and {model.vehicles}"
            )
        fallback = np.full(1, task.slower)
        planner = CategoricalCEM(model, task.actions, settings, lambda states: np.repeat(fallback, len(states)))
        return cls(planner, task)

    @classmethod
    def roundabout(
        cls,
        env: Any,
        model: RoundaboutModel,
        settings: CategoricalSettings | None = None,
        task: RoundaboutTask | None = None,
    ) -> CEMPolicy:
        """The policy for highway-env's roundabout with meta-actions.

        Parameters
        ----------
        env : the environment.
        model : model of the scene, with two rows for each other vehicle of the observation.
        settings : settings of the search; `roundabout_settings()` by default.
        task : the task; `RoundaboutTask(env)` by default.

        Raises
        ------
        ConfigError
            If the model has another number of actions or rows, or another exit, than the environment.
        """
        task = task if task is not None else RoundaboutTask(env)
        have, needs = (model.actions, model.rows, model.exit_arm), (task.actions, task.rows, task.exit_arm)
        if have != needs:
            raise ConfigError(
                f"this environment has {needs[0]} meta-actions, {needs[1]} rows of other vehicles and the ego leaves "
                f"at arm {needs[2]}; the model is of {have[0]}, {have[1]} and {have[2]}"
            )
        settings = settings if settings is not None else roundabout_settings()
        fallback = np.full(1, task.slower)
        planner = CategoricalCEM(model, task.actions, settings, lambda states: np.repeat(fallback, len(states)))
        return cls(planner, task)

    def reset(self) -> None:
        """Forget the last plans; happens automatically at the start of an episode."""
        self._memory: PlannerMemory | None = None
        self.last_plan: SampledPlan | None = None
        self.fallbacks = 0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """SB3's `predict`.

        Parameters
        ----------
        observation : observation of one environment, or a batch.
        state : state returned by the last call; by default the policy's own memory of that call.
        episode_start : mask of environments after a reset; by default an episode begins when the goal changes.
        deterministic : ignored; plans depend only on the observations since the start of the episode.

        Returns
        -------
        The action, (m,) float32, or (E, m) for a batch; and the state for the next call.
        """
        states, mark, single = self.task.read(observation)
        memory, started = self._recall(len(states), mark, state, episode_start)
        plan = self.planner.plan(states, self.task.cost(observation, started), memory)
        self.last_plan = plan
        self.fallbacks += sum(s is PlanStatus.FALLBACK for s in plan.status)
        self._memory = (plan.memory, mark)
        return plan.action[0] if single else plan.action, self._memory

    def _recall(self, e: int, mark: Any, state: Any, episode_start: Any) -> tuple[PlanMemory | None, Any]:
        """The memory for the next plan, and the rows in which an episode begins."""
        last = self._memory if state is None else state
        if last is None or len(last[0].count) != e:
            return None, np.ones(e, bool)
        memory, before = last
        if episode_start is None:
            started = np.any(before != mark, axis=1)
        else:
            started = np.broadcast_to(np.asarray(episode_start, bool).reshape(-1), (e,))
        return memory.forget(started) if started.any() else memory, started
