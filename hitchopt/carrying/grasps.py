"""Holds of an object: which may hold it, which do, with what reserve, and how much they could hold.

``enclose``, ``grasp``, ``fit``, refusals and suggestions all ask ``HoldJudge``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from hitchopt.carrying.hold_search import HoldSearch
from hitchopt.carrying.holding import Capacity, grip_capacity
from hitchopt.carrying.holds import RIM_EDGE, GripHold, HoldingHitch, RestHold, polygon_at
from hitchopt.carrying.planner import BELOW_RIM, GraspState, MovePlanner
from hitchopt.carrying.polygons import (
    EDGE_MARGIN,
    HoldPolygons,
    grip_polygons,
    rest_polygons,
)
from hitchopt.checks.grips import GRIP_LIMIT
from hitchopt.checks.registry import distances_of, names_of
from hitchopt.errors import InfeasibleError, Violation, rounded_up, violations_at
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.planners.candidates import (
    Candidate,
    Effort,
    error_of,
    first_certified,
    if_feasible,
)
from hitchopt.planners.ends import end_of_morph
from hitchopt.planners.fitting import enclosing_polygon, shortest_cable
from hitchopt.planners.task import RestState, StepPlan, require_certified
from hitchopt.values import Array, known
from hitchopt.values.fields import keys_of, with_fields

T = TypeVar("T")

Closing: TypeAlias = tuple[HoldingHitch, ...]
"""Hitches through which one around an object closes, the last of which holds it."""

CLOSING_MARGIN = 1.03
"""Factor of the separation limits as legs close below a rim, since motion reduces distances."""

ROLL_RESERVE = 1.3
"""Factor of the smallest roll of unloaded legs: a load brings legs closer together."""

EVEN_SPLITS = (0.3, 0.35, 0.65, 0.7)
"""Slack splits of all cables of a hold below a rim that are tried before a search over all."""

EVEN_ROLLS = (0.0, 0.15, 0.3)
"""[rad] Rolls of all clasps that are rated with them, as far as smaller ones bear nothing."""

RESERVES = (1.0, 0.5, 0.25)
"""Shares of a carry's acceleration at which holds are judged, the largest first."""

LOAD_LIMITED = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Constraints that only less weight or more capacity satisfies."""

LENGTH_LIMITED = names_of(distances_of("drones", "cables"))
"""Constraints of a loaded hold that longer cables may satisfy, or shorter ones."""

LIGHT = 1e-3  # [kg] Mass with which holds are judged that hold nothing
MASS_RESOLUTION = 0.02  # Resolution of the largest mass that is certified, as a fraction of it
BORNE_RESOLUTION = 0.004  # Resolution of the mass that is borne at rest, as a fraction of it
OVERLOAD = 1.05  # Mass at which the check that binds is found, over the largest that is carried
BISECTIONS = 8  # Maximum number of masses that are certified of a hold
SMALLEST_SHARE = 0.7  # Smallest share of a mass that does not fit that is tried next but one

ASCENTS = (1.25, 1.25, 1.1)
"""Masses with which linear programs search for a hold that bears more, over the largest so far."""

MAX_LOAD_RATIO = 2.5
"""Weight over the sum of all tensions that no hold bears: two vertical legs per cable bear 2."""

NOMINAL_SHARE = 0.5
"""Share of the weight that the tension bears, for which cables are chosen without a stated mass."""

EXTRA_LENGTHS = (0.0, 0.05, 0.15, 0.4)
"""[m] Lengths of cables that are tried, beyond the shortest ones around an object."""

GRIP_ROUNDS = 5  # Maximum number of grips whose polygons around the object need longer cables

PILLAR_HEIGHT = 1.0
"""[m] Height of the pillar on which a flat tray stands whose capacity is computed."""

PILLAR_RADIUS = 0.025  # [m] Radius of that pillar
COMPARED_ROBOTS = range(3, 9)  # Numbers of robots that are tried where the legs of a team cut a rim


class Rated(NamedTuple):
    """A hold and what it bears."""

    mass: float  # About the largest mass [kg] at rest; 0 if none
    hold: HoldingHitch  # The hold


class Heaviest(NamedTuple):
    """The largest mass that is held."""

    capacity: Capacity  # The mass, and the check that binds
    hold: HoldingHitch | None  # What holds it; None if nothing is held


@dataclass(frozen=True, eq=False)
class HoldJudge:
    """The judge of holds of an object that a hitch encloses."""

    # Moves with the object, before it is held: its polygons, and the tension of the hold
    planner: MovePlanner
    around: Hitch  # The hitch around the object

    @classmethod
    def of(
        cls, name: str, team: Team, requirements: Requirements, polygons: HoldPolygons
    ) -> HoldJudge:
        """Return the judge for a team around an object.

        Raises InfeasibleError if the legs of the hitch around it cannot keep the limits.

        Parameters
        ----------
        name: of the object.
        team: with the tension of the hold.
        requirements: limits, distances and objects.
        polygons: clasps around the object, and those that hold it.
        """
        body = requirements.objects[name]
        around = Hitch.spread(
            team,
            polygon_at(body, polygons.around),
            altitude_around(body, requirements.separation),
            limits=requirements.limits,
            separation=requirements.separation,
        )
        planner = MovePlanner(GraspState(name, polygons, team.tension), requirements, 0)
        return cls(planner, around)

    @property
    def name(self) -> str:
        """Name of the object."""
        return self.planner.state.object

    @property
    def team(self) -> Team:
        """The team of the hitch."""
        return self.around.team

    def with_mass(self, mass: float) -> HoldJudge:
        """Return the judge for the object with another mass [kg]."""
        requirements = self.planner.requirements
        heavy = with_fields(self.planner.body, mass=mass)
        objects = {**requirements.objects, self.name: heavy}
        weighted = replace(requirements, objects=objects)
        return replace(self, planner=replace(self.planner, requirements=weighted))

    def with_hold(self, hold: HoldingHitch) -> MovePlanner:
        """Return the planner of moves with a hold."""
        return self.planner.from_state(hold=replace(hold, body=self.planner.body))

    @property
    def closing(self) -> Requirements:
        """Requirements of the hitch below the rim: with a margin, without what cables may touch."""
        requirements = self.planner.requirements
        others = {k: body for k, body in requirements.objects.items() if k != self.name}
        separation = requirements.separation
        wider = {key: CLOSING_MARGIN * getattr(separation, key) for key in keys_of(Separation)}
        separation = replace(separation, **wider)
        return replace(requirements, objects=others, separation=separation)

    @cached_property
    def holds(self) -> tuple[HoldingHitch, ...]:
        """The grip, or the holds by the rim's polygons: those with the nearest legs come first.

        Raises InfeasibleError if legs keep their distances below no polygon.
        """
        return tuple(self._by_polygons())

    def _by_polygons(self) -> Iterator[HoldingHitch]:
        """Yield ``holds``, with the nearest legs, and then with EVEN_SPLITS."""
        body, polygons, n = self.planner.body, self.planner.state.polygons, self.team.robots
        if body.rim is None:
            height = float(body.centre_of_mass[2])
            closed = self.team, body, polygons.clasps, height, np.full(n, 0.5), np.zeros(n)
            yield GripHold(*closed, polygons.around, self.around.fractions)
            return
        nearest = list[RestHold]()
        for clasps in polygons.below_rim:
            below = polygon_at(body, clasps)
            ending = partial(end_of_morph, self.around, below, None, self.closing)
            end = if_feasible("legs", ending, None)
            if end is not None:
                legs = end.hitch.fractions, ROLL_RESERVE * end.hitch.roll
                nearest.append(RestHold(self.team, body, clasps, body.rim.height, *legs))
                yield nearest[-1]
        if not nearest:
            end_of_morph(self.around, polygon_at(body, polygons.clasps), None, self.closing)
        for start, split in product(nearest, EVEN_SPLITS):
            yield replace(start, fractions=np.full(n, split))

    def _search(self, start: RestHold, mass: float) -> HoldSearch:
        """Return the search by linear programs from a hold's polygon, of a mass [kg]."""
        planner, around = self.planner, self.around
        heavy = replace(start, body=with_fields(planner.body, mass=mass))
        polygon = planner.state.polygons.around
        opened = replace(heavy, polygon=polygon, fractions=around.fractions, roll=around.roll)
        return HoldSearch(heavy, opened, planner.state.tension, self.closing, planner.gap)

    def closings(self) -> Iterator[Closing]:
        """Yield the closings of all holds: by polygons, by linear programs, and the heaviest.

        Those that are found by linear programs have other legs, which change first.
        """
        yield from ((hold,) for hold in self._by_polygons())
        body = self.planner.body
        if body.rim is None:
            return
        yield from self._searched(self.planner.state.polygons.below_rim)
        best = self._best
        if isinstance(best.hold, RestHold) and best.mass >= body.mass:
            yield self._search(best.hold, body.mass).changed_legs(best.hold), best.hold

    def _searched(self, polygons: Iterable[Array]) -> Iterator[Closing]:
        """Yield the closings of holds that linear programs find from polygons (n, 2) [m]."""
        for clasps in polygons:
            search = self._search(self._start(clasps), self.planner.body.mass)
            yield from ((search.changed_legs(hold), hold) for hold in search.holds())

    def violation(self, hold: HoldingHitch) -> InfeasibleError | None:
        """Return what a hold breaks at rest, or as it is taken; None if it holds the object."""
        return error_of(partial(require_hold, self.with_hold(hold)))

    def hanging(self, hold: HoldingHitch) -> InfeasibleError | None:
        """Return what a hold breaks with the object off its support; None if nothing."""
        return error_of(partial(require_hanging, self.with_hold(hold)))

    def carried(self, hold: HoldingHitch, share: float) -> InfeasibleError | None:
        """Return what a hold breaks at rest, or at a share of a carry's acceleration; or None.

        Grips are judged at rest.
        """
        planner = self.with_hold(hold)
        if isinstance(hold, GripHold):
            return self.violation(hold)
        return self.violation(hold) or error_of(partial(planner.require_reserve, share))

    def reserve(self, hold: HoldingHitch) -> float:
        """Return the largest share of RESERVES at which a hold can be carried; 0 if none."""
        planner = self.with_hold(hold)
        feasible = (
            share for share in RESERVES if error_of(partial(planner.require_reserve, share)) is None
        )
        return next(feasible, 0.0)

    @cached_property
    def _even(self) -> Rated | None:
        """The grip, or the hold by the rim's polygons with even splits that bears most; or None.

        It is not rolled if one without roll bears anything.
        """
        if self.planner.body.rim is None:
            return self._most_bearing(self.holds)
        rolled = (self._most_bearing(self._with_even_splits(roll)) for roll in EVEN_ROLLS)
        return next(filter(None, rolled), None)

    @cached_property
    def _straight(self) -> Rated:
        """The hold with even splits, or one that linear programs find if none bears anything.

        A grip without friction bears nothing.
        """
        if self._even is not None:
            return self._even
        if self.planner.body.rim is None:
            return Rated(0.0, self.holds[0])
        start = self._start(self.planner.state.polygons.clasps)
        found = self._most_bearing(self._search(start, LIGHT).holds())
        return Rated(0.0, start) if found is None else found

    def _most_bearing(self, holds: Iterable[HoldingHitch]) -> Rated | None:
        """Return the hold that bears most at rest; None if none bears anything."""
        best: Rated | None = None
        for hold in holds:
            mass = self._borne_by(hold, 0.0 if best is None else best.mass)
            if mass:
                best = Rated(mass, hold)
        return best

    def _with_even_splits(self, roll: float) -> Iterator[RestHold]:
        """Yield holds with a roll [rad] by the rim's polygons that keep distances as they close."""
        n = self.team.robots
        for clasps, split in product(self.planner.state.polygons.below_rim, (0.5, *EVEN_SPLITS)):
            start = self._start(clasps)
            hold = replace(start, fractions=np.full(n, split), roll=np.full(n, roll))
            search = self._search(hold, LIGHT)
            if search.changing_legs(hold).closing_margin(hold) >= 0.0:
                yield hold

    def _start(self, clasps: Array) -> RestHold:
        """Return the balanced hold with clasps (n, 2) [m] below the rim."""
        body, n = self.planner.body, self.team.robots
        height = known(body.rim).height
        return RestHold(self.team, body, clasps, height, np.full(n, 0.5), np.zeros(n))

    @cached_property
    def _best(self) -> Rated:
        """The hold that bears most at rest, with those that linear programs find from it."""
        best = self._straight
        for factor in ASCENTS:
            if not isinstance(best.hold, RestHold):
                break
            better = self._search(best.hold, factor * max(best.mass, LIGHT)).improved(best.hold)
            if better is not None and (mass := self._borne_by(better, best.mass)):
                best = Rated(mass, better)
        return best

    def _borne_by(self, hold: HoldingHitch, least: float) -> float:
        """Return about the largest mass [kg] that a hold bears at rest, without a certificate.

        It is 0 if that is not above a ``least`` one.
        """
        team, body = self.team, self.planner.body
        tension = self.planner.state.tension
        if isinstance(hold, GripHold):
            kind = team.quadrotor[0]
            return grip_capacity(hold.grip(tension), kind, body.friction, GRIP_LIMIT).mass
        if not isinstance(hold, RestHold):
            return 0.0

        def is_borne(mass: float) -> bool:
            """Return whether a mass [kg] is borne."""
            closing = self._search(hold, mass)
            separation = self.planner.requirements.separation
            requirements = replace(self.closing, separation=separation)
            search = replace(closing, requirements=requirements)
            return search.at_rest(search.start) >= 0.0

        low, high = least, MAX_LOAD_RATIO * float(np.sum(tension)) / GRAVITY
        if not is_borne(max((1.0 + BORNE_RESOLUTION) * least, LIGHT)):
            return 0.0
        while high - low > BORNE_RESOLUTION * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if is_borne(middle) else (low, middle)
        return low

    @property
    def bearable(self) -> float:
        """About the largest mass [kg] that a hold with even splits bears at rest; 0 if none."""
        return 0.0 if self._even is None else self._even.mass

    def carries(self, mass: float) -> bool:
        """Return whether a hold carries a mass [kg] with the full acceleration."""
        heavy = self.with_mass(mass)
        rated = self._straight if self.bearable >= mass else self._best
        return rated.mass >= mass and heavy.carried(rated.hold, RESERVES[0]) is None

    def candidates(self, plan: Callable[[Closing, float], T]) -> Iterator[Candidate[T]]:
        """Yield all closings as candidates: those without a full reserve last, by their reserves.

        ``plan`` takes a closing and the reserve of its hold, of RESERVES or 0.
        """
        slower = list[tuple[float, Candidate[T]]]()
        for closing in self.closings():
            hold = closing[-1]
            error = self.violation(hold)
            is_only = isinstance(hold, GripHold)
            reserve = RESERVES[0] if error or is_only else self.reserve(hold)
            planned = partial(_planned, plan, closing, reserve, error)
            candidate = Candidate("hold", planned, explained=partial(hold_error, self, hold))
            if reserve == RESERVES[0]:
                yield candidate
            else:
                slower.append((reserve, candidate))
        slower.sort(key=lambda rated: -rated[0])
        yield from (candidate for _, candidate in slower)

    def remark_on(self, reserve: float) -> str:
        """Return a remark on a hold with less than the full reserve, with cables that have it."""
        if reserve == RESERVES[0]:
            return ""
        speed = f"at {reserve:.0%} of the usual acceleration" if reserve else "slowly"
        remark = f"no hold has a reserve: the object is carried {speed}"
        longer = self.longer_cables()
        return remark if longer is None else f"{remark}; cables of {longer:.3g} m would have one"

    def longer_cables(self) -> float | None:
        """Return the length [m] of longer cables with which a hold has a full reserve, or None."""
        planner = self.planner
        longest = float(np.max(self.team.cable_length))
        for extra in EXTRA_LENGTHS[1:]:
            ratio = (longest + extra) / longest
            team = with_fields(
                self.team,
                cable_length=ratio * self.team.cable_length,
                tension=planner.state.tension,
            )
            build = partial(
                HoldJudge.of, self.name, team, planner.requirements, planner.state.polygons
            )
            longer = if_feasible("cables", build, None)
            if longer is not None and longer.carries(planner.body.mass):
                return longest + extra
        return None

    @cached_property
    def heaviest(self) -> Heaviest:
        """The largest mass that a hold carries with the smallest of RESERVES."""
        hold, largest = self._best.hold, self._carried_by(self._best)
        if largest < self._straight.mass and hold is not self._straight.hold:
            straight = self._carried_by(self._straight)
            if straight > largest:
                hold, largest = self._straight.hold, straight
        heavier = self.with_mass(max(OVERLOAD * largest, LIGHT))
        while (better := heavier.searched_hold) is not None:
            hold, largest = better, heavier.planner.body.mass
            heavier = self.with_mass(OVERLOAD * largest)
        error = heavier.carried(hold, RESERVES[-1])
        binding = "load" if error is None else error.violations[0].constraint
        return Heaviest(Capacity(largest, binding), hold if largest else None)

    @property
    def searched_hold(self) -> HoldingHitch | None:
        """The first hold that programs find from the preferred polygon and that carries the object.

        It has the smallest of RESERVES. None without one.
        """
        if self.planner.body.rim is None:
            return None
        closings = self._searched([self.planner.state.polygons.clasps])
        holds = (closing[-1] for closing in closings)
        return next((each for each in holds if self.carried(each, RESERVES[-1]) is None), None)

    def _carried_by(self, rated: Rated) -> float:
        """Return the largest mass [kg] that a hold carries with the smallest of RESERVES.

        It is about what it bears at rest, or less, by bisection.
        """
        high = max(rated.mass, LIGHT)
        low, trial = 0.0, high
        for _ in range(BISECTIONS):
            if self.with_mass(trial).carried(rated.hold, RESERVES[-1]) is None:
                low = trial
            else:
                high = trial
            if high - low <= MASS_RESOLUTION * high:
                break
            trial = 0.5 * (max(low, SMALLEST_SHARE * high) + high)
        return low


def _planned(
    plan: Callable[[Closing, float], T],
    closing: Closing,
    reserve: float,
    error: InfeasibleError | None,
) -> T:
    """Return the plan of a closing, or raise what its hold breaks."""
    if error is not None:
        raise error
    return plan(closing, reserve)


def altitude_around(body: SolidObject, separation: Separation) -> float:
    """Return the altitude [m] of a hitch around an object: below its rim, or at its middle."""
    if body.rim is None:
        return float(body.at[2] + body.centre_of_mass[2])
    return float(body.at[2]) + body.rim.height - (separation.object + BELOW_RIM)


def require_hanging(planner: MovePlanner) -> None:
    """Raise InfeasibleError if the hold breaks limits at rest, with the object off its support."""
    hold = planner.hold
    name = planner.state.object
    when = f"with objects.{name} off its support"
    with violations_at(when, object=name):
        if isinstance(hold, RestHold):
            hold.check_unbent(planner.state.tension)
            violation = hold.rim_violation(planner.state.tension)
            if violation is not None:
                raise InfeasibleError([violation])
        lifted = planner.from_state(carried=True)
        at_rest = lifted.motion([lifted.rest(1.0)], "hold")
        require_certified(_step_plan(at_rest), when)


def require_hold(planner: MovePlanner) -> None:
    """Raise InfeasibleError if the hold breaks limits at rest, or as the hitch rises to a rim."""
    require_hanging(planner)
    if isinstance(planner.hold, RestHold):
        name = planner.state.object
        when = f"as the clasps take objects.{name}"
        with violations_at(when, object=name):
            moves = [planner.rim_move(planner.gap, 0.0), planner.transfer(0.0, 1.0)]
            require_certified(_step_plan(planner.motion(moves, "lift")), when)


def _step_plan(motion: Motion) -> StepPlan:
    """Return a motion as a plan, to be certified."""
    return StepPlan(motion, RestState(motion.team, motion.drones.at(motion.duration)))


def hold_error(judge: HoldJudge, hold: HoldingHitch, error: InfeasibleError) -> InfeasibleError:
    """Return the error of a hold, with the largest mass of all holds and what helps."""
    planner = judge.planner
    key = f"objects.{judge.name}"
    mass = planner.body.mass
    capacity = judge.heaviest.capacity
    remedies = list[str]()
    if 0.0 < capacity.mass < mass:
        remedies.append(f"lower {key}.mass")
    stated = f" (a {'rim' if hold.by is HoldBy.REST else 'grip'} holds {capacity.mass:.2g} kg)"
    if hold.by is HoldBy.REST:
        longer = judge.longer_cables()
        if longer is not None:
            remedies.append(f"use cables of {longer:.3g} m")
        if any(RIM_EDGE in violation.where for violation in error.violations):
            remedies += filter(None, [_other_robots(judge)])
    else:
        if capacity.binding == "grip":
            remedies.append("use rougher cables")
        rim_mass = _rim_mass(judge)
        if rim_mass >= mass:
            remedies.append("add a rim")
        if rim_mass:
            stated = stated.replace(")", f", a rim {rim_mass:.2g} kg)")
    held = stated if capacity.mass else ""
    remedy = f"{', or '.join(remedies)}{held}".strip()
    violations = list[Violation]()
    if 0.0 < capacity.mass < mass:
        load = Violation(
            "load", mass, capacity.mass, "max", "kg", (judge.name,), "", remedy, object=judge.name
        )
        first = error.violations[0]
        violations.append(replace(load, when=first.when, steps=first.steps, reason=first.reason))
    for violation in error.violations:
        others = [remedy]
        if violation.constraint == "tilt":
            others.append("raise limits.tilt_deg")
        is_beside = violation.constraint == "keep_out" and judge.name in violation.where
        if not is_beside and violation.constraint not in LOAD_LIMITED | LENGTH_LIMITED:
            others.append(violation.remedy)
        violations.append(replace(violation, remedy=", or ".join(filter(None, others))))
    return InfeasibleError(violations)


def _other_robots(judge: HoldJudge) -> str:
    """Return the number of robots to use where legs cut a rim; empty if none holds it."""
    other = team_for_rim(judge)
    if other is None:
        return ""
    cables = ""
    cable_length = float(np.min(other.cable_length))
    if cable_length > float(np.min(judge.team.cable_length)):
        cables = f" with cables of {rounded_up(cable_length, 3):.3g} m or more"
    return f"use {other.robots} robots{cables}, whose legs stay below the rim"


def hold_polygons(
    name: str, team: Team, requirements: Requirements, by: HoldBy, gap: float
) -> HoldPolygons:
    """Return the preferred polygons of a method, which ``enclose`` tries first.

    Raises InfeasibleError if no polygon holds the object.

    Parameters
    ----------
    name: of the object in the requirements, with a rim if it is to rest.
    team: its drones and cables.
    requirements: limits, distances and objects.
    by: method of holding.
    gap: of edges around the object [m].
    """
    body = requirements.objects[name]
    if by is HoldBy.GRIP:
        return grip_polygons(name, body, team, requirements, gap)
    return rest_polygons(name, body, team.robots, gap)[0]


def shortest_judge(
    name: str, team: Team, requirements: Requirements, by: HoldBy, gap: float, mass: float | None
) -> HoldJudge:
    """Return the judge with the shortest cables that keep drones apart and carry an object.

    If none of EXTRA_LENGTHS carries it, they bear most. Raises InfeasibleError if no polygon holds
    the object, or no length keeps drones apart around it.

    Parameters
    ----------
    name, by, gap: as of ``hold_polygons``.
    team: with the tension of the hold; its cables' length does not matter.
    requirements: limits, distances and the object.
    mass: [kg] to be carried; None for NOMINAL_SHARE of what the tension bears.
    """

    def sized(cable_length: float) -> Team:
        """Return the team with cables of a length [m]."""
        return with_fields(team, cable_length=np.full(team.robots, round(cable_length, 2)))

    def shortest_around(polygons: HoldPolygons) -> float:
        """Return the length [m] of the shortest cables around the object."""
        return shortest_cable([ConvexPolygon(polygons.around)], requirements, team)

    def gripping(extra: float) -> HoldJudge:
        """Return the grip of cables that are longer by ``extra`` [m], or as long as it needs."""
        section = requirements.objects[name].section
        enclosing = enclosing_polygon(section, team.robots, gap)
        cable_length = shortest_cable([enclosing], requirements, team) + extra
        for _ in range(GRIP_ROUNDS):  # grips of longer cables are wider
            polygons = hold_polygons(name, sized(cable_length), requirements, by, gap)
            needed = shortest_around(polygons)
            if needed <= cable_length:
                break
            cable_length = needed
        return HoldJudge.of(name, sized(cable_length), requirements, polygons)

    if by is HoldBy.GRIP:
        grips = (Candidate("cable length", partial(gripping, extra)) for extra in EXTRA_LENGTHS)
        return first_certified(grips, Effort())
    straight = 2.0 * float(np.sum(team.tension)) * math.cos(math.pi / team.robots) / GRAVITY
    needed = NOMINAL_SHARE * straight if mass is None else mass
    polygons = hold_polygons(name, team, requirements, by, gap)
    shortest = shortest_around(polygons)
    judges = list[HoldJudge]()
    for extra in EXTRA_LENGTHS:
        judges.append(HoldJudge.of(name, sized(shortest + extra), requirements, polygons))
        if judges[-1].bearable >= needed and judges[-1].carries(needed):
            return judges[-1]
    return max(reversed(judges), key=lambda judge: judge.bearable)


def team_for_rim(judge: HoldJudge) -> Team | None:
    """Return a team of another size that carries an object by its rim; None without one.

    Its size is the nearest to that of the team that does not. Cables are as long as that team's, or
    as long as its drones require around the object.
    """
    planner = judge.planner
    team = judge.team

    def carrying(robots: int) -> Team | None:
        """Return the team of a size if it carries the object."""
        cable_length = float(np.min(team.cable_length))
        alike: dict[str, Any] = {
            "cable_density": team.cable_density,
            "cable_friction": team.cable_friction,
            "tension": float(np.min(planner.state.tension)),
            "quadrotor": team.quadrotor[0],
        }
        polygons = rest_polygons(judge.name, planner.body, robots, planner.gap)[0]
        outlines = [ConvexPolygon(polygons.around), ConvexPolygon(polygons.clasps)]
        shortest = shortest_cable(outlines, planner.requirements, Team(robots, 1.0, **alike))
        other = Team(robots, max(cable_length, shortest), **alike)
        others = HoldJudge.of(judge.name, other, planner.requirements, polygons)
        return other if others.carries(planner.body.mass) else None

    sizes = [robots for robots in COMPARED_ROBOTS if robots != team.robots]
    nearest_first = sorted(sizes, key=lambda robots: (abs(robots - team.robots), robots))
    teams = (if_feasible("team", partial(carrying, n), None) for n in nearest_first)
    return next(filter(None, teams), None)


def _rim_mass(judge: HoldJudge) -> float:
    """Return the largest mass [kg] on a gripped object's section as a rim; 0 if none is held."""
    planner = judge.planner
    body = planner.body
    tray = with_fields(body, rim=Rim(body.section, body.lower))
    requirements = replace(planner.requirements, objects=on_pillar(judge.name, tray))
    tensioned = with_fields(judge.team, tension=planner.state.tension)

    def mass() -> float:
        """Return the largest mass that rests on the rim."""
        gap = requirements.separation.object + EDGE_MARGIN
        polygons = hold_polygons(judge.name, tensioned, requirements, HoldBy.REST, gap)
        resting = HoldJudge.of(judge.name, tensioned, requirements, polygons)
        return resting.heaviest.capacity.mass

    return if_feasible("rim", mass, 0.0)


def on_pillar(name: str, tray: SolidObject) -> dict[str, SolidObject]:
    """Return objects by name: a flat tray that stands on a slim pillar at the origin."""
    centre = np.append(tray.section.centroid, 0.0)
    pillar = SolidObject(Section(radius=PILLAR_RADIUS), 0.0, PILLAR_HEIGHT, at=centre, fixed=True)
    standing = tray.moved_to(np.array([0.0, 0.0, PILLAR_HEIGHT - tray.lower, 0.0]))
    return {name: standing, "pillar": pillar}
