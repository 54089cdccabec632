"""The check of the clasps: ``equilibrium`` of the cables' forces.

Pulls of legs may differ from those of their edges by friction (``hitchopt.checks.friction``); what
exceeds it counts as a residual of ``equilibrium``.

The q-leg and the edge of cable k meet the r-leg and the edge of cable k-1 at clasp k. Each pulls on
it along its end there (``hitchopt.hitch.taut``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check, with_tolerance
from hitchopt.checks.friction import friction_excess, leg_excess
from hitchopt.checks.grips import bent_freely, missing_force, unbalanced
from hitchopt.checks.objects import select
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.sagging import sagging_part
from hitchopt.checks.spans import (
    MotionSpans,
    bent_edges,
    cached,
    derivative_margin,
    joined_arrays,
    leg_vectors,
    without_shared_zeros,
)
from hitchopt.geometry.vectors import column_lengths, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import level_pull
from hitchopt.hitch.taut import TautPart
from hitchopt.motion.loads import leg_tensions, object_loads, strut_shares, tautness
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import Extremum, worst
from hitchopt.values import Array, Indices, lazy

BALANCE_LIMIT = 5e-3  # Relative to the tension: vertices are then within millimetres
OPEN_ROLL = 175.0  # [deg] Smallest roll of open clasps: at 180° both cables are straight
ROUGH_ORDER = 3  # degree of factors that detect open clasps, which are far from closed ones
LEG_ENDS = np.array([0, 1])  # Legs at a clasp: q of the cable ahead, r of the cable behind

Flags = NDArray[np.bool_]


def both_cables(motion: Motion) -> Indices:
    """Return the cables ahead of and behind clasps (clasps, 2)."""
    return np.stack([motion.team.layout.ahead, motion.team.layout.behind], axis=1)


@dataclass(frozen=True, eq=False)
class ClaspSizes:
    """Magnitudes of forces at clasps, for the cables ahead and behind.

    All but ``loads`` are (pieces, clasps, 2, degree + 1). A common factor ``x^a (1 - x)^b``, as
    where tensions rise from zero, is divided out: it cancels in every ratio.
    """

    legs: Array  # [N], tensions of legs
    edges: Array  # [N], tensions of edges, without the fraction of a rim
    leg_half_densities: Array  # [N/m], half of the weight of legs per length
    # [N/m], half of the weight of edges per length
    edge_half_densities: Array
    half_loads: Array  # [N], half of the clasp's load
    loads: Array  # (pieces, clasps, 3, degree + 1) [N], forces of objects


@cached
def clasp_sizes(motion: Motion) -> ClaspSizes:
    """Return the magnitudes of forces at clasps."""
    team = motion.team
    cables = both_cables(motion)
    half_density = 0.5 * GRAVITY * team.cable_density  # [N/m]
    taut = tautness(motion)
    half_loads = 0.5 * GRAVITY * team.load[:, None, None]
    loads = object_loads(motion)
    if loads is None:
        loads = np.zeros((len(taut), len(cables), 3, 1))
    tables = [
        leg_tensions(motion)[:, 2 * cables + LEG_ENDS],
        edge_tensions(motion)[:, cables],
        half_density * taut[:, cables],
        half_density * taut[:, cables],
        half_loads * taut[:, cables],
        loads,
    ]
    return ClaspSizes(*without_shared_zeros(tables))


@cached
def has_loads(motion: Motion) -> bool:
    """Return whether cables or clasps carry weight."""
    sizes = clasp_sizes(motion)
    weights = sizes.leg_half_densities, sizes.half_loads, sizes.loads
    return any(bool(np.any(weight)) for weight in weights)


def edge_tensions(motion: Motion) -> Array:
    """Return the pulls of edges (pieces, n, degree + 1) [N], without the fraction of a rim."""
    return _without_strut(motion, motion.tensions.coefficients)


def _without_strut(motion: Motion, values: Array) -> Array:
    """Return values of edges (pieces, n, degree + 1) without the share that rims take."""
    shares = strut_shares(motion)
    return values if shares is None else bernstein.multiply(1.0 - shares[:, None], values)


def clasp_names(motion: Motion) -> Sequence[str]:
    """Return the clasps' names."""
    return [motion.team.point_names[k] for k in motion.team.layout.clasps]


class LegsAndEdges(NamedTuple):
    """A quantity (spans, 2) of the legs, and of the edges, of the cables ahead and behind."""

    legs: Enclosed
    edges: Enclosed

    @classmethod
    def split(cls, value: Enclosed) -> LegsAndEdges:
        """Return the parts of values (spans, 2, 2) of legs and edges."""
        radius = np.broadcast_to(value.r, value.c.shape[:-2])
        return cls(
            legs=Enclosed(value.c[:, 0], radius[:, 0]), edges=Enclosed(value.c[:, 1], radius[:, 1])
        )


class RollTerms(NamedTuple):
    """Cosine and sine of a clasp's roll, up to a common positive factor."""

    cosine: Enclosed

    sine_over_pull: Enclosed  # The sine, divided by the norm of ``pull``
    pull: Enclosed  # The sum V of both legs' pulls [N], up to the factor of ``ClaspSizes``


class Clasps(MotionSpans):
    """Spans of clasps, with the forces (spans, 2) of the cables ahead and behind."""

    names = staticmethod(clasp_names)

    hooked: Flags | None = None
    """(spans,), whether cables are known to be hooked; None if that is not known of any.

    ``_balance`` sets it, and parts of the spans inherit it."""

    def _like(self, index: Any, extent: Array | None, *, points: bool = False) -> Self:
        spans = super()._like(index, extent, points=points)
        spans.hooked = None if self.hooked is None else self.hooked[index]
        return spans

    @lazy
    def cables(self) -> Indices:
        """(spans, 2) The cables ahead and behind."""
        return both_cables(self.source)[self.item]

    @property
    def sizes(self) -> ClaspSizes:
        """Magnitudes of forces, on whole pieces."""
        return clasp_sizes(self.source)

    def exact(self, table: Array) -> Enclosed:
        """Return exact scalars (spans, 2) from a table of ``sizes``."""
        return Enclosed(self.read(table)[..., None, :])

    @lazy
    def chords(self) -> Enclosed:
        """Chords (spans, 2, 2) of legs, then of edges, from the clasp [m]."""
        chords = self.read(_chords(self.source))
        return Enclosed(chords.reshape(-1, 2, 2, *chords.shape[2:]), self.noise)

    @lazy
    def along(self) -> Enclosed:
        """Directions of legs, q̂_k and r̂_{k-1}, then of edges, u_k and -u_{k-1} (spans, 2, 2)."""
        return self.chords.direction

    @lazy
    def pulls(self) -> LegsAndEdges:
        """Forces of legs and edges on the clasp, vectors [N]."""
        leg_tensions = self.exact(self.sizes.legs)
        edge_tensions = self.exact(self.sizes.edges)
        if self.source.team.cable_density == 0.0:
            directions = LegsAndEdges.split(self.along)
            return LegsAndEdges(directions.legs * leg_tensions, directions.edges * edge_tensions)
        legs, edges = LegsAndEdges.split(self.chords)
        leg = self._taut(legs, self.sizes.leg_half_densities, leg_tensions)
        of_legs = leg.force() * leg_tensions
        if self.source.has_wraps:
            return LegsAndEdges(of_legs, self._pulls_of_wrapped(leg.length, edge_tensions))
        edge = self._taut(edges, self.sizes.edge_half_densities, edge_tensions)
        return LegsAndEdges(of_legs, edge.force() * edge_tensions)

    def _taut(self, chords: Enclosed, half_densities: Array, tensions: Enclosed) -> TautPart:
        """Return parts (spans, 2) from the clasp, with their tensions there."""
        return sagging_part(chords, self.exact(half_densities) * tensions.inverse)

    def _pulls_of_wrapped(self, legs: Enclosed, tensions: Enclosed) -> Enclosed:
        """Return the forces (spans, 2) [N] of edges that are wrapped around an object.

        Such an edge sags with its whole length: the cable without its legs, of lengths [m] here.
        """
        team = self.source.team
        # A drone at a chain's end has no leg, regardless of its stored vector.
        vectors = leg_vectors(self.source) * team.layout.has_leg.reshape(-1, 1, 1)
        others = Enclosed(self.read(vectors, 2 * self.cables + (1 - LEG_ENDS)), self.noise)
        other_legs = self._taut(others, self.sizes.leg_half_densities, self.exact(self.sizes.legs))
        cable_length = Enclosed(team.cable_length[self.cables][..., None, None])
        wrapped = cable_length - legs - other_legs.length
        half_weight: Enclosed = self.exact(self.sizes.edge_half_densities) * wrapped
        pull: Enclosed = level_pull(tensions, half_weight)
        along: Enclosed = LegsAndEdges.split(self.along).edges * pull
        return along - half_weight.along_z()

    @lazy
    def forces(self) -> Enclosed:
        """Both cables' forces [N], each of its leg and its edge."""
        return self.pulls.legs + self.pulls.edges

    @lazy
    def half_load(self) -> Enclosed:
        """[N] Half of the clasp's load, for both cables."""
        return self.exact(self.sizes.half_loads)

    @lazy
    def object_force(self) -> Enclosed:
        """[N] Force of objects on the clasp."""
        motion = self.source
        loads = self.read(self.sizes.loads)
        objects = motion.requirements.objects.values()
        mass = sum(body.mass for body in objects if not body.fixed)
        clasps = motion.team.layout.clasps[self.item]
        error = mass * derivative_margin(motion.vertices, 2)[self.piece, clasps]
        loaded = np.any(loads != 0.0, axis=(1, 2))
        return Enclosed(loads, np.where(loaded, error, 0.0))

    @lazy
    def residual(self) -> Enclosed:
        """The sum of all forces on the clasp [N]."""
        force = self.forces.sum()
        if has_loads(self.source):
            force = force - self.half_load.sum().along_z() + self.object_force
        return force

    @lazy
    def contact(self) -> Enclosed:
        """Force of each cable on the other [N]: it balances the other's with half of the load."""
        if not has_loads(self.source):
            return -self.forces
        radius = np.asarray(self.object_force.r)
        object_force = Enclosed(self.object_force.c[:, None], radius[..., None])
        return self.half_load.along_z() - self.forces - object_force * 0.5

    @lazy
    def roll_terms(self) -> RollTerms:
        """Cosine and sine of the roll, up to a common positive factor.

        With V the sum of the legs' pulls, D their difference and ū = u_k + u_{k-1}, cosine and sine
        are proportional to ``(D·ū) V² - (D·V) (ū·V)`` and ``D·(ū × V) |V|``.
        """
        directions = LegsAndEdges.split(self.along)
        leg_pulls = self.pulls.legs.reduced(ROUGH_ORDER)
        q_pull = select(leg_pulls, 0)
        r_pull = select(leg_pulls, 1)
        leaving = select(directions.edges, 0)
        arriving = -select(directions.edges, 1)
        onward = (leaving + arriving).reduced(ROUGH_ORDER)
        total = q_pull + r_pull
        difference = q_pull - r_pull
        cosine = difference.dot(onward) * total.dot(total)
        cosine = cosine - difference.dot(total) * onward.dot(total)
        return RollTerms(cosine, difference.dot(onward.cross(total)), total)

    def rolls(self) -> Array:
        """Return the rolls (spans,) [deg] at mid span: 0 if ``q̂_k`` leans toward ``u_k``."""
        edge_ahead, edge_behind = np.moveaxis(self.along.middle[:, 1], 1, 0)
        q, r = np.moveaxis(self.pulls.legs.middle, 1, 0)
        axis = unit(q + r)
        upward = np.cross(edge_ahead - edge_behind, axis)
        level = np.cross(axis, upward)
        rise = np.sum(q * upward, axis=-1)
        run = np.sum(q * level, axis=-1)
        return np.asarray(np.degrees(np.arctan2(rise, run)))


@cached
def _chords(motion: Motion) -> Array:
    """Return chords (pieces, clasps, 4, 3, N+1) [m] of legs, then of edges, from the clasp."""
    legs = leg_vectors(motion)
    leaving, arriving = bent_edges(motion)
    ahead = motion.team.layout.ahead
    behind = motion.team.layout.behind
    chords = [legs[:, 2 * ahead], legs[:, 2 * behind + 1], leaving[:, ahead], -arriving[:, behind]]
    return joined_arrays([chord[:, :, None] for chord in chords], axis=2)


def _relative(force: Enclosed, spans: Clasps) -> Bound:
    """Return the upper bound of a scalar, or of the norm of a vector, over the smaller tension.

    It is infinite where a tension is not positive.
    """
    tensions = spans.exact(spans.sizes.edges)
    force_coefficients, tension_coefficients = same_degree(force.c, tensions.c)
    if force_coefficients.shape[1] == 1:
        sizes = force_coefficients[:, 0]
    else:
        sizes = column_lengths(force_coefficients)
    sizes = sizes + np.asarray(force.r)[..., None]
    smaller_tension = np.minimum.reduce(tension_coefficients, axis=1)[:, 0]
    positive = smaller_tension > 0.0
    ratio = np.where(positive, sizes / np.where(positive, smaller_tension, 1.0), np.inf)
    return Enclosed(ratio[:, None]).upper


def _balance(spans: Clasps) -> Bound:
    """Return the norm of the residual over the smaller tension; infinite where a clasp is open.

    While tensions rise or fall, weights are scaled with them: of real ones no balance is claimed.
    """
    residual = _relative(spans.residual, spans)
    if spans.hooked is not None and spans.hooked.all():
        return residual
    opening = _opening(spans)
    if has_loads(spans.source):
        opening = largest_of([opening, _rolling(spans)])
    hooked = opening.value < 0.0
    spans.hooked = hooked  # the search halves these spans: halves of hooked ones stay hooked
    value = np.where(hooked, residual.value, np.inf)
    return Bound(value, np.where(hooked, residual.x, opening.x))


def _opening(spans: Clasps) -> Bound:
    """Return the largest product, negative where a clasp is closed, over the smaller tension.

    A clasp is closed where ``C·q̂_k < 0``, ``C·u_k < 0``, ``C·r̂_{k-1} > 0`` and ``C·u_{k-1} < 0``.
    Friction tilts C along the cables: with it, the mean of each cable's two products counts.
    Without a load, each is ``-2 T cos²(φ/2) cos²(ψ/2)`` for a roll ψ and an exterior angle φ. Its
    magnitude at OPEN_ROLL is added, so clasps count as open beyond it.
    """
    along = spans.along.reduced(ROUGH_ORDER)
    contact = spans.contact.reduced(ROUGH_ORDER)
    if spans.source.leg_tensions_differ:
        products = contact.dot(along.sum(-2) * 0.5)
    else:  # the contact force with legs, and with edges
        for_each_kind = Enclosed(contact.c[:, None], np.asarray(contact.r)[:, None])
        products = for_each_kind.dot(along)
    upper = products.c[..., 0, :] + np.asarray(products.r)[..., None]
    of_one_span = tuple(range(1, upper.ndim - 1))
    largest_product = Enclosed(np.maximum.reduce(upper, axis=of_one_span)[:, None])
    largest = _relative(largest_product, spans)
    edges = LegsAndEdges.split(along).edges
    onward = select(edges, 0) - select(edges, 1)  # u_k + u_{k-1}, of the norm 2 cos(φ/2)
    share = math.cos(math.radians(0.5 * OPEN_ROLL)) ** 2
    at_open_roll = 0.5 * share * onward.norm_upper.value**2
    return Bound(largest.value + at_open_roll, largest.x)


def _rolling(spans: Clasps) -> Bound:
    """Return a bound that is negative where a clasp has rolled by less than OPEN_ROLL.

    It holds for any load: legs of heavily loaded clasps could wind around their edges in contact.
    The bound is the largest of ``tan(OPEN_ROLL) cos ψ - |sin ψ|``, at the smallest cosine, since
    the tangent is negative.
    """
    terms = spans.roll_terms
    sine_over_pull = terms.sine_over_pull.range
    least_sine = np.maximum(np.maximum(sine_over_pull.low, -sine_over_pull.high), 0.0)
    least_sine = least_sine * terms.pull.norm_lower.value
    cosine = terms.cosine.lower
    return Bound(math.tan(math.radians(OPEN_ROLL)) * cosine.value - least_sine, cosine.x)


def _worst_residual(motion: Motion, limit: float) -> WorstCase:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    Pulls beyond friction and missing forces on objects count as residuals. Cables must also press
    on each other at all times: otherwise one may have passed through the other, and the residual is
    infinite, as it is where an edge bends on its own.
    """
    largest = worst(Clasps.of(motion), _balance, "max", target=with_tolerance(limit, "max"))
    where = [Clasps.names(motion)[largest.item]]
    if math.isinf(largest.value):
        where += _open_clasp(motion, largest)
    cases = [WorstCase(largest.worst, largest.time, tuple(where)), unbalanced(motion)]
    if motion.leg_tensions_differ:
        cases.append(friction_excess(motion))
    if motion.has_wraps:
        cases.append(bent_freely(motion))
    return max(cases, key=lambda case: case.worst)


def _open_clasp(motion: Motion, at: Extremum) -> tuple[str, ...]:
    """Return words on an open clasp with its roll, if its forces are balanced."""
    breaks = motion.drones.breaks
    piece = max(0, int(np.searchsorted(breaks, at.time)) - 1)
    place = (at.time - breaks[piece]) / motion.drones.durations[piece]
    spans = Clasps(motion, breaks, np.array([piece]), np.array([at.item]))
    point = spans.at(np.array([place]))
    with np.errstate(all="ignore"):
        if not math.isfinite(_relative(point.residual, point).value[0]):
            return ()
        return (f"open at a roll of {point.rolls()[0]:.0f}°",)


def spare_forces(motion: Motion) -> Array:
    """Return the spare loads of clasps (pieces, clasps) [N], with which equilibrium still holds.

    Half of an additional load enters the products of ``contact``.
    """
    spare_residual = BALANCE_LIMIT - _worst_residual(motion, BALANCE_LIMIT).worst
    spare_contact = -2.0 * worst(Clasps.of(motion), _opening, "max").worst
    lowest_tensions: Array = np.min(edge_tensions(motion)[:, both_cables(motion)], axis=(2, 3))
    return min(spare_residual, spare_contact) * lowest_tensions


FORMULAS = (
    _balance,
    Clasps.residual,
    _opening,
    _rolling,
    Clasps.contact,
    leg_excess,
    missing_force,
)

HEAVY_REMEDY = (
    "raise the tension, or use lighter cables (team.cable_density), if these sag too far to balance"
)
"""Remedy for clasps of cables so heavy that the model of their sag is too coarse."""


def _balance_remedy(motion: Motion, check: Check) -> str:
    """Return what to do about cables that sag too far; empty for other faults of the balance."""
    is_heavy = motion.team.cable_density > 0.0 and motion.hold_at(check.time) is None
    return HEAVY_REMEDY if is_heavy else ""


EQUILIBRIUM = CheckRule(
    "equilibrium",
    "ratio",
    "max",
    BALANCE_LIMIT,
    (Evaluator(_worst_residual, lambda state: state.hitched, formulas=FORMULAS),),
    remedy_at=_balance_remedy,
    group="forces",
    bodies=(("clasps",),),
    is_error=True,
    proves="the largest force residual at a clasp, over the smaller tension; the excess of a leg's "
    r"pull, over its edge's, beyond $e^{\pm\mu\beta}$ (friction); infinite if cables do not press "
    "on each other",
    unproven="balance of the whole weight while tensions rise or fall (`tension`, `relax`); "
    "stiffness: vertices stay within millimetres only while drones are in place",
)
