"""The predictive filter against its rivals, question by question in one run with one thread.

    python benchmarks/filter_rivals.py [--questions 100] [--stages 20 40]

The questions are recorded while the filter drives highway-v0 among traffic (6 obstacles) behind policies of several
kinds, and each rival answers each question in turn, so that a busy machine slows all of them. The rivals' problems
are the same one: same dynamics, bounds, sides, weights.

- IPOPT: the nonlinear program, from the shifted plan. Its exact Hessian and one stage per move are what a user writes.
- OSQP, program by program: the sparse form of every program that DAQP solves in a filter, updated in place and started
  from its own last answer moved on in time; and as the backend of a whole filter, from the same guesses.
- do-mpc: the same stage cost and bounds as time-varying parameters, its default IPOPT set-up; printed as missing where
  it is not installed.
- PPO: `predict` of Stable-Baselines3.

"per filter" is the ratio of medians to the filter's whole `solve`, "per sweep" that to one linearisation with its
quadratic program: what IPOPT's and do-mpc's one solve is to be held against is the former.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

import filter_nlp
from filter_scenes import KINDS, environment, record

from mpc import FilterProblem, FilterResult, FilterSettings, PredictiveFilter
from mpc.filter.program.condensed import Program
from mpc.filter.program.road_step import rollout_function
from mpc.filter.program.sparse import SparseProgram
from mpc.filter.solvers.daqp import QpSolution, Solver
from mpc.filter.solvers.guess import brake_guess, shifted
from mpc.filter.solvers.osqp import OsqpSolver

QUESTION = (
    *("state", "inputs", "occupancy", "rest", "edges", "corridor"),
    *("curvature", "aim", "misc", "given"),
)
"""Arrays that two programs of the same question share."""


class Beside(Solver):
    """DAQP in a filter, and OSQP beside it on the sparse form of each of its programs."""

    def __init__(self, settings: FilterSettings) -> None:
        super().__init__(settings)
        self.osqp = OsqpSolver(replace(settings, backend="osqp"))
        self.twins: dict[int, tuple[Program, SparseProgram]] = {}
        self.times: dict[str, list[float]] = {name: [] for name in ("program", "osqp", "data osqp")}
        self.exact: list[bool] = []
        self.apart: list[float] = []
        self.iterations: list[int] = []

    def begin(self, frames: int | None) -> None:
        """As the filter asks."""
        self.osqp.begin(frames)

    def solve(self, program: Program) -> QpSolution:
        """DAQP's answer; the times of both are kept."""
        if id(program) not in self.twins:
            twin = SparseProgram(self.osqp.settings, program.occupancy.shape[1], False, False)
            self.twins[id(program)] = program, twin
            self.osqp.prepare(twin)
        twin = self.twins[id(program)][1]
        for name in QUESTION:
            getattr(twin, name)[:] = getattr(program, name)
        start = perf_counter()
        answer = super().solve(program)
        middle = perf_counter()
        twin.linearise()
        built = perf_counter()
        other = self.osqp.solve(twin)
        end = perf_counter()
        for name, value in zip(self.times, (middle - start, end - built, built - middle), strict=True):
            self.times[name].append(value)
        self.exact.append(other.exact)
        self.iterations.append(self.osqp.iterations)
        if answer.x is not None and other.x is not None and other.exact:
            self.apart.append(float(np.abs(answer.x[:2] - other.x[:2]).max() / 2))
        return answer


def do_mpc_controller(settings: FilterSettings) -> Any:
    """The same problem for do-mpc, or None where it is not installed."""
    try:
        import do_mpc
    except ImportError:
        return None
    from mpc.filter.program.road_step import stage_expression

    model = do_mpc.model.Model("discrete", "SX")
    import casadi as ca

    x = ca.vertcat(*[model.set_variable("_x", name) for name in ("s", "r", "psi", "v")])
    u = ca.vertcat(*[model.set_variable("_u", name) for name in ("a", "delta")])
    names = ("s_low", "s_high", "r_low", "r_high", "near_a", "near_d", "weight")
    for name in names:
        model.set_variable("_tvp", name)
    after = stage_expression(x, u, None, settings.dt, settings.substeps)
    for i, name in enumerate(("s", "r", "psi", "v")):
        model.set_rhs(name, after[i])
    model.setup()
    x = ca.vertcat(*[model.x[name] for name in ("s", "r", "psi", "v")])
    u = ca.vertcat(*[model.u[name] for name in ("a", "delta")])
    given = {name: model.tvp[name] for name in names}
    controller = do_mpc.controller.MPC(model)
    controller.settings.n_horizon, controller.settings.t_step = settings.stages, settings.stage
    controller.settings.store_full_solution = False
    controller.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}
    scale = (5.0, settings.steering)
    off = ((u[0] - given["near_a"]) / scale[0]) ** 2 + ((u[1] - given["near_d"]) / scale[1]) ** 2
    small = settings.magnitude * (u[0] / scale[0]) ** 2 + settings.steadiness * 20 * (u[1] / scale[1]) ** 2
    controller.set_objective(mterm=ca.SX(0), lterm=given["weight"] * off + small)
    controller.set_rterm(a=1e-4, delta=1e-4)
    for name, bound in (("a", scale[0]), ("delta", scale[1])):
        controller.bounds["lower", "_u", name], controller.bounds["upper", "_u", name] = -bound, bound
    controller.bounds["lower", "_x", "v"] = 0.0
    lon, lat = 4.5, 1.3
    corner, h = lon * ca.sin(x[2]), lon + lat * ca.sqrt(ca.sin(x[2]) ** 2 + 4e-4)
    rows = {
        "behind": x[0] + h - given["s_high"],
        "ahead": given["s_low"] - x[0] + h,
        "left": x[1] + lat + corner - given["r_high"],
        "left_too": x[1] + lat - corner - given["r_high"],
        "right": given["r_low"] - x[1] + lat + corner,
        "right_too": given["r_low"] - x[1] + lat - corner,
    }
    for name, row in rows.items():
        controller.set_nl_cons(name, row, ub=0, soft_constraint=True, penalty_term_cons=settings.penalty)
    template = controller.get_tvp_template()
    controller.data_now = (np.zeros(2), np.zeros((settings.stages, 4)))

    def fill(_: float) -> Any:
        proposal, limit = controller.data_now
        for k in range(settings.stages + 1):
            row = limit[max(k - 1, 0)]
            values = (*row[:4], *proposal, 1.0 if k == 0 else 0.0)
            for name, value in zip(names, values, strict=True):
                template["_tvp", k, name] = value
        return template

    controller.set_tvp_fun(fill)
    with contextlib.redirect_stdout(io.StringIO()):
        controller.setup()
    return controller


def ask_do_mpc(controller: Any, problem: FilterProblem, result: FilterResult, settings: FilterSettings) -> float:
    """Time of one step of do-mpc [s]."""
    limit, _ = filter_nlp.bounds_of(problem, result.sides, settings)
    limit[:, :2] = np.clip(limit[:, :2] - problem.state[0], -1e4, 1e4)
    controller.data_now = (problem.proposal, np.clip(limit, -1e4, 1e4))
    state = problem.state - [problem.state[0], 0, 0, 0]
    with contextlib.redirect_stdout(io.StringIO()):
        start = perf_counter()
        if controller.flags["initial_run"] is False:
            controller.x0 = state
            controller.set_initial_guess()
        controller.make_step(state)
        return perf_counter() - start


def policy() -> Any:
    """PPO of the usual size on the kinematic observation."""
    from stable_baselines3 import PPO

    env = environment()
    observation, _ = env.reset(seed=0)
    model = PPO("MlpPolicy", env, policy_kwargs={"net_arch": [256, 256]}, device="cpu", seed=0)
    return model, observation


def measure(stages: int, questions: int) -> dict[str, Any]:
    """Times of every rival on the same questions [s]."""
    settings = FilterSettings(stages=stages)
    recorded = [list(record(settings, questions // len(KINDS), kind, seed=40)) for kind in KINDS]
    own, beside = PredictiveFilter(settings), PredictiveFilter(settings)
    beside._solver = solvers = Beside(settings)
    other = PredictiveFilter(replace(settings, backend="osqp"))
    roll = rollout_function(stages, settings.substeps, settings.dt)
    controller, (model, observation) = do_mpc_controller(settings), policy()
    times: dict[str, list[float]] = {k: [] for k in ("filter", "filter osqp", "data", "ipopt", "do-mpc", "ppo")}
    usable: list[bool] = []
    theirs: list[bool] = []
    converged: list[bool] = []
    offset = np.zeros((stages, 2))
    plan = None
    for problem, first in (row for rows in recorded for row in rows):
        if first:
            own.reset()
            beside.reset()
            other.reset()
            plan = None
        guess = brake_guess(problem, settings) if plan is None else shifted(plan, settings.substeps, settings)
        asked = None if own._plan is None else shifted(own._plan, settings.substeps, settings)
        start = perf_counter()
        result = own.solve(problem)
        times["filter"].append(perf_counter() - start)
        usable.append(result.status.usable)
        program = own._program(problem.occupancy.shape[1], False, False)
        start = perf_counter()
        program.linearise()
        times["data"].append(perf_counter() - start)
        beside.solve(problem)
        start = perf_counter()
        theirs.append(other.solve(problem, asked).status.usable)
        times["filter osqp"].append(perf_counter() - start)
        if np.isfinite(result.inputs).all():
            states = roll(problem.state, guess.T, np.zeros((1, stages))).full().T
            start = perf_counter()
            plan, *_, success = filter_nlp.solve(
                problem, result.sides, guess, states, settings, blocked=False, offset=offset
            )
            times["ipopt"].append(perf_counter() - start)
            converged.append(success)
            if controller is not None:
                times["do-mpc"].append(ask_do_mpc(controller, problem, result, settings))
        start = perf_counter()
        model.predict(observation, deterministic=True)
        times["ppo"].append(perf_counter() - start)
    return {
        "times": {**times, **solvers.times},
        "usable": np.mean(usable),
        "theirs": np.mean(theirs),
        "converged": np.mean(converged),
        "exact": np.mean(solvers.exact),
        "iterations": np.median(solvers.iterations),
        "apart": np.percentile(solvers.apart, [50, 99]),
        "do-mpc": controller is not None,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--questions", type=int, default=100, help="questions per horizon")
    parser.add_argument("--stages", type=int, nargs="+", default=[20, 40])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for stages in arguments.stages:
        found = measure(stages, arguments.questions)
        table = Table(
            "what", "p50 [µs]", "p99 [µs]", "p99/p50", "per filter", "per sweep", "note", title=f"{stages} stages"
        )
        reference = float(np.median(found["times"]["filter"]))
        sweep = float(np.median(found["times"]["program"]) + np.median(found["times"]["data"]))
        notes = {
            "filter": f"whole solve, DAQP, {found['usable']:.0%} usable",
            "filter osqp": f"whole solve, OSQP, {found['theirs']:.0%} usable",
            "data": "one linearisation, condensed",
            "data osqp": "one linearisation, sparse",
            "program": "one quadratic program, DAQP with checks",
            "osqp": f"OSQP with checks, {found['iterations']:.0f} iterations, {found['exact']:.0%} exact; those differ "
            f"by {found['apart'][0]:.2%} of the range, p99 {found['apart'][1]:.2%}",
            "ipopt": f"{found['converged']:.0%} converged",
            "do-mpc": "" if found["do-mpc"] else "not installed: pip install do-mpc",
            "ppo": "predict",
        }
        for name, note in notes.items():
            values = found["times"][name]
            if not values:
                table.add_row(name, *5 * ["-"], note)
                continue
            p50, p99 = np.percentile(values, [50, 99])
            ratios = (f"{p50 / base:.2f}" for base in (reference, sweep))
            table.add_row(name, f"{1e6 * p50:.0f}", f"{1e6 * p99:.0f}", f"{p99 / p50:.1f}", *ratios, note)
        Console(width=120).print(table)


if __name__ == "__main__":
    main()
