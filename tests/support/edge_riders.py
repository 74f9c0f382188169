"""Drivers that deviate as far as the monitor lets them: each halves what it wants until nobody is named.

What a driver wants for the coming frame is tried on the monitor itself: the frame is computed ahead for all vehicles,
and each that would be named comes halfway back to keeping its lane and its speed. So they ride along the edge of every
rule.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from attack_drivers import steer
from driven_traffic import LANE, body_of
from highway_env.vehicle.behavior import AggressiveVehicle, IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from dynamics.scenes.scene import Scene
from dynamics.state import FloatArray
from shield import ShieldedEnv
from shield.certificate.road.memory import observe
from shield.pipelines.inputs import InputPipeline

__all__ = ["EdgeRider", "Skidder", "Stage", "ride"]

_HELD = 0.1, 1.2
"""For how long a driver wants the same [s]."""
_HALVINGS = 7
_APART = 9.0
"""Two in one lane start no nearer than this, centre to centre [m]."""
_AROUND = -70.0, 90.0
"""Where they start, from the ego [m]."""


class EdgeRider(Vehicle):  # type: ignore[misc]
    """Wants anything."""

    def take(self, rng: np.random.Generator, ego: Any, dt: float, lanes: int) -> None:
        """Be driven by these numbers around this ego, on so many lanes, in frames of so long [s]."""
        self.rng, self.ego, self.dt, self.lanes, self.left = rng, ego, dt, lanes, 0.0
        self.wanted = self.calm = np.zeros(2)
        self.push, self.place, self.haste = 0.0, float(self.position[1]), 0.1

    def act(self, action: Any = None) -> None:
        """Say what it wants, `wanted`, and how it would keep lane and speed, `calm`: acceleration and wheel (2,)."""
        if self.left <= 0:
            self._choose()
        self.left -= self.dt
        own = body_of(self)
        lane = LANE * float(np.clip(round(own.r / LANE), 0, self.lanes - 1))
        a = max(self.push, -(self.speed + 6.0) / self.dt) if self.push < 0 else self.push
        if self.push < -6.5:  # to a stop, and no further
            a = max(-6.0, -self.speed / self.dt)
        self.wanted = np.array([a, float(np.clip(steer(own, self.place, self.haste), -0.8, 0.8))])
        self.calm = np.array([0.0, float(np.clip(steer(own, lane, 0.05), -0.8, 0.8))])
        self.do(self.wanted)

    def do(self, inputs: FloatArray) -> None:
        """Be driven so in the coming frame."""
        Vehicle.act(self, {"acceleration": float(inputs[0]), "steering": float(inputs[1])})

    def _choose(self) -> None:
        rng, ego = self.rng, self.ego
        self.left = float(rng.uniform(*_HELD))
        self.push = float(rng.choice([-7.0, -6.0, -3.0, 0.0, 2.0, 6.0, rng.uniform(-8, 8)]))
        self.haste = float(rng.choice([0.05, 0.15, 0.4]))
        habit, edge = rng.random(), LANE * (self.lanes - 1)
        if habit < 0.35:
            self.place = float(np.clip(ego.position[1] + rng.uniform(-1, 1), 0, edge))
        elif habit < 0.7:
            self.place = float(np.clip(self.position[1] + rng.choice([-LANE, LANE]), 0, edge))
        elif habit < 0.85:
            self.place = float(rng.uniform(-0.5, edge + 0.5))
        else:
            self.place = LANE * float(np.clip(round(self.position[1] / LANE), 0, self.lanes - 1))


class Skidder(EdgeRider):
    """Slides along the road, and is turned anyhow meanwhile."""

    def act(self, action: Any = None) -> None:
        """Say what it wants: acceleration and heading, (2,)."""
        if self.left <= 0:
            self._choose()
            self.turned = float(self.rng.choice([0.0, 0.0, 0.5, 1.0, 0.5 * np.pi]) * self.rng.choice([-1, 1]))
        self.left -= self.dt
        self.wanted = np.array([max(self.push, -max(self.speed, 0.0) / self.dt), self.turned])
        self.calm = np.zeros(2)
        self.do(self.wanted)

    def do(self, inputs: FloatArray) -> None:
        """Be moved so in the coming frame."""
        self.planned = inputs
        self.action = {"acceleration": float(inputs[0]), "steering": 0.0}

    def after(self) -> FloatArray:
        """Where it is a frame later: x, y, heading and speed."""
        along = self.speed * self.dt
        aside = float(np.clip(self.haste * (self.place - self.position[1]), -abs(along), abs(along)))
        aside = float(np.clip(aside, -0.3, 0.3)) if self.planned[1] else 0.0
        change = np.array([along, aside, self.planned[1] - self.heading, self.planned[0] * self.dt])
        return np.array([*self.position, self.heading, self.speed]) + change

    def step(self, dt: float) -> None:
        """Move as planned."""
        x, y, self.heading, self.speed = self.after().tolist()
        self.position = np.array([x, y])
        self.on_state_update()


class Stage:
    """Has every frame of the riders tried on the monitor before it is driven."""

    def __init__(self, env: ShieldedEnv, riders: list[EdgeRider]) -> None:
        self._env, self._riders, self._base = env, riders, env.unwrapped
        self._road = self._base.road
        self._act, self._road.act = self._road.act, self._try

    def _try(self) -> None:
        self._act()
        bodies = [v for v in self._road.vehicles if v is not self._base.vehicle]
        which = np.array([bodies.index(rider) for rider in self._riders if not rider.crashed], np.intp)
        riders = [bodies[i] for i in which]
        core = self._env.core
        scene: Scene = core.memory.verifier.scene  # of this very frame: the ego has acted
        inputs = core.procedure.execution.frames if isinstance(core.procedure, InputPipeline) else 1
        share, calm = np.ones(len(riders)), np.stack([r.calm for r in riders]) if riders else np.zeros((0, 2))
        for attempt in range(2 * _HALVINGS):
            for rider, part, kept in zip(riders, share, calm, strict=True):
                rider.do(kept + part * (rider.wanted - kept))
            watch: Any = observe(core.memory, self._ahead(scene), core.procedure.config, inputs).memory.watch
            named = watch.breaking[which] if len(watch.breaking) else np.zeros(len(riders), bool)
            if not named.any():
                return
            share[named] = 0.5 * share[named] if attempt % _HALVINGS < _HALVINGS - 2 else 0.0
            if attempt == _HALVINGS:  # keeping the speed is not enough
                for i in np.flatnonzero(named):
                    calm[i, 0] = -min(6.0, max(riders[i].speed, 0.0) / scene.dt)

    def _ahead(self, scene: Scene) -> Scene:
        """The scene a frame later, as highway-env computes it where nothing crashes."""
        ego, others = self._base.vehicle, [v for v in self._road.vehicles if v is not self._base.vehicle]
        rows = np.vstack([scene.ego[None], scene.others])
        for row, body in zip(rows, [ego, *others], strict=False):
            if isinstance(body, Skidder):
                row[:4] = body.after()
                continue
            a, wheel = float(body.action["acceleration"]), float(body.action["steering"])
            if body.crashed:
                a, wheel = -body.speed, 0.0
            if body.speed > body.MAX_SPEED:
                a = min(a, body.MAX_SPEED - body.speed)
            elif body.speed < body.MIN_SPEED:
                a = max(a, body.MIN_SPEED - body.speed)
            slip = np.arctan(0.5 * np.tan(wheel))
            row[0] += body.speed * np.cos(body.heading + slip) * scene.dt
            row[1] += body.speed * np.sin(body.heading + slip) * scene.dt
            row[2] += body.speed * np.sin(slip) / (body.LENGTH / 2) * scene.dt
            row[3] += a * scene.dt
        return replace(scene, ego=rows[0], others=rows[1:], frame=(scene.frame or 0) + 1)


def ride(env: ShieldedEnv, seed: int, vehicles: int = 8, kind: type[EdgeRider] = EdgeRider) -> None:
    """Put so many vehicles around the ego in the place of whoever is there: edge riders, and every fourth highway-env's
    own. Skidders start anywhere across their lanes."""
    base: Any = env.unwrapped
    ego, road, rng = base.vehicle, base.road, np.random.default_rng([seed, 7])
    lanes, dt = base.config["lanes_count"], 1 / base.config["simulation_frequency"]
    placed, riders = [(ego.lane_index[2], 0.0, float(ego.speed))], []
    road.vehicles = [ego]
    for k in range(40 * vehicles):
        lane, off, speed = int(rng.integers(lanes)), float(rng.uniform(*_AROUND)), float(ego.speed + rng.normal(0, 4))
        near = [(s - off, v) for line, s, v in placed if line == lane]
        if any(abs(d) < _APART + 1.5 * max(speed - v if d > 0 else v - speed, 0.0) for d, v in near):
            continue
        place = [float(ego.position[0]) + off, LANE * lane]
        body: Any
        if len(placed) % 4 == 0:
            body = (IDMVehicle, AggressiveVehicle)[k % 2](road, place, 0.0, speed, target_speed=speed)
        else:
            if kind is Skidder:
                place[1] += float(rng.uniform(-1.9, 1.9))
            body = kind(road, place, 0.0, max(speed, 0.0) if kind is Skidder else speed)
            body.take(np.random.default_rng([seed, k]), ego, dt, lanes)
            riders.append(body)
        body.check_collisions = False
        road.vehicles.append(body)
        placed.append((lane, off, speed))
        if len(placed) > vehicles:
            break
    Stage(env, riders)
