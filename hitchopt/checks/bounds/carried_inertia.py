"""What a common clock leaves unbalanced of the inertia of carried objects.

Legs and edges put forces on what they carry with which it moves at the plan's own rate: they
depend on the place alone. On a clock with the rate s, a point x accelerates by ``(s² - 1) D²x + ṡ
Dx`` more, D its derivatives by plan time, and its mass times that is left unbalanced. A clock keeps
the balance where that is no more than checks ``equilibrium``, ``support`` and ``grip`` leave of
their limits, as they are found at the plan's own rate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import equilibrium, grip, support
from hitchopt.checks.bounds.object_frames import heading_error
from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import centre_path, supports_of
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

ROWS = 5
"""Number of coordinates of a path; those that it does not have are zero."""

HALVINGS = 8
"""Halvings of a cell in which a bound is decided; what is undecided then counts as broken."""

TIGHT = 1e9
"""A ratio of slip load to load that none reaches: the search finds the smallest one closely."""

TINY = 1e-12
"""[N], [m/s²] Slack counts as at least this where values are divided by it."""

EVEN = 0.01
"""Least share of a sum of two numbers that one of them is taken for."""


class CarriedInertia:
    """Paths whose additional accelerations a clock has to keep small.

    Parameters
    ----------
    motion: the plan.
    parts: of it, on which something is carried, as of ``_parts``.
    """

    def __init__(self, motion: Motion, parts: list[tuple[slice, Array, Array]]) -> None:
        pieces = motion.drones.pieces
        items = max(path.shape[1] for _, path, _ in parts)
        order = max(bernstein.degree(path) for _, path, _ in parts)
        paths = np.zeros((pieces, items, ROWS, order + 1))
        self.slack = np.full((pieces, items), np.inf)
        """(pieces, items), how large the norms of additional accelerations may be."""
        for run, path, slack in parts:
            count = path.shape[1]
            known = np.all(np.isfinite(path), axis=(2, 3))
            paths[run, :count] = np.nan_to_num(bernstein.elevate(path, order))
            self.slack[run, :count] = np.where(known, np.maximum(slack, 0.0), 0.0)
        self.breaks = motion.drones.breaks
        whole = PiecewisePolynomial(self.breaks, paths)
        derivatives = [whole.differentiated(k).coefficients for k in (1, 2, 3, 4)]
        self._first, self._second = derivatives[:2]
        self._sizes = [np.max(np.linalg.norm(c, axis=2), axis=-1) for c in derivatives[1:]]
        self._margins = [derivative_margin(whole, k) for k in (1, 2)]
        edges = [(self.breaks[run.start], self.breaks[run.stop]) for run, _, _ in parts]
        self._spans = np.array(edges)

    @classmethod
    def of(cls, motion: Motion) -> CarriedInertia | None:
        """Return that of a motion; None where it carries nothing."""
        parts = list(_parts(motion))
        return cls(motion, parts) if parts else None

    def during(self, begin: Array, end: Array) -> Flags:
        """Return (m,) whether something is carried within spans of plan time (m,) [s]."""
        begins, ends = self._spans.T
        found: Flags = np.any((ends > begin[:, None]) & (begins < end[:, None]), axis=1)
        return found

    def least_rate(self, begin: float, end: float) -> float:
        """Return the least constant rate that keeps the balance within a span of plan time [s].

        It is found at samples, to tell what to ask for, and verifies nothing.
        """
        breaks = self.breaks
        times = np.concatenate([breaks, 0.5 * (breaks[1:] + breaks[:-1])])
        times = times[(times >= begin) & (times <= end)]
        pieces = np.searchsorted(breaks[1:-1], times)
        added = self._added(times[:, None] * [1.0, 0.0, 0.0, 0.0], pieces)  # at rest
        slack = np.maximum(self.slack[pieces], TINY)
        over = max(1.0, float(np.max(added / slack, initial=0.0)))
        return float(np.sqrt(1.0 - 1.0 / over))

    def broken(self, cells: ClockPhases, pieces: Indices, *, sampled: bool) -> Flags:
        """Return (cells,) whether the balance is not shown to be kept.

        Parameters
        ----------
        cells: of a clock.
        pieces: (cells,), those they lie in.
        sampled: look at the cells' ends only.
        """
        broken = np.zeros(len(cells), dtype=np.bool_)
        index = np.flatnonzero(np.any(np.isfinite(self.slack[pieces]), axis=1))
        cells, pieces = cells.taken(index), pieces[index]
        for _ in range(HALVINGS):
            slack = self.slack[pieces]
            ends = np.maximum(*(self._added(jets, pieces) for jets in (cells.jets, cells.ends)))
            beyond = ~np.all(ends <= slack, axis=1)
            broken[index[beyond]] = True
            if sampled:
                return broken
            left = ~np.all(ends + self._bend(cells, pieces) <= slack, axis=1) & ~broken[index]
            if not np.any(left):
                return broken
            cells, pieces, index = cells.taken(left), np.tile(pieces[left], 2), index[left]
            half = 0.5 * cells.duration
            jets = np.concatenate([cells.jets, advanced(cells.jets, half)])
            cells = ClockPhases(np.tile(cells.owner, 2), jets, np.tile(half, 2))
            index = np.tile(index, 2)
        broken[index] = True
        return broken

    def _added(self, jets: Array, pieces: Indices) -> Array:
        """Return how large additional accelerations are (cells, items) where a clock has jets."""
        begin = self.breaks[pieces]
        x = np.clip((jets[:, 0] - begin) / (self.breaks[pieces + 1] - begin), 0.0, 1.0)
        first, second = (
            np.einsum("cirk,ck->cir", c[pieces], bernstein.basis(x, bernstein.degree(c)))
            for c in (self._first, self._second)
        )
        s, a = jets[:, 1, None, None], jets[:, 2, None, None]
        sizes: Array = np.linalg.norm((s**2 - 1.0) * second + a * first, axis=-1)
        return sizes

    def _bend(self, cells: ClockPhases, pieces: Indices) -> Array:
        """Return how much larger they may be within cells than at their ends (cells, items).

        That is (time)² / 8 times a bound of their second derivatives by time, and rounding.
        """
        _, s0, a0, j0 = cells.jets.T
        _, s1, a1, _ = cells.ends.T
        middle = s0 + 0.5 * cells.duration * a0  # the rate's coefficients hold it between them
        s = np.max(np.abs([s0, middle, s1]), axis=0)[:, None]
        a, j = np.maximum(np.abs(a0), np.abs(a1))[:, None], np.abs(j0)[:, None]
        u = np.maximum(1.0, s**2)  # of s² - 1
        second, third, fourth = (size[pieces] for size in self._sizes)
        bend = (3.0 * a**2 + 4.0 * s * j) * second + (5.0 * s**2 + u) * a * third
        bend += u * s**2 * fourth
        margins = [margin[pieces] for margin in self._margins]
        found: Array = cells.duration[:, None] ** 2 / 8.0 * bend + a * margins[0] + u * margins[1]
        return found


def _parts(motion: Motion) -> Iterator[tuple[slice, Array, Array]]:
    """Yield runs of pieces on which an object is carried, paths, and their slack.

    Paths are places times masses (pieces, items, coordinates, degree + 1) [kg m], or places [m].
    """
    breaks, phases = motion.drones.breaks, motion.phases
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        poses = motion.object_poses.coefficients[:, index]
        moving = np.any(np.ptp(poses, axis=-1) > STILL, axis=-1)
        for by, parts in ((HoldBy.REST, _resting), (HoldBy.GRIP, _gripped)):
            own = [p.hold is not None and (p.hold.object, p.hold.by) == (name, by) for p in phases]
            on = moving & np.array(own)[motion.phase_of_piece]
            edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
            for first, last in edges.reshape(-1, 2).tolist():
                run = slice(first, last)
                if by is HoldBy.REST and body.rim is None:  # which check support refuses
                    continue
                span = motion.taken(run, motion.overlapping(breaks[first], breaks[last]))
                yield run, *parts(span, index, body)


def _resting(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that rests on clasps all the time.

    Clasps carry shares of its mass; they take what its centre of mass, being higher, moves from
    clasp to clasp; friction carries the rim along with clasps; and the line of weight and inertia
    meets their plane within their polygon.
    """
    pose = motion.object_poses.coefficients[:, index]
    places = motion.vertices.coefficients[:, motion.team.layout.clasps]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(centre), bernstein.degree(places))
    places, centre = bernstein.elevate(places, order), bernstein.elevate(centre, order)
    assert body.rim is not None
    height = abs(body.centre_of_mass[2] - body.rim.height)
    supports = supports_of(motion, index, body)
    mass = body.mass * supports.shares
    moving = body.mass * height * np.linalg.norm(supports.gains, axis=-1)
    moving *= 1.0 + heading_error(pose[:, 3:])
    # Both add up in z: |a + b|² <= a² / f + b² / (1 - f).
    speeds = [np.abs(bernstein.differentiate(part)) for part in (places[:, :, 2], centre[:, :2])]
    upward = mass * np.max(speeds[0], axis=-1)
    moved = moving * np.max(speeds[1], axis=(1, 2))[:, None]
    total = upward + moved
    share = np.divide(upward, total, out=np.full_like(total, 0.5), where=total > 0.0)
    share = np.clip(share, EVEN, 1.0 - EVEN)
    loads = np.zeros((*mass.shape, ROWS, order + 1))
    loads[:, :, :2] = mass[..., None, None] * places[:, :, :2]
    loads[:, :, 2] = (mass / np.sqrt(share))[..., None] * places[:, :, 2]
    factor = moving / np.sqrt(1.0 - share)
    loads[:, :, 3:] = factor[..., None, None] * centre[:, None, :2]
    points = np.zeros((len(mass), mass.shape[1] + 1, ROWS, order + 1))
    points[:, :-1, :3], points[:, -1, :3] = places, centre
    durations = motion.drones.durations
    level, pressing = _accelerations(points[:, :, :3], durations)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = support.RULE.finders[0].find(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1:] / pressing[:, -1:])
    tipping = inside * pressing[:, -1:] / (lean + inside)
    slack = [equilibrium.spare_forces(motion), sliding, tipping]
    return np.concatenate([loads, points], axis=1), np.concatenate(slack, axis=1)


def _accelerations(points: Array, durations: Array) -> tuple[Array, Array]:
    """Return the largest level acceleration of points, and the least g + a_z (pieces, items)."""
    pushed = bernstein.differentiate(bernstein.differentiate(points))
    pushed = pushed / durations[:, None, None, None] ** 2
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing: Array = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    return level, pressing


def _gripped(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that edges grip all the time.

    They push it as a whole; friction bears it and turns it with them.
    """
    pose = motion.object_poses.coefficients[:, index]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(pose), bernstein.degree(centre))
    paths = np.zeros((len(pose), 2, ROWS, order + 1))
    paths[:, 0, :3] = body.mass * bernstein.elevate(centre, order)
    # |a| + |b| is at most the root of 2 (a² + b²).
    paths[:, 1, 0] = np.sqrt(2.0) * paths[:, 0, 2]
    turning = np.sqrt(2.0) * body.mass * grip.turning_reach(body)
    paths[:, 1, 1:3] = turning * bernstein.elevate(pose[:, 3:], order)
    ratio = grip.RULE.finders[0].find(motion, TIGHT).worst / grip.LIMIT
    loads = grip.gripped_loads(motion, index, body, np.arange(len(pose)))
    forces = np.min(equilibrium.spare_forces(motion), axis=1)
    return paths, np.stack([forces, (ratio - 1.0) * loads], axis=1)
