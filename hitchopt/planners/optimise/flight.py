"""The current flight of a refinement: a path with its clock, its limits and its distances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.morph import shape_violation
from hitchopt.planners.optimise.cost import MOTION_JET, Expansion, FlightCost
from hitchopt.planners.optimise.motion_rows import RATE_DEGREE, ClockSamples, MotionLimits
from hitchopt.planners.optimise.shape_rows import PathShapes, ShapeBlock
from hitchopt.planners.optimise.splines import PathSplines
from hitchopt.planners.path import LegLaw, Path
from hitchopt.planners.timing.clock import Clock
from hitchopt.planners.timing.profile import if_timed
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.timed_motion import (
    fastest_motion,
    in_duration,
    motion_by,
)
from hitchopt.trajectory.piecewise import summed
from hitchopt.trajectory.splines import bspline, evenly_interpolated
from hitchopt.values import Array

PIECES = 5  # Number of pieces of the splines that are added to the flat outputs
NODES = 2  # Number of Gauss nodes in each piece of the clock, at which limits of motion have rows
SHAPE_SAMPLES = 97  # Number of s at which distances, legs and angles have rows
LEG_SAMPLES = 129  # Number of even s through which q-legs of a route become a spline, within 1e-8 m
MARGIN = 1.006  # Enforced distances over their limits; with 1.003 some flights were not certified.

SHORTFALL_MARGIN = 1.0 + (MARGIN - 1.0) / 3.0
"""Distances over their limits below which they are too short."""

PENALTY = 10.0  # [s/m] Penalty of distances that are too short, which the next step restores


class Step(NamedTuple):
    """Changes of all coefficients of a flight."""

    splines: Array  #: (coefficients of splines,)
    rate: Array  #: (coefficients of x,)
    gain: float  #: [s] Expected gain of duration and cost


@dataclass(frozen=True, eq=False)
class Flight:
    """A path with its fastest clock."""

    path: Path  #: The path; its q-legs are splines
    motion: Motion  #: Its motion by the clock, which may exceed limits between the clock's samples
    clock: Clock  #: Its clock
    requirements: Requirements  #: Requirements of all flights
    tension: tuple[float, float] | None  #: [N] Range of tensions, or None
    custom_cost: FlightCost | None = None  #: Custom cost, which is added to the duration

    @classmethod
    def along(
        cls,
        path: Path,
        requirements: Requirements,
        tension: tuple[float, float] | None,
        cost: FlightCost | None = None,
    ) -> Flight | None:
        """Return the fastest flight along a path, or None if it cannot be flown."""
        if shape_violation(path) is not None:
            return None
        timed = partial(if_timed, partial(fastest_motion, path, requirements))
        clocked = if_balanced(timed, None)
        if clocked is None:
            return None
        return cls(path, *clocked, requirements, tension, cost)

    @cached_property
    def splines(self) -> PathSplines:
        """The splines that are added to the path."""
        return PathSplines.of(self.path, PIECES)

    @cached_property
    def samples(self) -> ClockSamples:
        """Samples of its clock."""
        return ClockSamples(self.path, self.clock, self.splines, NODES)

    @cached_property
    def limits(self) -> MotionLimits:
        """Limits of motion at these samples."""
        return MotionLimits(self.samples, self.requirements)

    @cached_property
    def shapes(self) -> PathShapes:
        """The shapes at inner samples of the path, which are closer at the ends."""
        evenly = np.linspace(0.0, 1.0, SHAPE_SAMPLES)[1:-1]
        toward_ends = 0.5 - 0.5 * np.cos(np.pi * evenly)
        s = 0.5 * (evenly + toward_ends)
        return PathShapes.of(self.splines, self.limits.functions, self.path, s)

    def shape_block(self, reach: float, margin: float) -> ShapeBlock:
        """Return the rows of distances, legs, walls, angles and tensions.

        Parameters
        ----------
        reach: [m] distance beyond the enforced one up to which bodies have rows.
        margin: enforced distances over their limits.
        """
        shapes = self.shapes
        blocks = [
            shapes.pair_block(self.requirements, reach, margin),
            shapes.leg_block(self.requirements, reach),
            shapes.wall_block(self.requirements, reach),
            shapes.turn_block(),
        ]
        blocks += list(shapes.obstacle_blocks(self.requirements, reach, margin))
        if self.tension is not None and self.splines.columns.varying:
            blocks.append(shapes.tension_block(self.tension))
        return ShapeBlock.stacked(blocks)

    @property
    def duration(self) -> float:
        """Duration of the clock [s]."""
        return self.motion.duration

    @property
    def merit(self) -> float:
        """Duration and cost [s] plus the penalty of distances that are too short."""
        return self.duration + self.cost() + PENALTY * self.shortfall

    @cached_property
    def shortfall(self) -> float:
        """Largest shortfall of a distance at the samples [m]."""
        block = self.shape_block(0.0, SHORTFALL_MARGIN)
        return float(np.max(block.smallest, initial=0.0))

    @cached_property
    def cost_expansion(self) -> Expansion | None:
        """The custom cost at the samples, and its derivatives; None without one."""
        return None if self.custom_cost is None else self._expand(self.custom_cost, 1.0)

    def cost(self, stretch: float = 1.0) -> float:
        """Return the custom cost [s] of the flight, stretched in time; 0 without one."""
        if self.custom_cost is None:
            return 0.0
        expansion = self.cost_expansion
        if expansion is None or stretch != 1.0:
            expansion = self._expand(self.custom_cost, stretch)
        return float(self.samples.weights @ expansion.values)

    def _expand(self, custom_cost: FlightCost, stretch: float) -> Expansion:
        """Return the custom cost at the samples of the flight, stretched in time."""
        samples = self.samples
        rate = samples.rate / stretch**2
        return custom_cost.expand_flight(
            samples.unknowns[:, :MOTION_JET],
            samples.heights[:, :MOTION_JET],
            rate[:, :2],
            samples.progress[:, 0],
            self.splines.columns,
        )

    def moved(self, coefficients: Array) -> Path:
        """Return the path with splines of coefficients (coefficients of splines,) added."""
        return self.splines.added_to(self.path, self.splines.of_coefficients(coefficients))

    def after(self, step: Step) -> Flight | None:
        """Return the flight after a step, or None if it cannot be flown.

        Without a custom cost its clock is the fastest one for its path. With one it is that of the
        step, which may be slower than limits need, and is slowed down where they need that.
        """
        path = self.moved(step.splines)
        if self.custom_cost is None:
            return Flight.along(path, self.requirements, self.tension)
        if shape_violation(path) is not None:
            return None
        change = bspline(self.samples.rate_knots, step.rate, RATE_DEGREE)
        clock = replace(self.clock, squared_rate=summed(self.clock.squared_rate, change))
        moved = if_balanced(partial(self._slowed, path, clock), None)
        return moved if moved is None or math.isfinite(moved.duration) else None

    def _slowed(self, path: Path, clock: Clock) -> Flight:
        """Return the flight along a path by a clock, slowed down until limits hold."""
        motion = motion_by(path, self.requirements, clock)
        stretch = max(1.0, needed_stretch(motion))
        rate = clock.squared_rate
        slower = rate.replaced(rate.coefficients / stretch**2)
        return replace(
            self,
            path=path,
            motion=in_duration(motion, stretch * motion.duration),
            clock=replace(clock, squared_rate=slower),
        )


def with_leg_lengths(path: Path) -> Path:
    """Return the path with q-legs as splines of their own, which do not depend on the slack."""
    flat = path.flat(np.linspace(0.0, 1.0, LEG_SAMPLES), 1)
    return replace(path, legs=LegLaw.of_lengths(evenly_interpolated(flat.q_legs[..., 0])))
