"""The assumptions about other vehicles, as data.

A certificate holds for every behaviour within these bounds, and for none outside. `dynamics.traffic.rules_of_the_road`
checks whether the motion of a vehicle in a frame was within them. `Assumptions.rss()` has the worst-case constants of
Responsibility-Sensitive Safety, `Assumptions.idm()` those of highway-env's traffic.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite

from dynamics.deprecation import accept_former_fields, warn_of_former_name
from dynamics.errors import ConfigError

__all__ = ["FORMER_ASSUMPTIONS", "Assumptions", "present_profile"]

FORMER_ASSUMPTIONS = {
    "calm_braking": "comfortable_braking",
    "turning_burst": "turning_action_in_one_second",
    "lean": "marking_tolerance",
    "waver": "lateral_deviation",
    "blind_merge": "simultaneous_merge",
    "slip_in": "cut_in",
    "looks_ahead": "considers_connected_lanes",
}
"""Present names of fields of `Assumptions`, by the former name."""


def present_profile(name: str) -> str:
    """The present name of a profile of assumptions or of settings; the former name "exact" warns."""
    if name != "exact":
        return name
    warn_of_former_name('the profile "exact"', 'write "simulated"', stacklevel=4)
    return "simulated"


@accept_former_fields(FORMER_ASSUMPTIONS)
@dataclass(frozen=True, slots=True)
class Assumptions:
    """Bounds on the behaviour of the other vehicles.

    Attributes
    ----------
    braking : greatest deceleration of any vehicle [m/s^2].
    comfortable_braking : greatest deceleration of a vehicle that needs no more for the vehicles ahead, by IDM and MOBIL
        (`dynamics.traffic.reaction`) [m/s^2]. It may brake harder where the ego's fail-safe keeps its room. If equal to
        `braking`, every vehicle may brake at `braking` at any time.
    acceleration : greatest acceleration of any vehicle [m/s^2].
    power : greatest product of acceleration and speed [m^2/s^3]; it limits the acceleration of a fast vehicle.
    max_speed : greatest speed that a slower vehicle accelerates to [m/s]. A faster vehicle keeps its speed or slows
        down.
    min_speed : speed below which a moving vehicle does not brake on purpose [m/s]; with 0 it may stop.
    turning_loss : distance along the road that a car may lose by turning, at more than `slow_speed` [m]. A lane change
        of highway-env's traffic costs 0.3 m at 25 m/s, 0.8 m at 10 m/s and 1.4 m at 6 m/s.
    turning_action : greatest speed times distance that it may lose by turning [m^2/s]: half the square of the lateral
        speed, integrated over time. So a fast vehicle loses less distance.
    turning_loss_back, turning_action_back : rates at which these two allowances recover [m/s], [m^2/s^2].
    turning_action_in_one_second : greatest speed times distance that it may lose within any second [m^2/s]. This
        covers one lane change, but not two; those of highway-env's cars reach at most 10.2.
    slow_speed : speed below which no progress of a vehicle is assumed [m/s].
    reversing_speed : greatest speed backwards [m/s]; 0 if no vehicle reverses.
    queue_distance, queue_speed : a vehicle reverses only behind a vehicle in its lanes that is nearer than
        `queue_distance`, centre to centre [m], and slower than `queue_speed` [m/s]. Otherwise a reversing vehicle comes
        to rest within `runout_time`.
    runout_time : time within which a reversing vehicle comes to rest, where nothing ahead makes it reverse [s].
    marking_tolerance : how far a body may reach over a lane marking before it counts as in the next lane as well [m].
    lateral_deviation : greatest lateral deviation of a body from the centre of its lane, while it keeps to the centre
        [m].
    bend_acceleration : lateral acceleration up to which vehicles take the bends of a road [m/s^2]. A faster vehicle
        violates a rule only where the ego's fail-safe loses its room.
    follower_braking : least deceleration of a follower behind an ego that has entered its lane [m/s^2].
    reaction_time : time until the follower brakes [s], counted from when the ego is visible in its lane.
    visible_distance : distance from a lane's centre within which a vehicle counts as in the lane [m].
    settle_time : for this long after the ego became visible in a lane, a vehicle alongside that already turns towards
        the lane may still enter it [s].
    simultaneous_merge : whether a vehicle beside the lane that the ego is about to enter may enter it as well, while
        the ego is not visible there. It does so if it gains (`dynamics.traffic.mobil`) or is on its way.
    cut_in : whether a vehicle alongside may cut in behind an ego that pulls away from it, or before an ego from which
        it pulls away. MOBIL permits that once IDM's desired gap is zero (`shield.certificate.road.clauses.cut_in`).
    considers_connected_lanes : on road networks, whether vehicles behind the ego consider vehicles beyond the end of
        their own lane. highway-env's traffic does so only if its road is configured to.
    gives_way : on road networks, whether a vehicle with less right of way than the ego waits for it
        (`dynamics.road_networks.reachable.rights`). highway-env's traffic does not always.
    simulated : whether the other vehicles are highway-env's own traffic, which is simulated; then none of the bounds
        above is used. See `simulated_traffic`.
    """

    braking: float = 6.0
    comfortable_braking: float = 3.0
    acceleration: float = 6.0
    power: float = 75.0
    max_speed: float = 40.0
    min_speed: float = 0.0
    turning_loss: float = 1.2
    turning_action: float = 7.0
    turning_loss_back: float = 0.5
    turning_action_back: float = 6.0
    turning_action_in_one_second: float = 11.5
    slow_speed: float = 4.0
    reversing_speed: float = 6.0
    queue_distance: float = 14.0
    queue_speed: float = 8.0
    runout_time: float = 1.25
    marking_tolerance: float = 0.15
    lateral_deviation: float = 0.25
    bend_acceleration: float = 10.0
    follower_braking: float = 6.0
    reaction_time: float = 0.2
    visible_distance: float = 3.0
    settle_time: float = 2.0
    simultaneous_merge: bool = True
    cut_in: bool = True
    considers_connected_lanes: bool = False
    gives_way: bool = False
    simulated: bool = False

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name in ("simultaneous_merge", "cut_in", "considers_connected_lanes", "gives_way", "simulated"):
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
        """highway-env's IDM and MOBIL traffic: |a| <= 6 m/s^2, reaction within 0.2 s, lane changes with an
        incentive."""
        return cls()

    @classmethod
    def rss(cls) -> Assumptions:
        """Worst case: leaders brake at 8 m/s^2, followers brake at 4 m/s^2 after 1 s.

        Source: Shalev-Shwartz et al. 2017, with the constants customary on motorways.
        """
        return cls(
            braking=8.0,
            comfortable_braking=8.0,
            max_speed=45.0,
            follower_braking=4.0,
            reaction_time=1.0,
            considers_connected_lanes=True,
        )

    @classmethod
    def moderate(cls) -> Assumptions:
        """Traffic with leaders that brake at no more than 3 m/s^2: the default of `Shield` over its horizon of some
        seconds.

        An ego that cannot go below 20 m/s has no plan against a leader that may stop, so the worst case would refuse
        every plan. highway-env's traffic seldom brakes harder; the monitor counts each time that it does.
        """
        return cls(braking=3.0)

    @classmethod
    def roads(cls) -> Assumptions:
        """highway-env's IDM traffic on road networks. It accelerates at no more than 3 m/s^2, up to the speed limit of
        its lanes, and does not yield to crossing or joining vehicles."""
        return cls(acceleration=3.0, max_speed=30.0, lateral_deviation=0.6)

    @classmethod
    def simulated_traffic(cls) -> Assumptions:
        """The others drive as highway-env's traffic does, to the bit; plans are verified by simulating it.

        The guarantee holds for no other traffic. Traffic of an unknown class is refused. See
        `shield.certificate.simulated`.
        """
        return cls(simulated=True)

    @classmethod
    def exact(cls) -> Assumptions:
        """The former name of `simulated_traffic`."""
        warn_of_former_name("Assumptions.exact()", "write Assumptions.simulated_traffic()")
        return cls.simulated_traffic()

    @classmethod
    def profile(cls, name: str) -> Assumptions:
        """A profile by name: "idm", "roads", "moderate", "rss" or "simulated".

        Raises
        ------
        ConfigError
            If the name is unknown.
        """
        profiles = {
            "idm": cls.idm,
            "roads": cls.roads,
            "moderate": cls.moderate,
            "rss": cls.rss,
            "simulated": cls.simulated_traffic,
        }
        name = present_profile(name)
        if name not in profiles:
            raise ConfigError(f"unknown assumptions {name!r}; valid are {', '.join(map(repr, profiles))}")
        return profiles[name]()
