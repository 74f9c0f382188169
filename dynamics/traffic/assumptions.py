"""What the shield assumes of the other road users, as data.

A certificate holds for every behaviour inside these bounds, and for none outside; `dynamics.traffic.rules_of_the_road`
says of what a vehicle did in a frame whether it was inside. `Assumptions.rss()` takes the worst-case constants of
Responsibility-Sensitive Safety, `Assumptions.idm()` those of highway-env's traffic.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite

from dynamics.errors import ConfigError

__all__ = ["Assumptions"]


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Bounds on the behaviour of the other vehicles.

    Attributes
    ----------
    braking : greatest deceleration of any vehicle [m/s^2].
    calm_braking : greatest deceleration of one whom nothing ahead asks for more (`dynamics.traffic.reaction`), as IDM
        and MOBIL would have it [m/s^2]. It may brake harder where that leaves the room for the ego's fail-safe. With
        `braking` itself, everybody may brake as hard as can be at any time.
    acceleration : greatest acceleration of any vehicle [m/s^2].
    power : the same for one that is fast already: no more than `power` / speed [m^2/s^3].
    max_speed : greatest speed that a slower vehicle accelerates to [m/s]; one that is faster keeps its speed or slows.
    min_speed : speed below which a moving vehicle does not brake on purpose [m/s]; 0 lets it stop.
    turning_loss : way along the road that a car may lose by turning, at more than `slow_speed` [m]. A lane change of
        highway-env's traffic costs 0.3 m at 25 m/s, 0.8 m at 10 m/s and 1.4 m at 6 m/s.
    turning_action : speed times way that it may lose by turning [m^2/s]: half the square of the speed across the road,
        over time. So one that is fast loses less.
    turning_loss_back, turning_action_back : how fast they come back [m/s], [m^2/s^2].
    turning_burst : speed times way that it may lose within any second [m^2/s]: one lane change, and not two; those of
        highway-env's cars come to 10.2 at most.
    slow_speed : speed below which nobody is counted on to get anywhere [m/s].
    reversing_speed : greatest speed backwards [m/s]; 0 where nobody reverses.
    queue_distance, queue_speed : a vehicle reverses only from one ahead in its lanes that is nearer than this, centre
        to centre [m], and slower [m/s], or comes to rest within `runout_time` [s].
    lean : how far a body may reach over a lane marking before it counts as being in the next lane as well [m].
    waver : how far out of the middle of its lane the body of a vehicle comes that keeps to the middle [m].
    follower_braking : deceleration that a follower owes to an ego that has entered its lane [m/s^2].
    reaction_time : time after which the follower does so [s], counted from when the ego is visible in its lane.
    visible_distance : distance from a lane's centre within which a vehicle counts as being in it [m].
    settle_time : for so long after the ego has come into sight in a lane, a vehicle beside it that is already turning
        towards it may still come in [s].
    blind_merge : whether a vehicle beside the lane that the ego is about to enter may enter it as well, as long as
        the ego is not visible there: one that gains by it (`dynamics.traffic.mobil`), or is on its way.
    slip_in : whether a vehicle alongside may change into the ego's lane behind an ego that pulls away from it, or
        before one that it pulls away from, as MOBIL does once IDM's desired gap has vanished
        (`shield.certificate.road.clauses.cut_in`).
    looks_ahead : on road networks, whether those behind look beyond the end of their own lane; highway-env's traffic
        does not, but where its road is told to.
    gives_way : on road networks, whether whoever has less right of way than the ego waits for it
        (`dynamics.road_networks.reachable.rights`); highway-env's traffic does not always.
    simulated : whether the others are highway-env's own and are simulated, so that nothing above is asked; see `exact`.
    """

    braking: float = 6.0
    calm_braking: float = 3.0
    acceleration: float = 6.0
    power: float = 75.0
    max_speed: float = 40.0
    min_speed: float = 0.0
    turning_loss: float = 1.2
    turning_action: float = 7.0
    turning_loss_back: float = 0.5
    turning_action_back: float = 6.0
    turning_burst: float = 11.5
    slow_speed: float = 4.0
    reversing_speed: float = 6.0
    queue_distance: float = 14.0
    queue_speed: float = 8.0
    runout_time: float = 1.25
    lean: float = 0.15
    waver: float = 0.25
    follower_braking: float = 6.0
    reaction_time: float = 0.2
    visible_distance: float = 3.0
    settle_time: float = 2.0
    blind_merge: bool = True
    slip_in: bool = True
    looks_ahead: bool = False
    gives_way: bool = False
    simulated: bool = False

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name in ("blind_merge", "slip_in", "looks_ahead", "gives_way", "simulated"):
                if not isinstance(value, bool):
                    raise ConfigError(f"Assumptions.{f.name} must be true or false, got {value!r}")
            elif isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
                raise ConfigError(f"Assumptions.{f.name} must be a finite number, got {value!r}")
            elif value < 0:
                raise ConfigError(f"Assumptions.{f.name} must be at least 0, got {value}")
        if self.follower_braking <= 0 or self.braking <= 0:
            raise ConfigError("Assumptions.braking and follower_braking must be above 0 m/s^2")
        if self.max_speed < self.min_speed:
            raise ConfigError(f"Assumptions.max_speed ({self.max_speed}) is below min_speed ({self.min_speed})")

    @classmethod
    def idm(cls) -> Assumptions:
        """highway-env's IDM and MOBIL traffic: |a| <= 6 m/s^2, a quick reaction, lane changes that pay."""
        return cls()

    @classmethod
    def rss(cls) -> Assumptions:
        """Worst case: leaders brake at 8 m/s^2, followers answer after 1 s with 4 m/s^2.

        Source: Shalev-Shwartz et al. 2017, with the constants customary on motorways.
        """
        return cls(
            braking=8.0,
            calm_braking=8.0,
            max_speed=45.0,
            follower_braking=4.0,
            reaction_time=1.0,
            looks_ahead=True,
        )

    @classmethod
    def moderate(cls) -> Assumptions:
        """Traffic whose leaders do not brake harder than 3 m/s^2: what `Shield` assumes over its seconds of look-ahead.

        An ego that cannot go below 20 m/s has no plan against a leader that may stop, so that the worst case would
        leave it without any. highway-env's traffic seldom brakes harder; the monitor counts each time that it does.
        """
        return cls(braking=3.0)

    @classmethod
    def roads(cls) -> Assumptions:
        """highway-env's IDM traffic on road networks: it accelerates at 3 m/s^2 at most, up to the limit of its lanes,
        and yields to nobody who crosses or joins."""
        return cls(acceleration=3.0, max_speed=30.0, waver=0.6)

    @classmethod
    def exact(cls) -> Assumptions:
        """The others do what highway-env's traffic does, to the bit: verification is by simulation of it.

        What it promises carries over to no other traffic, and it is refused where the traffic is not of a class that
        is known. See `shield.certificate.simulated`.
        """
        return cls(simulated=True)

    @classmethod
    def profile(cls, name: str) -> Assumptions:
        """A profile by name: "idm", "roads", "moderate", "rss" or "exact"."""
        profiles = {"idm": cls.idm, "roads": cls.roads, "moderate": cls.moderate, "rss": cls.rss, "exact": cls.exact}
        if name not in profiles:
            raise ConfigError(f"unknown assumptions {name!r}; valid are {', '.join(map(repr, profiles))}")
        return profiles[name]()
