"""Several teams in one plan: each planned alone, then begun so that all keep off each other."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError, Progress, TimeLimitError, Violation
from hitchopt.hitch.requirements import Separation
from hitchopt.mission.problem import Problem, SwarmProblem
from hitchopt.mission.solving import solve_problem, solve_swarm
from hitchopt.mission.teams_problem import AnyProblem, TeamsProblem
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import WAIT, Group, Motion, Phase, joined_motions
from hitchopt.motion.retiming import cut, padded, resting, shifted
from hitchopt.planners.schedule import STEP, Blocked, Placed, Schedule, Track
from hitchopt.steps.certified_motions import Certified, infeasible
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PADS = 0.0, 0.02, 0.05, 0.10
"""[m] By how much wider distances are, until the certificate holds: samples are STEP apart."""

LAYER = 2.2
"""By how much higher or lower a path is flown where no delay helps, in ``separation.height``."""

RISE = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Coefficients of the polynomial that rises from rest to rest, up to its third derivative."""

PEAKS = 35.0 / 16.0, 7.5132, 52.5
"""Largest values of its first three derivatives."""


def solve_any(
    problem: AnyProblem, progress: Progress | None = None, *, optimiser: bool = True
) -> Certified:
    """Return the certified plan of any problem; arguments and errors as ``solve_problem``.

    Beside plans of somebody else a team may wait before every step, so as to keep off.
    """
    if isinstance(problem, TeamsProblem) or problem.others:
        return solve_teams(problem, progress, optimiser=optimiser)
    if isinstance(problem, SwarmProblem):
        return solve_swarm(problem, progress)
    return solve_problem(problem, progress, optimiser=optimiser)


def solve_teams(
    problem: AnyProblem, progress: Progress | None = None, *, optimiser: bool = True
) -> Certified:
    """Return the certified plan of all teams.

    Raises InfeasibleError: a team cannot fly alone, or no start of it keeps it off the others.
    """
    tell = progress or (lambda _: None)
    problems, counts = _of_teams(problem)
    alone = {name: _alone(name, each, tell, optimiser) for name, each in problems.items()}
    together = combined([Group(name, each) for name, each in alone.items()]).requirements
    timed = {
        (name, k)
        for name, each in problems.items()
        for k, step in enumerate(each.mission if isinstance(each, Problem) else each)
        if getattr(step, "duration", getattr(step, "given_duration", None)) is not None
    }
    items = [
        _Item(index, row, before, together.separation, alone, timed)
        for index, (row, before) in enumerate(_items(alone, counts))
    ]
    others = [group for name, other in problem.others.items() for group in other.groups(name)]
    for pad in PADS:
        tell("finding when each team begins")
        wider = pad + 2.0 * (together.limits.tracking or 0.0)
        flown, clock = {name: list[Motion]() for name in alone}, 0.0
        try:
            for item in items:
                clock += item.fly(flown, [_placed(each, clock) for each in others], wider)
        except InfeasibleError:
            if pad == 0.0:
                raise
            break  # what the narrower distances broke is said
        groups = [Group(name, _one_wait(joined_motions(each))) for name, each in flown.items()]
        motion = combined(groups, others)
        tell("certifying all teams together")
        certificate = certify(motion)
        if certificate.certified:
            break
    if not certificate.certified:
        raise infeasible(certificate, motion)
    return Certified(motion, certificate)


def _of_teams(
    problem: AnyProblem,
) -> tuple[Mapping[str, Problem | tuple[SwarmProblem, ...]], Sequence[Mapping[str, int]]]:
    """Return the problem of every team, and how many steps each has in each item.

    A team alone has no name, and its steps without a stop are items of their own.
    """
    if isinstance(problem, TeamsProblem):
        return problem.problems, problem.items
    if isinstance(problem, SwarmProblem):
        return {"": (problem,)}, [{"": 1}]
    ends = [-1, *(k for k, step in enumerate(problem.mission) if not step.blends)]
    return {"": problem}, [{"": last - first} for first, last in pairwise(ends)]


def _placed(other: Group, clock: float) -> Placed:
    """Return what flies besides as seen at a time [s] of the plan, sampled with it."""
    first, last = other.motion.drones.breaks[[0, -1]].tolist()
    start = math.floor((first - clock) / STEP + 1e-9)
    motion = padded(other.motion, min(clock + STEP * start, first), last)
    return Placed(Track(replace(other, motion=motion), _moved(motion)), start)


def _alone(
    name: str, problem: Problem | tuple[SwarmProblem, ...], tell: Progress, optimiser: bool
) -> Motion:
    """Return the motion of one team alone."""

    def say(words: str) -> None:
        tell(f"{name}: {words}" if name else words)

    try:
        if isinstance(problem, Problem):
            return solve_problem(problem, say, optimiser=optimiser).motion
        motions = []
        for k, each in enumerate(problem):
            motion = solve_swarm(each, say).motion
            motions.append(motion.replaced(phases=tuple(replace(p, step=k) for p in motion.phases)))
        return joined_motions(motions)
    except TimeLimitError:
        raise
    except InfeasibleError as error:
        raise error.of_group(name) from None


def _items(
    alone: Mapping[str, Motion], items: Sequence[Mapping[str, int]]
) -> Iterator[tuple[dict[str, Motion], dict[str, Motion]]]:
    """Yield the motions in each item of the teams that fly there, and of all at rest before it."""
    done = dict.fromkeys(alone, 0)
    here = {name: resting(motion, STEP, first=True) for name, motion in alone.items()}
    for item in items:
        row = dict[str, Motion]()
        for name, count in item.items():
            motion, first, done[name] = alone[name], done[name], done[name] + count
            phases = [phase for phase in motion.phases if first <= phase.step < done[name]]
            ends = np.array([phases[0].start, phases[-1].end])
            nearest = np.argmin(np.abs(motion.drones.breaks - ends[:, None]), axis=1)
            row[name] = cut(motion, *nearest.tolist())
        yield row, here
        here = here | {name: resting(motion, STEP) for name, motion in row.items()}


class _Item:
    """An item of the mission: the motions that begin together, and when each does."""

    def __init__(
        self,
        index: int,
        row: Mapping[str, Motion],
        before: Mapping[str, Motion],
        separation: Separation,
        alone: Mapping[str, Motion],
        timed: Collection[tuple[str, int]],
    ) -> None:
        self.index, self.row, self.timed = index, row, timed
        self.tracks = [
            Track(Group(name, row.get(name, before[name])), _moved(motion))
            for name, motion in alone.items()
        ]
        self.schedule = Schedule(self.tracks, separation, self._layer)

    def _layer(self, k: int, layer: int) -> Track | None:
        name = self.tracks[k].group.name
        height = LAYER * self.schedule.separation.height * (1.0 if layer == 1 else -1.0)
        motion = self.row.get(name)
        if motion is None or (name, motion.phases[0].step) in self.timed:
            return None  # a layer takes longer
        layered = _layered(motion, height)
        return None if layered is None else Track(Group(name, layered), self.tracks[k].owned)

    def fly(self, flown: Mapping[str, list[Motion]], others: Sequence[Placed], pad: float) -> float:
        """Add the motions of all teams to those that they have flown; return its duration [s]."""
        found = self.schedule.solve(others, pad)
        if isinstance(found, Blocked):
            raise _blocked(found, self.index)
        starts = [
            (each.track.group.name, STEP * each.start, each.track.group.motion) for each in found
        ]
        end = max(delay + motion.duration for name, delay, motion in starts if name in self.row)
        for name, delay, motion in starts:
            if name in self.row:
                flown[name].append(padded(shifted(motion, delay), 0.0, end))
            else:
                wait = replace(motion.phases[0], name=WAIT, tension=None, remark="")
                flown[name].append(resting(motion, end, wait))
        return end


def _one_wait(motion: Motion) -> Motion:
    """Return the motion with phases of waiting that follow one another, in one step, as one."""
    phases = list[Phase]()
    for phase in motion.phases:
        last = phases[-1] if phases else None
        if (
            last
            and last.name == WAIT
            and phase.retimed(last.start, phase.end) == last.retimed(last.start, phase.end)
        ):
            phases[-1] = last.retimed(last.start, phase.end)
        else:
            phases.append(phase)
    return motion.replaced(phases=tuple(phases))


def _moved(motion: Motion) -> frozenset[str]:
    """Return the names of objects that a motion moves."""
    poses = motion.object_poses.coefficients
    moves = np.any(poses != poses[:1, ..., :1], axis=(0, 2, 3))
    return frozenset(np.array(list(motion.requirements.objects), dtype=object)[moves].tolist())


def _layered(motion: Motion, height: float) -> Motion | None:
    """Return the motion flown higher by ``height`` [m]: a climb, the same path, a descent.

    None for paths on which cables or objects are not taken along as they are: with free cables, or
    an object held; or of several steps, which would end elsewhere.
    """
    if any((not (p.formed or p.hold) and motion.team.has_cables) or p.hold for p in motion.phases):
        return None
    if motion.phases[0].step != motion.phases[-1].step:
        return None
    limits = motion.requirements.with_reserve.limits
    speed = min(limits.speed, limits.vertex_speed) if motion.team.has_cables else limits.speed
    rates = speed, 0.5 * limits.acceleration, limits.jerk
    least = (
        math.pow(peak * abs(height) / rate, 1.0 / k)
        for k, (peak, rate) in enumerate(zip(PEAKS, rates, strict=True), 1)
    )
    seconds = max(least)
    climb = resting(motion, seconds, replace(motion.phases[0], name="climb"), first=True)
    descend = resting(motion, seconds, replace(motion.phases[-1], name="descend"))
    raised = [
        _raised(climb, height * RISE),
        _raised(motion, np.full(1, height)),
        _raised(descend, height * RISE[::-1]),
    ]
    return joined_motions(raised)


def _raised(motion: Motion, heights: Array) -> Motion:
    """Return the motion with a polynomial (degree + 1,) [m] on each piece added to heights."""

    def part(whole: PiecewisePolynomial) -> PiecewisePolynomial:
        degree = max(whole.degree, len(heights) - 1)
        coefficients = whole.elevated(degree).coefficients.copy()
        added = PiecewisePolynomial(whole.breaks[:2], heights[None]).elevated(degree)
        coefficients[..., 2, :] += added.coefficients[0]
        return whole.alike(coefficients)

    return motion.replaced(drones=part(motion.drones), vertices=part(motion.vertices))


def _blocked(blocked: Blocked, item: int) -> InfeasibleError:
    """Return the error of two teams that find no times beside each other."""
    x, y, z = blocked.place
    one, other = (name or "this plan" for name in blocked.names)
    where = f"near ({x:.2f}, {y:.2f}, {z:.2f}) m in item {item} of the mission"
    if blocked.at:
        when = f"between the {blocked.at} of {one} and {other}, {where}"
        remedy = f"move the {blocked.at[:-1]} of {one} or {other}; no delay helps"
    else:
        when = f"{where}, {blocked.time:.1f} s after it begins, whatever the delay"
        remedy = f"move the goal of {one} or {other}, or let one of them fly in an item of its own"
    unit = "ratio" if blocked.check == "separation" else "m"
    values = blocked.check, blocked.value, blocked.limit, "min", unit, (one, other), when, remedy
    return InfeasibleError([Violation(*values)])
