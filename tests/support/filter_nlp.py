"""The filter's problem as a nonlinear program for IPOPT: the reference for its answers and its speed.

Same dynamics, constraints, weights and sides, written down a second time with nothing linearised and nothing
condensed: unknowns are inputs, states and slacks of every stage.
"""

from functools import lru_cache

import casadi as ca
import numpy as np

from mpc.filter.problem import FREE, Side
from mpc.filter.program.road_step import stage_expression

SMOOTH = 0.02


def halves(psi, lon, lat):
    """Half extents along (smooth) and across, at both corners."""
    h = lon * ca.fabs(ca.cos(psi)) + lat * ca.sqrt(ca.sin(psi) ** 2 + SMOOTH**2)
    return h, lat * ca.cos(psi), lon * ca.sin(psi)


@lru_cache(maxsize=8)
def program(settings, curved=False, blocked=True, quiet=True):
    """IPOPT for one size: x0 is the guess, p the data; see `solve`."""
    n, moves = settings.stages, len(settings.moves)
    of = np.repeat(np.arange(moves), settings.moves)
    x0, guess, bounds = ca.SX.sym("x0", 4), ca.SX.sym("guess", 2, n), ca.SX.sym("bounds", 6, n)
    curvature, rest, near, half = ca.SX.sym("k", n), ca.SX.sym("rest"), ca.SX.sym("near", 2), ca.SX.sym("half", 2)
    edges = ca.SX.sym("edges", 2, n)
    scale = ca.DM([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
    free = ca.SX.sym("free", 2, moves if blocked else n)
    x, slack = ca.SX.sym("x", 4, n), ca.SX.sym("slack", moves)
    u = guess / ca.repmat(scale, 1, n) + free[:, of.tolist()] if blocked else free
    cost = ca.sumsqr(u[:, 0] - near / scale)
    cost += settings.penalty * ca.sum1(slack) + 0.5 * settings.curving * ca.sumsqr(slack)
    equal, hard, soft = [], [], []
    before = x0
    for k in range(n):
        bend = curvature[k] if curved else None
        equal.append(x[:, k] - stage_expression(before, u[:, k] * scale, bend, settings.dt, settings.substeps))
        before = x[:, k]
        s, r, psi, v = (x[i, k] for i in range(4))
        h, across, corner = halves(psi, half[0], half[1])
        e = slack[int(of[k])]
        s_low, s_high, r_low, r_high, c_low, c_high = (bounds[i, k] for i in range(6))
        soft += [s_high - s - h + e, s - h - s_low + e]
        soft += [r_high - r - across - corner + e, r_high - r - across + corner + e]
        soft += [r - across - corner - r_low + e, r - across + corner - r_low + e]
        soft += [c_high - r + e, r - c_low + e]
        if k == n - 1 or of[k + 1] != of[k]:
            hard.append(v)
            soft += [5 * (settings.heading - psi) + e, 5 * (settings.heading + psi) + e]
        if k:
            off = u[:, k]
            if k > 1:
                cost += settings.smoothing * ca.sumsqr(u[:, k] - u[:, k - 1])
            cost += settings.magnitude * off[0] ** 2
            cost += settings.steadiness * (1 + (x0[3] / 5) ** 2) * off[1] ** 2
    way = v * ca.fabs(v) / (2 * settings.braking)
    drift = r + way * ca.sin(psi)
    soft += [rest - s - h - way + e]
    soft += [edges[1, n - 1] - drift - across - corner + e, edges[1, n - 1] - drift - across + corner + e]
    soft += [drift - across - corner - edges[0, n - 1] + e, drift - across + corner - edges[0, n - 1] + e]
    box = ca.vec(u)
    w = ca.vertcat(ca.vec(free), ca.vec(x), slack)
    g = ca.vertcat(*equal, *hard, *soft, box)
    p = ca.vertcat(x0, ca.vec(guess), ca.vec(bounds), curvature, rest, near, half, ca.vec(edges))
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 500, "tol": 1e-8}}
    options["ipopt"] |= {"warm_start_init_point": "yes", "mu_init": 1e-2} if not quiet else {}
    solver = ca.nlpsol("nlp", "ipopt", {"x": w, "f": cost, "g": g, "p": p}, options)
    sizes = (free.numel(), 4 * n, moves, 4 * n, len(hard), len(soft), 2 * n)
    return solver, sizes, ca.Function("u", [free, guess], [u * ca.repmat(scale, 1, n)])


def bounds_of(problem, sides, settings):
    """Tightest bounds of each stage by the sides, (N, 6), and where the plan must be able to stop."""
    occupancy = np.clip(problem.occupancy, -FREE, FREE)
    limit = np.full((settings.stages, 6), FREE)
    limit[:, ::2] = -FREE
    for column, side, edge, tighter in ((1, Side.BEHIND, 0, np.minimum), (0, Side.AHEAD, 1, np.maximum)):
        values = np.where(sides == side, occupancy[..., edge], limit[:, [column]])
        limit[:, column] = tighter.reduce(values, axis=1, initial=limit[0, column])
    for column, side, edge, tighter in ((3, Side.LOW, 2, np.minimum), (2, Side.HIGH, 3, np.maximum)):
        values = np.where(sides == side, occupancy[..., edge], limit[:, [column]])
        limit[:, column] = tighter.reduce(values, axis=1, initial=limit[0, column])
    limit[:, 2] = np.maximum(limit[:, 2], np.clip(problem.edges[0], -FREE, FREE))
    limit[:, 3] = np.minimum(limit[:, 3], np.clip(problem.edges[1], -FREE, FREE))
    limit[:, 4], limit[:, 5] = np.clip(problem.corridor[0], -FREE, FREE), np.clip(problem.corridor[1], -FREE, FREE)
    rest = problem.occupancy[-1, :, 0] if problem.rest is None else problem.rest
    ends = np.min(np.where(sides[-1] == Side.BEHIND, rest, FREE), initial=min(problem.stop, FREE))
    return limit, ends


def solve(problem, sides, guess, states, settings, blocked=True, offset=None):
    """IPOPT from the guess: inputs (N, 2), cost, greatest slack, whether it has converged.

    `guess` (N, 2) and `states` (N, 4) are where it starts; `offset` (N, 2) is what the moves are counted from.
    """
    solver, (nf, nx, ns, eq, nh, nsoft, _), to_inputs = program(settings, problem.curvature is not None, blocked)
    offset = guess if offset is None else offset
    n, shift = settings.stages, problem.state[0]
    limit, ends = bounds_of(problem, sides, settings)
    limit[:, :2] -= shift
    curvature = np.zeros(n) if problem.curvature is None else problem.curvature
    state = problem.state - [shift, 0, 0, 0]
    edges = np.empty((n, 2))
    edges[:, 0], edges[:, 1] = problem.edges
    data = [state, offset.ravel(), limit.ravel(), curvature, [ends - shift], problem.proposal, problem.half]
    p = np.concatenate([*data, np.clip(edges, -FREE, FREE).ravel()])
    scale = np.array([0.5 * (settings.acceleration[1] - settings.acceleration[0]), settings.steering])
    first = np.zeros(nf) if blocked else (guess / scale).ravel()
    start = np.concatenate([first, (states - [shift, 0, 0, 0]).ravel(), np.zeros(ns)])
    low = np.concatenate([np.zeros(eq), np.full(nh, min(0.0, state[3])), np.zeros(nsoft)])
    high = np.concatenate([np.zeros(eq), np.full(nh + nsoft, np.inf)])
    box = np.tile(np.array([settings.acceleration[0], -settings.steering]) / scale, n)
    top = np.tile(np.array([settings.acceleration[1], settings.steering]) / scale, n)
    lbx = np.concatenate([np.full(nf + nx, -np.inf), np.zeros(ns)])
    found = solver(x0=start, p=p, lbx=lbx, lbg=np.concatenate([low, box]), ubg=np.concatenate([high, top]))
    x = found["x"].full().ravel()
    free = x[:nf].reshape(-1, 2)
    inputs = to_inputs(free.T, offset.T).full().T
    return inputs, float(found["f"]), float(x[nf + nx :].max()), bool(solver.stats()["success"])
