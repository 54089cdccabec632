"""What a grip holds as friction leaves its clasps: cables slide as it closes, stick as it lifts.

While a hitch closes, both cables of a clasp slide through each other's bend, alike fast. Where they
touch their directions are perpendicular, so friction, which opposes their relative velocity, acts
at 45° to each cable: along it with ``μ/√2``. Edges then pull with ``λ = e^{-μβ/√2}`` times what
legs do, β the angle by which cables bend at the clasp, and clasps are farther out than planned.

The weight raises clasps above the plane of contact. Edges, which do not slide while λ is within
``e^{±μβ/√2}``, keep their length: sloping, they draw the clasps in, bend farther round the object
and pull harder. So the slip load depends on the load, and differs from that of clasps without
friction in either direction. Legs pull with a constant tension toward their drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

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

PRECISION = 1e-13
"""Tolerance of potentials over tension and length, as SLSQP takes it."""


@dataclass(frozen=True, eq=False)
class LoadedGrip(OneLine):
    """A grip that carries a weight, in balance.

    Attributes
    ----------
    vertices: (n, 3) [m], clasps above the plane in which edges met the object at first.
    departures: (n, 2, 3) [m], where edge k leaves the object toward ``p_k`` and ``p_{k+1}``.
    tensions: (n,) [N], of edges.
    wraps: edges, seen from above.
    imbalance: largest force that is left over at a clasp [N].
    """

    vertices: Array
    departures: Array
    tensions: Array
    wraps: Wraps
    imbalance: float

    def slip_load(self, friction: float) -> float:
        """Return the weight [N] at which an object with that friction slips, without factor."""
        return friction * float(self.tensions @ self.wraps.angles)


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
        n = len(closed)
        wraps = self._wraps(closed[:, :2])
        departures = np.concatenate([wraps.contacts, np.zeros((n, 2, 1))], axis=-1)
        x = np.append(closed.ravel(), 0.0)
        for part, at in enumerate(drones, start=1):
            load = weight * part / len(drones)
            x = self._moved(x, departures, at, load)
            vertices = x[:-1].reshape(-1, 3) + [0.0, 0.0, x[-1]]
            wraps = self._wraps(vertices[:, :2])
            away = _edge_ends(vertices) - departures  # what is laid on the object slopes like these
            slopes = away[..., 2] / length(away[..., :2])
            heights = _edge_ends(vertices)[..., 2] - slopes * wraps.tangents
            departures = np.concatenate([wraps.contacts, heights[..., None]], axis=-1)
        ends = self._shifted(x[:-1].reshape(-1, 3), drones[-1])
        tensions, left = self._balanced(x, vertices, departures, ends)
        return LoadedGrip(vertices, departures, tensions, wraps, left)

    def _moved(self, before: Array, departures: Array, drones: Array, load: float) -> Array:
        """Return clasps, and how far the object is below its plan, in balance with a load [N].

        They minimise the potential of legs and loads, free parts of edges keeping their lengths but
        for what slides: out of the legs at ``1/λ``, into them at λ.
        """
        clasps = before[:-1].reshape(-1, 3)
        n, least = len(clasps), self._ratios(clasps, drones)
        ends = self._shifted(clasps, drones)
        hung = self._leg_weights(clasps, ends) / self.tension
        slides = np.concatenate([1.0 / least, -least])

        def free(x: Array) -> Array:
            vertices = x[: 3 * n].reshape(-1, 3) + [0.0, 0.0, x[3 * n]]
            lengths: Array = np.sum(length(_edge_ends(vertices) - departures), axis=-1)
            return lengths

        def potential(x: Array) -> float:
            places = x[: 3 * n].reshape(-1, 3)
            legs = np.sum(length(_to_drones(places, ends)))
            lowered = load / self.tension * x[3 * n]
            return float(legs + hung @ places[:, 2] - lowered + slides @ x[3 * n + 1 :])

        at_first = free(before)

        def stretched(x: Array) -> Array:
            out, back = x[3 * n + 1 :].reshape(2, -1)
            return free(x) - at_first - out + back

        settings: Any = {
            "bounds": [(None, None)] * (3 * n + 1) + [(0.0, None)] * (2 * n),
            "constraints": [{"type": "eq", "fun": stretched}],
            "options": {"maxiter": 400, "ftol": PRECISION},
        }
        start = np.append(before, np.zeros(2 * n))
        found = minimize(potential, start, method="SLSQP", **settings)
        moved: Array = found.x[: 3 * n + 1]
        return moved

    def _balanced(
        self, x: Array, vertices: Array, departures: Array, ends: Array
    ) -> tuple[Array, float]:
        """Return edges' tensions (n,) [N] that balance clasps best, and what is left over [N]."""
        clasps = x[:-1].reshape(-1, 3)
        n = len(clasps)
        along = unit(departures - _edge_ends(vertices))  # (n, 2, 3), from the clasps
        pulls = np.zeros((n, 3, n))
        pulls[np.arange(n), :, np.arange(n)] += along[:, 0]
        pulls[(np.arange(n) + 1) % n, :, np.arange(n)] += along[:, 1]
        forces = self.tension * np.sum(unit(_to_drones(clasps, ends)), axis=1)
        forces[:, 2] -= self._leg_weights(clasps, ends)
        rows = pulls.reshape(3 * n, n)
        tensions = np.linalg.lstsq(rows, -forces.ravel(), rcond=None)[0]
        left = rows @ tensions + forces.ravel()
        return tensions, float(np.max(length(left.reshape(-1, 3))))

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
