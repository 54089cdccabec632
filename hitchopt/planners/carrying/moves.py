"""Moves of a hitch with an object, and their curves as polynomials: at rest, pulling, or flying.

They follow a law of motion whose first four derivatives are continuous: legs lean with the
acceleration of what they carry, so drones accelerate with its fourth derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.objects.placing import in_world, poses_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PROBE = 2e-3
"""[s] Step of finite differences of the fourth order: they err by 1e-9 m/s² in such motions."""

STENCIL = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0

LONGEST = 0.5
"""[s] Longest piece while what is held turns or tensions change."""

STEADY = 2.5
"""[s] Longest piece while it goes straight on. Second derivatives at its ends err by some 0.01 of
how fast loads change before it, which moves clasps by that times the square of its duration."""

SHARE = 0.8
"""Share of what friction and supports allow that is used."""


@dataclass(frozen=True, eq=False)
class Move:
    """What changes in a span of time, by one share from 0 to 1.

    Attributes
    ----------
    start, end: (4,) x, y, z [m] of the object's base and its yaw [rad], of what the clasps' frame
        follows.
    tension: (2, n) [N], before and after.
    borne: share of the object's weight on clasps before and after.
    below: how far the clasps are below the rim before and after [m]; 0 where they touch it.
    law: of the share.
    closed: how far a hitch that grips is closed before and after: 0 around the object, 1 where it
        grips, more where it is closed farther for a while.
    lean: by what share of clasp friction legs pull more than edges before and after, so that clasps
        close; negative where they open.
    """

    start: Array
    end: Array
    tension: Array
    borne: tuple[float, float]
    below: tuple[float, float]
    law: SmoothLaw
    closed: tuple[float, float] = (1.0, 1.0)
    lean: tuple[float, float] = (0.0, 0.0)

    @property
    def lifted(self) -> bool:
        """Whether the object is off its support all the time."""
        return self.borne == (1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Courses:
    """Where an object is in the course of a move, at times (…).

    Attributes
    ----------
    share: (…), of the move.
    pose: (…, 5), of the object.
    borne: (…), share of its weight on clasps.
    tension: (…, n) [N]
    level: (…, 3) [m/s²], acceleration of its base as seen from it, without that of turning.
    turning, turned: (…) [rad/s], [rad/s²], of its yaw.
    """

    share: Array
    pose: Array
    borne: Array
    tension: Array
    level: Array
    turning: Array
    turned: Array

    def between(self, before: float, after: float) -> Array:
        """Return (…) what changes from ``before`` to ``after``."""
        found: Array = before + self.share * (after - before)
        return found

    def accelerations(self, points: Array) -> Array:
        """Return accelerations (…, k, 3) [m/s²] of points (k, 3) of the object, in its frame."""
        x, y = points[:, 0], points[:, 1]
        inward, sideways = (self.turning**2)[..., None], self.turned[..., None]
        spin = [-inward * x - sideways * y, sideways * x - inward * y, 0.0 * inward * x]
        found: Array = self.level[..., None, :] + np.stack(spin, axis=-1)
        return found


def courses(move: Move, t: Array) -> Courses:
    """Return where the object is at times t (…) [s] of a move."""
    share, speed, change = np.moveaxis(move.law.jet(t), -1, 0)
    offset = move.end - move.start
    place = move.start + share[..., None] * offset
    yaw = place[..., 3]
    pose = np.concatenate([place[..., :3], np.cos(yaw)[..., None], np.sin(yaw)[..., None]], axis=-1)
    borne = move.borne[0] + share * (move.borne[1] - move.borne[0])
    tension = move.tension[0] + share[..., None] * (move.tension[1] - move.tension[0])
    back = np.stack([0 * yaw, 0 * yaw, 0 * yaw, np.cos(yaw), -np.sin(yaw)], axis=-1)
    level = in_world(back, change[..., None] * offset[:3])
    return Courses(share, pose, borne, tension, level, speed * offset[3], change * offset[3])


class Held(Protocol):
    """A hitch that holds an object in one manner or another."""

    @property
    def team(self) -> Team:
        """Who flies."""

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s]."""


@dataclass(frozen=True, eq=False)
class CarriedMove:
    """The planner of a move with a held object, from rest to rest.

    Attributes
    ----------
    held: what flies, and what it holds.
    move: what changes.
    requirements: what the motion must satisfy; all other objects stay where they stand.
    phase: with the object's name in ``hold``; its times are set.
    """

    held: Held
    move: Move
    requirements: Requirements
    phase: Phase

    @cached_property
    def problem(self) -> Array:
        """(J,) [s]: times between which the motion is one polynomial, closer while loads change."""
        move = self.move
        closes = move.closed[0] != move.closed[1]
        moves = closes or bool(np.any(move.start != move.end)) or move.below[0] != move.below[1]
        changes = closes or bool(np.any(move.tension[0] != move.tension[1]))
        changes |= move.borne[0] != move.borne[1] or move.lean[0] != move.lean[1]
        turns = move.start[3] != move.end[3]
        return move.law.breaks(LONGEST if changes or turns or not moves else STEADY)

    def solve(self) -> Motion:
        """Return the motion; raises InfeasibleError for a weight that tensions cannot carry."""
        move, requirements, breaks = self.move, self.requirements, self.problem
        t = np.clip(breaks[:, None] + PROBE * STENCIL, 0.0, move.law.duration)
        parts: dict[str, Any] = {}
        for name, each in self.held.curves(move, t).items():
            if np.all(each == each[:1, :1]):
                parts[name] = PiecewisePolynomial.constant(breaks, each[0, 0])
                continue
            first = np.tensordot(FIRST / PROBE, each, (0, 1))
            second = np.tensordot(SECOND / PROBE**2, each, (0, 1))
            first[[0, -1]] = second[[0, -1]] = 0.0
            jets = np.stack([each[:, len(STENCIL) // 2], first, second])
            parts[name] = PiecewisePolynomial.hermite(breaks, jets[:, :-1], jets[:, 1:])
        assert self.phase.hold is not None
        index = list(requirements.objects).index(self.phase.hold.object)
        pose, borne = parts.pop("pose").coefficients, parts["borne"].coefficients
        poses = np.repeat(poses_of(requirements.objects)[None, :, :, None], len(pose), axis=0)
        poses = np.repeat(poses, pose.shape[-1], axis=-1)
        poses[:, index] = pose
        shares = np.zeros((len(borne), len(requirements.objects), borne.shape[-1]))
        shares[:, index] = np.clip(borne, 0.0, 1.0)  # polynomials overshoot by 1e-6
        parts["poses"], parts["borne"] = (PiecewisePolynomial(breaks, c) for c in (poses, shares))
        phases = (replace(self.phase, start=0.0, end=move.law.duration),)
        return Motion(self.held.team, requirements, **parts, phases=phases)


STEP = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""A step from 0 to 1 with three zero derivatives at its ends."""

STEEPEST, BENDING = 2.1875, 7.52
"""Largest first and second derivative of that step."""


RAMP_PIECES = 10
"""Pieces of a ramp: legs follow their clasps' balance between them within 1e-4 of the tension."""


@dataclass(frozen=True)
class SmoothLaw:
    """A share from 0 to 1: its speed rises, is constant, and falls.

    Attributes
    ----------
    ramp, cruise: how long the speed changes, each time, and is constant [s].
    """

    ramp: float
    cruise: float = 0.0

    @classmethod
    def fastest(cls, speed: float, acceleration: float, jerk: float) -> SmoothLaw:
        """Return the fastest law within limits of the share's derivatives [1/s], [1/s²], [1/s³]."""
        top = min(speed, math.sqrt(acceleration / STEEPEST), (jerk / BENDING) ** (1.0 / 3.0))
        ramp = max(STEEPEST * top / acceleration, math.sqrt(BENDING * top / jerk))
        return cls(ramp, max(1.0 / top - ramp, 0.0))

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return 2.0 * self.ramp + self.cruise

    def slowed(self, factor: float) -> SmoothLaw:
        """Return the same law, ``factor`` times as slow."""
        return SmoothLaw(factor * self.ramp, factor * self.cruise)

    def breaks(self, longest: float) -> Array:
        """Return times (pieces + 1,) [s] from 0 on: ramps in pieces, and the cruise in others.

        Parameters
        ----------
        longest: of the cruise's pieces [s].
        """
        ramp = np.linspace(0.0, self.ramp, RAMP_PIECES + 1)
        pieces = max(1, math.ceil(self.cruise / longest))
        cruise = self.ramp + np.linspace(0.0, self.cruise, pieces + 1)
        times = np.concatenate([ramp, cruise[1:], self.ramp + self.cruise + ramp[1:]])
        kept: Array = times[np.append(True, np.diff(times) > 1e-9)]
        kept[-1] = self.duration
        return kept

    def jet(self, t: Array) -> Array:
        """Return the share and its first two derivatives at times t (…) [s], as (…, 3)."""
        top = 1.0 / (self.ramp + self.cruise)
        begun = np.clip(t / self.ramp, 0.0, 1.0)
        ended = np.clip((t - self.ramp - self.cruise) / self.ramp, 0.0, 1.0)
        there = np.clip(t - self.ramp, 0.0, self.cruise)
        area, slope = STEP.integ(), STEP.deriv()
        share = self.ramp * (area(begun) + ended - area(ended)) + there
        speed = STEP(begun) - STEP(ended)
        change = (slope(begun) - slope(ended)) / self.ramp
        return top * np.stack([share, speed, change], axis=-1)
