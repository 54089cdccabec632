"""Cables that slide through their clasps, and what friction does to their tensions.

Friction acts against the velocity with which one cable's surface moves over the other's. With
rates v_a and v_b at which the cables a and b of a clasp slide toward their legs, and c the cosine
between these directions where they touch, the leg of a is pulled harder than its edge by

    log(T_leg / T_edge) = μ Θ_a (v_a - c v_b)/w,    w² = v_a² + v_b² - 2 c v_a v_b,

Θ_a being the angle by which it turns in space; b likewise. It is Coulomb's law: friction on a is
``-μ N (v_a t_a - v_b t_b)/w`` with the normal force ``N = T Θ`` and directions t toward the legs,
and only its part along t_a changes the tension of a. A cable that slides alone has the ratio of a
capstan and drags the other along; where both slide alike, friction acts across them for the most
part, and ratios are less. Θ and c are geometry: cables whose ends lie in one plane pass over and
under each other, turn farther than in the plane, and touch where they cross.

The angle ψ between friction and a cable is known less well than the sizes of forces. Its error
changes ``cos ψ`` by ``sin ψ``, not at all where a cable slides alone; this weighs the estimates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.calibration.flight_windows import WINDOW
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.calibration.recordings import Recording
from hitchopt.hitch import Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.values import Array

TURNS = np.radians([0.0, 30.1, 44.9, 60.0, 74.5, 89.5, 119.2])
"""Angles by which cables turn in the plane [rad], for what follows."""

IN_SPACE = np.array([1.52, 1.518, 1.504, 1.483, 1.438, 1.378, 1.266])
"""Angle in space over that in the plane, of simulated hitches at rest (10 g/m at 0.5 N) without
friction: ``benchmarks/clasp_contacts.py``. The first value continues the next ones."""

COSINES = np.array([1.0, 0.877, 0.737, 0.559, 0.393, 0.245, -0.046])
"""Cosine between the cables where they touch, mean over the contact, measured likewise."""

GEOMETRY_ERROR = 0.15
"""Relative standard error of a friction coefficient by the two above: estimates from simulated
flights deviate by -13 to +20 %. Segments of 4 mm in place of 10 change ratios by 2 % at 60° where
one cable slides, by 10 % where both slide alike."""

SPAN = 0.2
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
simulated clasps by themselves have 0.94 to 1.03 of the law's ratios
(``benchmarks/clasp_ratios.py``), but 0.6 in one calm flight, whose contacts vibrated
(``benchmarks/results/calibration.md``)."""

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
    team: Team, recording: Recording, balance: ForceBalance, tensions: Array
) -> SlidingClasps:
    """Return the clasps whose cables the plan slides over each other, window by window.

    Noise of the drones slides cables back and forth; therefore directions are those of short spans.

    Parameters
    ----------
    team: cables and drones.
    recording: measured positions.
    balance: at its windows.
    tensions: (windows, unknowns) [N], along the chords of legs and edges.
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
    leg, edge = tensions[:, balance.leg_unknown[pair]], tensions[:, pair // 2]
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
    _, first, count = np.unique(np.floor(t / SPAN), return_index=True, return_counts=True)
    place = np.add.reduceat(legs, first, axis=0) / count[:, None, None]
    time = np.add.reduceat(t, first) / count
    steps = np.diff(time)
    rates = np.diff(place, axis=0) / steps[:, None, None]
    middle = 0.5 * (time[1:] + time[:-1])
    nearest = np.searchsorted(0.5 * (middles[1:] + middles[:-1]), middle)
    of_window = np.abs(middle - middles[nearest]) <= 0.5 * WINDOW + 1e-9
    of_window &= steps < WINDOW
    return nearest[of_window], rates[of_window]
