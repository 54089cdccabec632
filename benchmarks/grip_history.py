"""What a grip holds as friction leaves its clasps: cables slide as it closes, stick as it lifts.

While a hitch closes, both cables of a clasp slide through each other's bend, alike fast. Where they
touch their directions are perpendicular, so friction, which opposes their relative velocity, acts
at 45° to each cable: along it with ``μ/√2``. Edges then pull with ``λ = e^{-μβ/√2}`` times what
legs do, β the angle by which cables bend at the clasp, and clasps are farther out than planned.

The weight raises clasps above the contacts. Edges, which do not slide while λ is within
``e^{±μβ/√2}``, keep their length: sloping, also along their arcs, they draw the clasps in, bend
farther round the object and pull harder. So the slip load depends on the load, and differs from
that of clasps without friction in either direction. An arc presses with the level part of its
tension per angle, so the object slips under ``μ Σ T_k cos(α_k) θ_k``. Legs pull with a constant
tension toward their drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize, root

from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch import GRAVITY
from hitchopt.holding.wraps import Wraps, wraps_around
from hitchopt.objects import Section
from hitchopt.one_line import OneLine
from hitchopt.values import Array

BOTH_SLIDE = 0.5**0.5
"""Friction along a cable over that between both, where both slide alike fast."""

PASSES = 8
"""Times that friction is computed anew from the bends of what it closes."""

PRECISION = 1e-10
"""Tolerance of clasps in balance, as scipy's ``root`` takes it."""

UP = np.array([0.0, 0.0, 1.0])

POINTS, WEIGHTS = 0.5 + 0.15**0.5 * np.array([-1.0, 0.0, 1.0]), np.array([5.0, 8.0, 5.0]) / 18.0
"""Gauss's points on arcs, from 0 to 1, and their weights."""


@dataclass(frozen=True)
class Rounding:
    """Corners about which simulated ropes bend: of these only the nodes touch objects.

    Attributes
    ----------
    radius: of the corner and half of a rope's thickness [m].
    segment: distance of a rope's nodes [m].
    faces: angle between the normals of both faces [rad].
    """

    radius: float
    segment: float
    faces: float = 0.5 * np.pi

    def pressed(self, bends: Array) -> Array:
        """Return what two nodes on both sides of the corner press with, over tension times bend.

        They press at angles φ to the corner's bisector, which the corner's rounding gives them, or
        the faces, and the tension's sum is ``2 T sin(θ/2)``.

        Parameters
        ----------
        bends: (n,) [rad]
        """
        away = min(np.arcsin(min(0.5 * self.segment / self.radius, 1.0)), 0.5 * self.faces)
        shares: Array = 2.0 * np.sin(0.5 * bends) / (bends * np.cos(away))
        return shares


@dataclass(frozen=True, eq=False)
class LoadedGrip(OneLine):
    """A grip that carries a weight, in balance.

    Attributes
    ----------
    vertices: (n, 3) [m], clasps above the mean height of what edges touch.
    slopes: (n, 2), of edge k's straight parts, up to ``p_k`` and to ``p_{k+1}``.
    level: (n,) [N], level parts of edges' tensions.
    wraps: edges, seen from above.
    imbalance: largest force that is left over at a clasp, along an axis [N].
    """

    vertices: Array
    slopes: Array
    level: Array
    wraps: Wraps
    imbalance: float

    def slip_load(self, friction: float, corners: Rounding | None = None) -> float:
        """Return the weight [N] at which an object with that friction slips, without factor.

        Parameters
        ----------
        corners: of simulated ropes, where every edge bends about a single corner of the section.
        """
        angles = self.wraps.angles
        shares = 1.0 if corners is None else corners.pressed(angles)
        return friction * float(self.level @ (shares * angles))


@dataclass(frozen=True, eq=False)
class GripHistory(OneLine):
    """Cables that close around a section, and lift it.

    Parameters
    ----------
    section: about its own origin.
    tension: of every leg [N].
    clasp_friction: coefficient of cables on each other.
    cable_density: of all cables [kg/m]; what edges weigh is left out.
    thickness: diameter of cables [m]. Their centre lines are half of it away from the section, and
        as far from the middle of the contact at clasps, where they turn little.
    """

    section: Section
    tension: float
    clasp_friction: float
    cable_density: float = 0.0
    thickness: float = 0.0

    def closed(self, drones: Array, near: Array) -> Array:
        """Return clasps (n, 3) [m] where the hitch has closed, at height 0.

        Parameters
        ----------
        drones: (n, 2, 3) [m], ``q_k`` and ``r_k`` then, about the section's origin at the height of
            its contacts.
        near: (n, 2) [m], about where.
        """
        flat = np.array(near, dtype=np.float64)
        for _ in range(PASSES):
            least = self._ratios(_upright(flat), drones)
            ends = self._shifted(_upright(flat), drones)
            potential = partial(self._closing_potential, least=least, ends=ends)
            flat = minimize(potential, flat.ravel(), method="BFGS").x.reshape(flat.shape)
        return _upright(flat)

    def _closing_potential(self, x: Array, least: Array, ends: Array) -> float:
        """Return the potential over the tension [m] of clasps x (2 n,) [m] while cables slide."""
        places = x.reshape(-1, 2)
        legs = np.sum(length(_to_drones(_upright(places), ends)))
        return float(legs + least @ self._wraps(places).lengths)

    def lifted(self, closed: Array, drones: Sequence[Array], weight: float) -> LoadedGrip:
        """Return the grip that carries a weight [N], which passes to it in equal parts.

        Parameters
        ----------
        closed: (n, 3) [m], clasps at first, as ``closed`` returns them.
        drones: (n, 2, 3) [m] at every part, about the place where the plan has the object.
        """
        n, least = len(closed), self._ratios(closed, drones[0])
        x = np.concatenate([closed.ravel(), self.tension * least, [0.0]])
        for part, at in enumerate(drones, start=1):
            x, left = self._moved(x, at, weight * part / len(drones))
        vertices, level = x[: 3 * n].reshape(-1, 3), x[3 * n : -1]
        wraps, slopes = self._sloped(vertices)
        return LoadedGrip(vertices, slopes, level, wraps, left)

    def _moved(self, before: Array, drones: Array, load: float) -> tuple[Array, float]:
        """Return what balances a load [N], and the largest force [N] that is left over.

        Edges keep their lengths, but for those that would pull with more than ``1/λ`` times what
        legs do, or with less than λ times: these slide until they pull with as much.

        Parameters
        ----------
        before: clasps (n, 3) [m] above contacts, edges' level pulls (n,) [N], and how far contacts
            are below their plan [m], in one row; what is returned is alike.
        """
        n = (len(before) - 1) // 4
        places = before[: 3 * n].reshape(-1, 3)
        least = self._ratios(places - before[-1] * UP, drones)
        ends, lengths = self._shifted(places - before[-1] * UP, drones), self._free(places)
        most = np.full(n, np.nan)  # what sliding edges pull with, over legs

        def lacking(x: Array) -> Array:
            vertices, level = x[: 3 * n].reshape(-1, 3), x[3 * n : -1]
            wraps, slopes = self._sloped(vertices)
            along = np.stack([wraps.leaving, -wraps.arriving], axis=1)
            pulls = level[:, None, None] * np.concatenate([along, -slopes[..., None]], axis=-1)
            clasps = vertices - x[-1] * UP
            forces = self.tension * np.sum(unit(_to_drones(clasps, ends)), axis=1)
            forces += pulls[:, 0] + np.roll(pulls[:, 1], 1, axis=0)
            forces[:, 2] -= self._leg_weights(clasps, ends)
            ratio = np.mean(length(pulls), axis=-1) / self.tension
            longer = (self._free(vertices) - lengths) / lengths
            edges = np.where(np.isnan(most), longer, ratio - np.nan_to_num(most))
            return np.concatenate([forces.ravel(), edges, [-np.sum(pulls[..., 2]) - load]])

        for _ in range(PASSES):
            found = root(lacking, before, tol=PRECISION)
            vertices, level = found.x[: 3 * n].reshape(-1, 3), found.x[3 * n : -1]
            pulls = np.hypot(1.0, self._sloped(vertices)[1]) * level[:, None]
            ratio = np.mean(pulls, axis=-1) / self.tension
            slides = np.isnan(most) & ((ratio > 1.0 / least) | (ratio < least))
            if not np.any(slides):
                break
            most[slides] = np.where(ratio > 1.0, 1.0 / least, least)[slides]
        return found.x, float(np.max(np.abs(lacking(found.x)[: 3 * n])))

    def _sloped(self, vertices: Array) -> tuple[Wraps, Array]:
        """Return edges seen from above, and slopes (n, 2) of their straight parts, up to clasps.

        Where the object slips along an arc, friction on the cable is upright, and even by angle: a
        parabola, seen from its side, whose mean height is 0.

        Parameters
        ----------
        vertices: (n, 3) [m], clasps above the mean height of contacts.
        """
        wraps = self._wraps(vertices[:, :2])
        first, last = np.moveaxis(wraps.tangents + wraps.arcs[:, None] / 3.0, -1, 0)
        across = wraps.arcs / 6.0
        high, other = np.moveaxis(_edge_ends(vertices)[..., 2], -1, 0)
        slopes = np.stack([last * high + across * other, first * other + across * high], axis=-1)
        return wraps, slopes / (first * last - across**2)[:, None]

    def _free(self, vertices: Array) -> Array:
        """Return edges' lengths (n,) [m] between clasps, above the mean height of contacts."""
        wraps, slopes = self._sloped(vertices)
        straight = np.sum(np.hypot(1.0, slopes) * wraps.tangents, axis=-1)
        on_arcs = POINTS * np.sum(slopes, axis=-1, keepdims=True) - slopes[:, :1]
        lengths: Array = straight + wraps.arcs * (np.hypot(1.0, on_arcs) @ WEIGHTS)
        return lengths

    def _leg_weights(self, clasps: Array, ends: Array) -> Array:
        """Return what legs weigh on clasps (n,) [N]: half of them."""
        legs = np.sum(length(_to_drones(clasps, ends)), axis=-1)
        weights: Array = 0.5 * GRAVITY * self.cable_density * legs
        return weights

    def _ratios(self, clasps: Array, drones: Array) -> Array:
        """Return edges' least tensions over legs' (n,), means of both clasps' ``e^{-μβ/√2}``."""
        q, r = np.moveaxis(unit(_to_drones(clasps, drones)), 1, 0)
        legs = np.arccos(np.clip(dot(q, r), -1.0, 1.0))
        bends = 0.5 * (legs + self._wraps(clasps[:, :2]).clasp_angles)
        least = np.exp(-BOTH_SLIDE * self.clasp_friction * bends)
        ratios: Array = 0.5 * (least + np.roll(least, -1))
        return ratios

    def _wraps(self, clasps: Array) -> Wraps:
        """Return the edges' centre lines around the section, seen from above."""
        return wraps_around(_Grown(self.section, self.thickness), clasps)

    def _shifted(self, clasps: Array, drones: Array) -> Array:
        """Return drones (n, 2, 3) [m], aside by as much as legs pass the middle of the contact."""
        if self.thickness == 0.0:
            return drones
        along = unit(_to_drones(clasps, drones))
        outward = unit(np.sum(along, axis=1))[:, None]
        aside = unit(outward - dot(outward, along)[..., None] * along)
        moved: Array = drones - 0.5 * self.thickness * _by_cables(aside)
        return moved


class _Grown(Section):
    """A section with a margin all around."""

    def __init__(self, section: Section, margin: float) -> None:
        super().__init__(section.outline, section.radius)
        object.__setattr__(self, "_margin", margin)

    @property
    def rounding(self) -> float:
        """Radius [m] of the discs that make it of its core."""
        return super().rounding + float(self._margin)  # type: ignore[attr-defined]


def _upright(flat: Array) -> Array:
    """Return points (…, 3) at height 0."""
    return np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1)


def _edge_ends(vertices: Array) -> Array:
    """Return the clasps (n, 2, 3) at both ends of every edge."""
    return np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)


def _to_drones(clasps: Array, drones: Array) -> Array:
    """Return vectors (n, 2, 3) from clasps to the drones of their legs, ``q_k`` and ``r_{k-1}``."""
    ends = np.stack([drones[:, 0], np.roll(drones[:, 1], 1, axis=0)], axis=1)
    vectors: Array = ends - clasps[:, None]
    return vectors


def _by_cables(at_clasps: Array) -> Array:
    """Return what belongs to clasps' legs (n, 2, …), ``q_k`` and ``r_{k-1}``, by their cables."""
    return np.stack([at_clasps[:, 0], np.roll(at_clasps[:, 1], -1, axis=0)], axis=1)
