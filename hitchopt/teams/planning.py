"""Several teams in one plan: each is planned alone, then start times separate them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.checks import certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, Progress, Violation
from hitchopt.hitch.requirements import Separation
from hitchopt.mission.problem import Problem
from hitchopt.mission.solving import CertifiedFlight
from hitchopt.motion.flight import Flight, TeamMotion, own_objects
from hitchopt.motion.motion import WAIT, Motion, Phase, concatenated
from hitchopt.motion.retiming import cut, padded, resting, shifted
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import calm_stretch
from hitchopt.teams.schedule import STEP, Blocked, Placed, SampledPath, Schedule
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array

MARGINS = 0.0, 0.02, 0.05, 0.10
"""Margins of distances to try until the certificate holds [m], since times are sampled."""

LAYER_GAP = 2.2
"""Vertical offset of a path if no delay helps, and gap of one that clears all other teams, over
``separation.height``."""

LAYERS = (1, 3, 5, 7)
"""Numbers of paths of a team that are tried in turn: its own, also those that climb or descend by
one LAYER_GAP on the way, also those that do so at rest at both ends, also those above or below all
that other teams do meanwhile."""

CLIMB_SHARE = 1.0 / 3.0
"""Share of the duration in which a path on the way to another height climbs, and descends."""

CLIMB = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of a unit climb; its first three derivatives vanish at both ends."""

PEAK_DERIVATIVES = 35.0 / 16.0, 7.5132, 52.5  # Maxima of the first three derivatives of CLIMB


def schedule_teams(
    problem: Problem, alone: Mapping[str, Motion], report: Progress
) -> CertifiedFlight:
    """Return the certified plan of all teams, and other plans, given that of each team alone.

    Raises InfeasibleError if no start time separates a team from the others.
    """
    teams = tuple(TeamMotion(name, each) for name, each in alone.items())
    requirements = Flight(teams).requirements
    timed = {
        (name, k)
        for name, mission in problem.teams.items()
        for k, step in enumerate(mission.steps)
        if step.prescribed_duration is not None
    }
    others = [each for name, other in problem.others.items() for each in other.teams(name)]
    every = [*alone.values(), *(other.motion for other in others)]
    owned = {name: own_objects(motion, every) for name, motion in alone.items()}
    items = [
        _Item(index, row, before, requirements.separation, owned, timed)
        for index, (row, before) in enumerate(_items(alone, problem.items))
    ]

    def schedule(margin: float) -> Flight:
        """Return the flight in which sampled times keep distances with a margin [m]."""
        report("finding the start time of each team")
        tracking_margin = margin + 2.0 * requirements.limits.tube.largest
        flown = {name: list[Motion]() for name in alone}
        clock = 0.0
        for item in items:
            placed = list[Placed]()
            for other in others:  # sampled from this time of the plan on
                first, last = other.motion.drones.breaks[[0, -1]].tolist()
                start = math.floor((first - clock) / STEP + 1e-9)
                path = padded(other.motion, min(clock + STEP * start, first), last)
                own = own_objects(path, alone.values())
                sampled = SampledPath(replace(other, motion=path), own)
                placed.append(Placed(sampled, start))
            clock += item.fly(flown, placed, tracking_margin)
        wholes = [(name, _merge_waits(concatenated(parts))) for name, parts in flown.items()]
        return Flight(tuple(TeamMotion(*each) for each in wholes), tuple(others))

    def certified(margin: float) -> CertifiedFlight:
        """Return the certified flight with a margin [m]."""
        flight = schedule(margin)
        report("certifying all teams together")
        certificate = certify(flight)
        if not certificate.certified:
            raise infeasible_error(certificate, flight)
        return CertifiedFlight(flight, certificate)

    def candidate(margin: float, *larger: float) -> Candidate[CertifiedFlight]:
        """Return the candidate of a margin [m]; it is amended to larger ones unless blocked."""

        def with_larger(error: InfeasibleError) -> Candidate[CertifiedFlight] | None:
            """Return the candidate of the next margin, if any may help."""
            return None if isinstance(error, BlockedError) or not larger else candidate(*larger)

        return Candidate("schedule", partial(certified, margin), with_larger)

    return first_certified([candidate(*MARGINS)], Effort(), report)


class BlockedError(InfeasibleError):
    """Two teams without separate times: larger margins do not help."""


def _items(
    alone: Mapping[str, Motion], items: Sequence[Mapping[str, int]]
) -> Iterator[tuple[dict[str, Motion], dict[str, Motion]]]:
    """Yield the motions of the teams that fly in each item, and of all teams at rest before it."""
    next_step = dict.fromkeys(alone, 0)
    rests = {name: resting(motion, STEP, first=True) for name, motion in alone.items()}
    for item in items:
        row = dict[str, Motion]()
        for name, count in item.items():
            motion = alone[name]
            steps = range(next_step[name], next_step[name] + count)
            next_step[name] = steps.stop
            phases = [phase for phase in motion.phases if phase.step in steps]
            ends = np.array([phases[0].start, phases[-1].end])
            nearest = np.argmin(np.abs(motion.drones.breaks - ends[:, None]), axis=1)
            row[name] = cut(motion, *nearest.tolist())
        yield row, rests
        rests = rests | {name: resting(motion, STEP) for name, motion in row.items()}


class _Item:
    """An item of the mission: motions that start together, and the schedule of their delays."""

    def __init__(
        self,
        index: int,
        row: Mapping[str, Motion],
        before: Mapping[str, Motion],
        separation: Separation,
        owned: Mapping[str, frozenset[str]],
        timed: Collection[tuple[str, int]],
    ) -> None:
        self.index, self.row, self.timed = index, row, timed
        self.tracks = [
            SampledPath(TeamMotion(name, row.get(name, before[name])), objects)
            for name, objects in owned.items()
        ]
        self.schedule = Schedule(self.tracks, separation, self._layer, LAYERS)

    def _layer(self, k: int, layer: int) -> SampledPath | None:
        """Return the path of team ``k`` in a layer from 1: higher if it is odd, else lower."""
        track = self.tracks[k]
        name = track.flown.name
        motion = self.row.get(name)
        if motion is None or (name, motion.phases[0].step) in self.timed:
            return None  # a layer takes longer
        gap = LAYER_GAP * self.schedule.separation.height
        is_higher = layer % 2 == 1
        lowest, highest = _heights(track)
        if layer <= 4:
            height = gap if is_higher else -gap
        else:
            gap += 2.0 * motion.requirements.limits.tube.largest + MARGINS[-1]
            others = [_heights(each) for each in self.tracks if each is not track]
            bottom, top = min(low for low, _ in others), max(high for _, high in others)
            height = top + gap - lowest if is_higher else bottom - gap - highest
        floor, arena = motion.requirements.ground_or(-math.inf), motion.requirements.arena
        ceiling = math.inf if arena is None else float(arena.upper[2])
        if lowest + height < floor or highest + height > ceiling:
            return None
        detour = _detour(motion, height, at_rest=layer > 2)
        return None if detour is None else SampledPath(TeamMotion(name, detour), track.owned)

    def fly(
        self, flown: Mapping[str, list[Motion]], others: Sequence[Placed], margin: float
    ) -> float:
        """Append the scheduled motions of all teams to ``flown``; return the duration [s]."""
        schedule = self.schedule.solve(others, margin)
        if isinstance(schedule, Blocked):
            raise _blocked_error(schedule, self.index)
        delayed = [(x.track.flown.name, STEP * x.start, x.track.flown.motion) for x in schedule]
        end, last = max(
            (delay + motion.duration, name) for name, delay, motion in delayed if name in self.row
        )
        ahead = {placed.track.flown.name: placed.behind for placed in schedule}
        for name, delay, motion in delayed:
            until = f"until {last} ends item {self.index}"
            if name in self.row:
                whole = padded(shifted(motion, delay), 0.0, end)
                remarks = f"for {ahead[name]}" if ahead[name] else "", until
                flown[name].append(_with_remarks_on_waits(whole, *remarks))
            else:
                wait = replace(motion.phases[0], name=WAIT, tension=None, remark=until)
                flown[name].append(resting(motion, end, wait))
        return end


def _with_remarks_on_waits(motion: Motion, before: str, after: str) -> Motion:
    """Return the motion with remarks on why it waits, if it does, at its start and its end."""
    phases = list(motion.phases)
    for k, remark in ((0, before), (-1, after)):
        if phases[k].name == WAIT:
            phases[k] = replace(phases[k], remark=remark)
    return motion.replaced(phases=tuple(phases))


def _heights(track: SampledPath) -> tuple[float, float]:
    """Return the lowest and the highest point [m] of all bodies of a team at any time."""
    boxes = track.boxes
    return float(np.min(boxes.lower[:, 2])), float(np.max(boxes.upper[:, 2]))


def _merge_waits(motion: Motion) -> Motion:
    """Return the motion with consecutive waiting phases of a step merged."""
    phases = list[Phase]()
    for phase in motion.phases:
        if phases and phases[-1].name == WAIT:
            start, end = phases[-1].start, phase.end
            longer_wait = phases[-1].retimed(start, end)
            differs_in_time_only = phase.retimed(start, end) == longer_wait
            if differs_in_time_only:
                phases[-1] = longer_wait
                continue
        phases.append(phase)
    return motion.replaced(phases=tuple(phases))


def _detour(motion: Motion, height: float, *, at_rest: bool) -> Motion | None:
    """Return the motion at a vertical offset [m]: a climb, the same path and a descent.

    The team climbs and descends ``at_rest``, before and after the path, or on its way. None for
    motions with free cables or a held object, and for motions of several steps.
    """
    if any(phase.state.slack or phase.hold for phase in motion.phases):
        return None
    if motion.phases[0].step != motion.phases[-1].step:
        return None
    return _climbing_at_rest(motion, height) if at_rest else _climbing(motion, height)


def _climbing(motion: Motion, height: float) -> Motion | None:
    """Return the motion that climbs on the first third of its path and descends on the last one.

    It is as slow as its limits require. None for a motion of too few pieces.
    """
    breaks = motion.drones.breaks
    shares = (breaks - breaks[0]) / motion.duration
    top, bottom = (int(np.argmin(np.abs(shares - x))) for x in (CLIMB_SHARE, 1.0 - CLIMB_SHARE))
    if not 0 < top < bottom < motion.drones.pieces:
        return None
    knots = breaks[[0, top, bottom, -1]]
    profile = PiecewisePolynomial(knots, height * np.array([CLIMB, np.ones(8), CLIMB[::-1]]))
    rise = on_breaks(profile, breaks).coefficients
    raised = _raised(motion.replaced(requirements=motion.requirements.with_reserve), rise)
    remark = f"{height:+.2g} m on the way, past other teams"
    phases = [
        replace(phase, remark="; ".join(filter(None, (phase.remark, remark))))
        for phase in raised.phases
    ]
    factor = calm_stretch(raised, max(1.0, needed_stretch(raised)))
    slowed = raised.replaced(phases=tuple(phases)).slowed(factor)
    return slowed.replaced(requirements=motion.requirements)


def _climbing_at_rest(motion: Motion, height: float) -> Motion:
    """Return the motion after a climb at rest, and before a descent at rest."""
    limits = motion.requirements.with_reserve.limits
    speed = min(limits.speed, limits.vertex_speed) if motion.team.has_cables else limits.speed
    rates = speed, 0.5 * limits.acceleration, limits.jerk
    duration = max(
        math.pow(peak * abs(height) / rate, 1.0 / k)
        for k, (peak, rate) in enumerate(zip(PEAK_DERIVATIVES, rates, strict=True), 1)
    )
    climb = resting(motion, duration, replace(motion.phases[0], name="climb"), first=True)
    descend = resting(motion, duration, replace(motion.phases[-1], name="descend"))
    raised = [
        _raised(climb, height * CLIMB[None]),
        _raised(motion, np.full((1, 1), height)),
        _raised(descend, height * CLIMB[None, ::-1]),
    ]
    return concatenated(raised)


def _raised(motion: Motion, heights: Array) -> Motion:
    """Return the motion with polynomials added to the heights of its pieces.

    Their coefficients are (pieces, degree + 1), or (1, degree + 1) for all pieces [m].
    """

    def add_heights(path: PiecewisePolynomial) -> PiecewisePolynomial:
        degree = max(path.degree, heights.shape[1] - 1)
        coefficients = path.elevated(degree).coefficients.copy()
        coefficients[..., 2, :] += bernstein.elevate(heights, degree)[:, None]
        return path.replaced(coefficients)

    return motion.replaced(drones=add_heights(motion.drones), vertices=add_heights(motion.vertices))


def _blocked_error(blocked: Blocked, item: int) -> BlockedError:
    """Return the error of two teams without separate times."""
    x, y, z = blocked.place
    one, other = (name or "this plan" for name in blocked.names)
    where = f"near ({x:.2f}, {y:.2f}, {z:.2f}) m in item {item} of the mission"
    if blocked.at:
        when = f"between the {blocked.at} of {one} and {other}, {where}"
        remedy = f"move the {blocked.at[:-1]} of {one} or {other}; no delay helps"
    else:
        when = f"{where}, {blocked.time:.1f} s after it begins, at any delay"
        remedy = f"move the goal of {one} or {other}, or let one of them fly in a separate item"
    unit = RULE_OF[blocked.check].unit
    values = blocked.check, blocked.value, blocked.limit, "min", unit, (one, other), when, remedy
    return BlockedError([Violation(*values)])
