"""Friction at the clasps, from forces on both sides of cables that slide through them.

Forces balance linearly in what legs and edges pull with. Friction makes the pulls of a cable's legs
and edge differ, therefore each part has its own. All windows are treated at once as a sparse
system; its size is linear in windows times robots.

Friction acts against the velocity with which one cable's surface moves over the other's. With rates
v_a and v_b at which the cables a and b of a clasp slide toward their legs, and c the cosine between
these directions where they touch, the leg of a is pulled harder than its edge by

    log(T_leg / T_edge) = μ Θ_a (v_a - c v_b)/w,    w² = v_a² + v_b² - 2 c v_a v_b,

Θ_a being the angle by which it turns in space; b likewise. It is Coulomb's law: friction on a is
``-μ N (v_a t_a - v_b t_b)/w`` with the normal force ``N = T Θ`` and directions t toward the legs,
and only its part along t_a changes the tension of a. A cable that slides alone has the ratio of a
capstan and drags the other along; where both slide alike, friction acts across them for the most
part, and ratios are less. Θ and c are geometry: cables whose ends lie in one plane pass over and
under each other, turn farther than in the plane, and touch where they cross.

The angle ψ between friction and a cable is known less well than the sizes of forces. Its error
changes ``cos ψ`` by ``sin ψ``, not at all where a cable slides alone; this weighs the estimates.

Of the logarithms of a clasp's two ratios the sum follows from the directions of legs and edges; the
difference is that of the two cables' tensions, which drones measure by giving way, and which their
noise changes much more. They are weighed by their scatter, and by how well the law knows their
direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import splu

from hitchopt.errors import OneLine
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.hitch.forces import tension_at
from hitchopt.statics.recordings import WINDOW, Recording, Windows
from hitchopt.values import Array

ROUNDS = 30
"""Number of reweightings of a robust mean, which converge by a factor of some 3 each."""

TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Estimate(OneLine):
    """One estimated quantity.

    Attributes
    ----------
    value: nan where the recording does not determine it.
    error: standard error; infinite where it is not determined.
    remark: why it is not determined, or empty.
    """

    value: float
    error: float
    remark: str = ""

    @property
    def known(self) -> bool:
        """Whether the recording determines it."""
        return not self.remark

    @classmethod
    def unknown(cls, remark: str) -> Estimate:
        """Return the estimate of a quantity that the recording does not determine."""
        return cls(float("nan"), float("inf"), remark)


def scale_of(residuals: Array, axis: int | None = None) -> Array:
    """Return the spread of residuals about zero that outliers do not change."""
    spread: Array = np.asarray(TO_SIGMA * np.median(np.abs(residuals), axis=axis))
    return spread


def robust_mean(values: Array, least_scale: float) -> tuple[Array, Array]:
    """Return means over the first axis that outliers hardly change, and their standard errors.

    It minimises ``Σ 2 (√(1 + (r/s)²) - 1)``, the loss ``soft_l1`` of scipy's ``least_squares``, by
    reweighting, all columns at once.

    Parameters
    ----------
    values: (samples, …), independent ones.
    least_scale: smallest scale s.
    """
    centre = np.median(values, axis=0)
    scale = np.maximum(scale_of(values - centre, 0), least_scale)
    weights = np.ones_like(values)
    for _ in range(ROUNDS):
        weights = 1.0 / np.sqrt(1.0 + ((values - centre) / scale) ** 2)
        centre = np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
    count = len(values)
    if count < 2:
        return centre, np.full_like(centre, np.inf)
    # Of an M-estimator: the influence r w(r) over its slope, which is w³ for this loss.
    influence = np.sum((weights * (values - centre)) ** 2, axis=0) * count / (count - 1.0)
    errors = np.sqrt(influence) / np.sum(weights**3, axis=0)
    return centre, np.maximum(errors, least_scale / np.sqrt(count))


Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ForceBalance:
    """Forces on clasps and drones at measured places, as functions of the parts' pulls.

    The unknowns of a window are the pulls of the n edges, then those of the legs, q0, r0, q1, …
    as far as there are legs; those of windows follow each other.

    Attributes
    ----------
    windows: where it was measured, and what was commanded there.
    parts: legs and edges.
    clasps: sparse (windows · clasps · 3, unknowns), forces of unit pulls on the clasps.
    weights: (windows · clasps · 3,) [N], weight of cables and loads that clasps carry.
    leg_unknown: (2n,), unknown that pulls at each drone, within its window.
    outward: (windows, 2n, 3), directions from the points that cables lead to.
    hanging: (windows, 2n, 3) [N], weight of the cables that drones carry.
    half: half of the weight of cables per length [N/m].
    """

    windows: Windows
    parts: CableParts
    clasps: csr_array
    weights: Array
    leg_unknown: Index
    outward: Array
    hanging: Array
    half: float

    @property
    def per_window(self) -> int:
        """Number of unknowns of a window."""
        return int(np.max(self.leg_unknown)) + 1

    @classmethod
    def of(cls, team: Team, windows: Windows, density: float) -> ForceBalance:
        """Return the balance at measured windows, of cables of a density [kg/m]."""
        layout, n, count = team.layout, team.robots, len(windows.t)
        parts = CableParts.of(team, windows.drones, windows.vertices)
        has_leg = layout.has_leg.ravel()
        leg_unknown = np.repeat(np.arange(n), 2)
        leg_unknown[has_leg] = n + np.arange(np.sum(has_leg))
        per_window = n + int(np.sum(has_leg))
        after, before = layout.ahead, layout.behind
        q, r = 2 * after, 2 * before + 1
        columns = np.stack([leg_unknown[q], after, leg_unknown[r], before], axis=-1)
        forces = np.stack(
            [
                parts.outward[:, q],
                parts.along[:, after],
                parts.outward[:, r],
                -parts.along[:, before],
            ],
            axis=-2,
        )  # (windows, clasps, 4, 3)
        clasps = len(after)
        w, c, _, axis = np.indices(forces.shape)
        rows = (w * clasps + c) * 3 + axis
        at = w * per_window + columns[None, :, :, None]
        shape = (count * clasps * 3, count * per_window)
        matrix = coo_array((forces.ravel(), (rows.ravel(), at.ravel())), shape=shape).tocsr()
        half = 0.5 * GRAVITY * density
        carried = half * (
            parts.legs[:, q] + parts.edges[:, after] + parts.legs[:, r] + parts.edges[:, before]
        )
        weights = np.zeros((count, clasps, 3))
        weights[..., 2] = carried + GRAVITY * team.load
        own = np.where(has_leg, parts.legs, np.repeat(parts.edges, 2, axis=-1))
        hanging = np.zeros_like(windows.drones)
        hanging[..., 2] = half * own
        return cls(
            windows, parts, matrix, weights.ravel(), leg_unknown, parts.outward, hanging, half
        )

    def first_guess(self) -> Array:
        """Return the planned tensions for unknowns (windows · per_window,) [N]."""
        n = self.windows.tensions.shape[1]
        guess = np.zeros((len(self.windows.t), self.per_window))
        guess[:, :n] = self.windows.tensions
        guess[:, self.leg_unknown] = np.repeat(self.windows.tensions, 2, axis=-1)
        return guess.ravel()

    def tensions(self, pulls: Array) -> Array:
        """Return the tensions at the clasps (windows, 2n, 2) of legs and edges, drone by drone [N].

        Parameters
        ----------
        pulls: (windows, unknowns) [N], along the chords.
        """
        parts, drones = self.parts, np.arange(len(self.leg_unknown))
        inward = parts.along[:, drones // 2] * np.where(drones % 2, -1.0, 1.0)[:, None]
        sizes = np.stack([parts.legs, parts.edges[:, drones // 2]], axis=-1)
        rise = sizes * np.stack([self.outward[..., 2], inward[..., 2]], axis=-1)
        along = np.stack([pulls[:, self.leg_unknown], pulls[:, drones // 2]], axis=-1)
        return tension_at(along, self.half, sizes**2 - rise**2, rise)

    def leg_pulls(self) -> csr_array:
        """Return sparse (windows · 2n · 3, unknowns): forces of unit pulls on the drones."""
        count, drones, _ = self.outward.shape
        w, d, axis = np.indices(self.outward.shape)
        rows = (w * drones + d) * 3 + axis
        columns = w * self.per_window + self.leg_unknown[None, :, None]
        columns = np.broadcast_to(columns, rows.shape)
        shape = (count * drones * 3, count * self.per_window)
        entries = (-self.outward.ravel(), (rows.ravel(), columns.ravel()))
        return coo_array(entries, shape=shape).tocsr()

    def surplus(self, feed_forward: NDArray[np.bool_]) -> Array:
        """Return (windows, 2n, 3) [N]: weight on the drones less what controllers know of cables.

        The forces of the legs come on top of it.
        """
        known = np.where(feed_forward[:, None], self.windows.cable_forces, 0.0)
        surplus: Array = -self.hanging - known
        return surplus


TURNS = np.radians([0.0, 30.1, 44.9, 60.0, 74.5, 89.5, 119.2])
"""Angles by which cables turn in the plane [rad], for what follows."""

IN_SPACE = np.array([1.52, 1.518, 1.504, 1.483, 1.438, 1.378, 1.266])
"""Angle in space over that in the plane, of simulated hitches at rest (10 g/m at 0.5 N) without
friction. The first value continues the next ones."""

COSINES = np.array([1.0, 0.877, 0.737, 0.559, 0.393, 0.245, -0.046])
"""Cosine between the cables where they touch, mean over the contact, measured likewise."""

GEOMETRY_ERROR = 0.15
"""Relative standard error of a friction coefficient by the two above: estimates from simulated
flights deviate by -13 to +20 %. Segments of 4 mm in place of 10 change ratios by 2 % at 60° where
one cable slides, by 10 % where both slide alike."""

RATE_SPAN = 0.2
"""Time over which a rate of sliding is measured [s]: a drone's noise reverses it after longer."""

BLURRED = 1e-2
"""Rate of sliding below which its direction is blurred [m/s]: by noise of the recorded positions,
by what a span does not resolve, and by cables that stick. In simulations contacts creep where
friction is less than it may be: at 2 mm/s it has a third of its size, at 6 mm/s three quarters."""

SLIDING = 1e-2
"""Least rate at which cables slide over each other in a window that counts as sliding [m/s]."""

PLANNED = 5e-3
"""Least rate at which the plan has to slide them, the same way [m/s]: sliding that is due to noise
goes with errors of the tensions."""

DIRECTION_ERROR = 0.2
"""Standard error of the angle between friction and a cable [rad]: where both cables slide alike
simulated clasps by themselves have 0.94 to 1.03 of the law's ratios, but 0.6 in one calm flight,
whose contacts vibrated."""

LEAST_RATIO = 0.05
"""Least tension over the planned one at which a ratio is formed."""


@dataclass(frozen=True, eq=False)
class SlidingClasps:
    """Clasps whose cables slide over each other in a window, one entry each.

    The two columns are the clasp's cables: the one that is ahead, whose leg leads to its q, and the
    one behind, whose leg leads to its r.

    Attributes
    ----------
    windows, clasps: (entries,), which ones.
    ratios: (entries, 2), logarithms of the leg's tension over the edge's.
    pulls: (entries, 2), what friction makes of them at a coefficient of 1.
    unsure: (entries, 2), standard errors of the pulls by the direction of sliding.
    slid: (entries,) [m], distance by which the cables slide over each other meanwhile.
    """

    windows: NDArray[np.intp]
    clasps: NDArray[np.intp]
    ratios: Array
    pulls: Array
    unsure: Array
    slid: Array


def friction_pulls(turns: Array, rates: Array, blurred: float = 0.0) -> Array:
    """Return logarithms of leg over edge tensions (…, 2) that a friction coefficient of 1 causes.

    Parameters
    ----------
    turns: (…, 2) [rad], angles in the plane by which a clasp's cables turn.
    rates: (…, 2) [m/s], at which they slide toward their legs.
    blurred: rate below which the direction of sliding counts little [m/s].
    """
    turn = np.mean(turns, axis=-1, keepdims=True)
    cosine = np.interp(turn, TURNS, COSINES)
    along = rates - cosine * rates[..., ::-1]
    speed = np.sqrt(_squared_speed(rates, cosine) + blurred**2)
    pulls: Array = turns * np.interp(turn, TURNS, IN_SPACE) * along / np.maximum(speed, 1e-12)
    return pulls


def sliding_clasps(
    team: Team, recording: Recording, balance: ForceBalance, pulled: Array
) -> SlidingClasps:
    """Return the clasps whose cables the plan slides over each other, window by window.

    Noise of the drones slides cables back and forth; therefore directions are those of short spans.

    Parameters
    ----------
    team: cables and drones.
    recording: measured positions.
    balance: at its windows.
    pulled: (windows, unknowns) [N], along the chords of legs and edges.
    """
    windows, parts, layout = balance.windows, balance.parts, team.layout
    pair = np.stack([2 * layout.ahead, 2 * layout.behind + 1], axis=-1)  # (clasps, 2) drones
    outward = parts.outward[:, pair]
    inward = parts.along[:, pair // 2] * np.array([1.0, -1.0])[:, None]  # along the edges
    cosines = -np.sum(outward * inward, axis=-1)
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    cosine = np.interp(np.mean(turns, axis=-1, keepdims=True), TURNS, COSINES)
    window, rates = _rates(recording, team, pair, windows.t)
    count = np.bincount(window, minlength=len(windows.t))[:, None, None]

    def mean(values: Array) -> Array:
        sums = np.zeros_like(turns)
        np.add.at(sums, window, values)
        return np.asarray(sums / np.maximum(count, 1))

    pulls = mean(friction_pulls(turns[window], rates, BLURRED))
    rate = mean(rates)
    planned = CableParts.of(team, windows.commanded, windows.planned).legs[:, pair]
    asked = np.zeros_like(rate)
    if len(windows.t) > 1:
        asked = np.gradient(planned, windows.t, axis=0)
    speed = np.sqrt(_squared_speed(rate, cosine))[..., 0]
    usable = (count[..., 0] > 1) & (speed > SLIDING) & (np.sum(rate * asked, axis=-1) > 0.0)
    usable &= np.sqrt(_squared_speed(asked, cosine))[..., 0] > PLANNED
    leg, edge = np.moveaxis(balance.tensions(pulled)[:, pair], -1, 0)
    least = LEAST_RATIO * windows.tensions[:, pair // 2]
    usable &= np.all((leg > least) & (edge > least), axis=-1)
    w, c = np.nonzero(usable)
    ratios = np.log(leg[w, c] / edge[w, c])
    largest = turns * np.interp(np.mean(turns, axis=-1, keepdims=True), TURNS, IN_SPACE)
    unsure = DIRECTION_ERROR * np.sqrt(np.maximum(largest**2 - pulls**2, 0.0))
    return SlidingClasps(w, c, ratios, pulls[w, c], unsure[w, c], speed[w, c] * WINDOW)


def _squared_speed(rates: Array, cosine: Array) -> Array:
    """Return the square (…, 1) [m²/s²] of the speed of one cable's surface over the other's."""
    a, b = rates[..., :1], rates[..., 1:]
    squared: Array = np.maximum(a**2 + b**2 - 2.0 * cosine * a * b, 0.0)
    return squared


def _rates(
    recording: Recording, team: Team, pair: NDArray[np.intp], middles: Array
) -> tuple[NDArray[np.intp], Array]:
    """Return windows (rates,) and rates (rates, clasps, 2) [m/s] at which legs grow, span by span.

    Parameters
    ----------
    recording, team, pair: see ``sliding_clasps``.
    middles: of the windows [s].
    """
    seen = np.all(np.isfinite(recording.drones), axis=(1, 2))
    seen &= np.all(np.isfinite(recording.vertices), axis=(1, 2)) & (recording.t >= 0.0)
    t = recording.t[seen]
    legs = CableParts.of(team, recording.drones[seen], recording.vertices[seen]).legs[:, pair]
    _, first, count = np.unique(np.floor(t / RATE_SPAN), return_index=True, return_counts=True)
    place = np.add.reduceat(legs, first, axis=0) / count[:, None, None]
    time = np.add.reduceat(t, first) / count
    steps = np.diff(time)
    rates = np.diff(place, axis=0) / steps[:, None, None]
    middle = 0.5 * (time[1:] + time[:-1])
    nearest = np.searchsorted(0.5 * (middles[1:] + middles[:-1]), middle)
    of_window = np.abs(middle - middles[nearest]) <= 0.5 * WINDOW + 1e-9
    of_window &= steps < WINDOW
    return nearest[of_window], rates[of_window]


SLID = 0.02
"""Least distance that cables must slide, all clasps taken together, to determine friction [m]."""

OFFSET_SCALE, FORCE_SHARE = 1e-2, 0.02
"""Assumed scatter of drones' displacements [m], which is that of the positions that they measure,
and of forces on clasps over the tension."""

LEAST_SCATTER = 0.01
"""Least scatter that is assumed of the logarithm of a ratio."""

OFFSET_SCATTER = 0.03
"""Standard deviation, known beforehand, of an offset that is common to the sums of clasps' ratios:
thick cables pass the measured vertex at one side, which turns legs by 0.02 rad."""

FRICTION_ROUNDS = 3
"""Rounds in which scatter and friction are estimated by turns."""

LARGEST_ERROR = 0.1
"""Largest standard error of a friction coefficient that counts as determined."""


def part_pulls(
    balance: ForceBalance, compliance: Array, wind: Array, feed_forward: NDArray[np.bool_]
) -> Array:
    """Return the pulls along chords (windows, unknowns) [N] that fit drones and clasps best.

    Parameters
    ----------
    balance: at the windows; drones that move steadily count as if they were at rest.
    compliance: of each drone (2n,) [m/N].
    wind: (2,) [N], steady level force on every drone.
    feed_forward: (2n,), whether controllers add the cable forces of the set points.
    """
    windows = balance.windows
    tension = float(np.median(windows.tensions))
    wanted = (windows.drones - windows.commanded) / compliance[:, None]
    wanted -= balance.surplus(feed_forward)
    wanted[..., :2] -= wind
    weight = np.broadcast_to(compliance[:, None] / OFFSET_SCALE, wanted.shape).ravel()
    force = 1.0 / (FORCE_SHARE * tension)
    matrix = csr_array(
        vstack([diags_array(weight) @ balance.leg_pulls(), force * balance.clasps], format="csr")
    )
    target = np.concatenate([weight * wanted.ravel(), force * balance.weights])
    normal = (matrix.T @ matrix).tocsc()
    solved: Array = splu(normal).solve(matrix.T @ target)
    return solved.reshape(len(windows.t), balance.per_window)


def fit_friction(found: SlidingClasps) -> Estimate:
    """Return the coefficient that explains the ratios, by robust regression.

    The standard error is the larger of two: with errors that are common to a window, since all of
    its ratios follow from the same positions, and with errors that are common to a clasp, since
    cables differ. The geometry's error is added.
    """
    slid = float(np.sum(found.slid))
    if slid < SLID:
        return Estimate.unknown(
            f"cables slide through clasps by {100 * slid:.1f} cm in all, less than {100 * SLID:g} "
            "cm: friction is not seen; move a vertex by some decimetres"
        )
    modes = np.array([[1.0, 1.0], [1.0, -1.0]])  # sum and difference
    ratios, pulls = found.ratios @ modes, found.pulls @ modes
    unsure = np.linalg.norm(found.unsure, axis=-1, keepdims=True)  # of both modes alike
    x = np.array([np.sum(pulls * ratios) / np.sum(pulls**2), 0.0])  # friction and offset
    columns = np.stack([pulls, np.broadcast_to([1.0, 0.0], pulls.shape)], axis=-1)
    for _ in range(FRICTION_ROUNDS):
        scale = np.maximum(scale_of(ratios - columns @ x, axis=0), LEAST_SCATTER)
        scale = np.hypot(scale, x[0] * unsure)
        wanted, by = ratios / scale, columns / scale[..., None]
        rows, right = by.reshape(-1, 2), wanted.ravel()
        rows = np.vstack([rows, [0.0, 1.0 / OFFSET_SCATTER]])
        right = np.append(right, 0.0)
        x = least_squares(_misfit, x, loss="soft_l1", args=(rows, right)).x
    residuals = wanted - by @ x
    weights = 1.0 / np.sqrt(1.0 + residuals**2)
    scores = np.sum((weights * residuals)[..., None] * by, axis=1)
    prior = np.diag([0.0, 1.0 / OFFSET_SCATTER**2])
    inverse = np.linalg.inv(np.einsum("ij,ijk,ijl->kl", weights**3, by, by) + prior)
    errors = []
    for group in (found.windows, found.clasps):
        sums = np.stack([np.bincount(group, column) for column in scores.T])
        errors.append(float((inverse @ (sums @ sums.T + prior) @ inverse)[0, 0]))
    mu, scatter = float(x[0]), float(np.sqrt(max(errors)))
    if scatter > LARGEST_ERROR or len(np.unique(found.windows)) < 3:
        return Estimate.unknown(
            f"its standard error would be {scatter:.2g}: tensions scatter by more than friction "
            "changes them; move vertices farther, or record more precisely"
        )
    return Estimate(max(mu, 0.0), float(np.hypot(scatter, GEOMETRY_ERROR * mu)))


def _misfit(x: Array, rows: Array, right: Array) -> Array:
    """Return the residuals of linear equations."""
    return rows @ x - right
