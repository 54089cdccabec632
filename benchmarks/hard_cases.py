"""Hard morphs: the named ones, and random ones by seeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.outline import Outline
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight import Flight, fly
from hitchopt.requirements import Requirements
from problems.random_morph import random_morph


@dataclass(frozen=True, eq=False)
class Case:
    """One morph: its ends and what they keep."""

    name: str
    start: ho.Hitch
    end: ho.Hitch
    requirements: Requirements

    def judge(self, path: ShapePath) -> Flight | None:
        """Return the flight along a path if its certificate holds."""
        flight = fly(path, self.requirements.limits)
        motion = Motion(
            self.start.team,
            Requirements(
                self.requirements.limits, self.requirements.separation, self.requirements.arena
            ),
            flight.drones,
            flight.vertices,
            flight.legs,
            flight.tensions,
            (Phase("morph", 0, 0.0, flight.duration),),
        )
        return flight if ho.certify(motion).certified else None

    def rests(self) -> bool:
        """Return whether both ends keep all limits at rest."""
        requirements = self.requirements
        try:
            for hitch in (self.start, self.end):
                ho.hold(
                    hitch,
                    1.0,
                    limits=requirements.limits,
                    separation=requirements.separation,
                    arena=requirements.arena,
                )
        except ho.InfeasibleError:
            return False
        return True


def random_name(n: int, seed: int) -> str:
    """Return what a random morph is called."""
    return f"n = {n}, seed {seed}"


def random_case(n: int, seed: int) -> Case | None:
    """Return a random hard morph, or None where an end breaks a limit at rest."""
    problem = problem_from_dict(random_morph(n, seed, hard=True))
    (step,) = problem.mission
    if not isinstance(step, ho.Morph) or not isinstance(problem.start, ho.HitchStart):
        raise TypeError("a random morph is one morph")
    requirements = problem.requirements
    case = make_case(
        random_name(n, seed), problem.team, problem.start.polygon, step.polygon, requirements
    )
    return case if case.rests() else None


def make_case(
    name: str, team: ho.Team, first: Outline, last: Outline, requirements: Requirements
) -> Case:
    """Return the morph from a spread hitch to the sharing nearest to it."""
    start = ho.Hitch.spread(
        team, first, limits=requirements.limits, separation=requirements.separation
    )
    end = ho.Hitch.nearest(
        team,
        last,
        1.0,
        start.fractions,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
    )
    return Case(name, start, end, requirements)


def named_cases() -> list[Case]:
    """Return the hard morphs that every version must plan."""
    free = Requirements(ho.Limits(), ho.Separation(), None)
    narrow = Requirements(
        ho.Limits(), ho.Separation(), ho.Arena([-1.55, -1.55, 0.0], [1.55, 1.55, 3.0])
    )
    square = ho.regular_polygon(4, 1.2, np.pi / 4)
    pentagon = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])
    octagon = ho.regular_polygon(8, 1.3)
    four, weak = ho.Team(4, 2.4), ho.Quadrotor(0.132, 1.6)
    thrust_bound = ho.Team(4, 2.4, tension=0.8, quadrotor=weak)
    moved = square.rotated(0.9).translated([0.5, 0.2])
    small, five = ho.regular_polygon(5, 0.45, 0.3), ho.Team(5, 2.0)
    first, last = (ho.Hitch(five, small, 1.0, np.full(5, d)) for d in (1.2, 0.35))
    return [
        make_case("square, quarter turn", four, square, square.renumbered(1), free),
        make_case("square, half turn", four, square, square.renumbered(2), free),
        make_case("octagon, 45°", ho.Team(8, 2.0), octagon, octagon.rotated(np.pi / 4), free),
        make_case("pentagon", ho.Team(5, 2.6), pentagon, pentagon.renumbered(2), free),
        make_case("thrust-bound", thrust_bound, square, moved, free),
        make_case("narrow arena", four, square, square.renumbered(1), narrow),
        Case("star tip", first, last, free),
    ]
