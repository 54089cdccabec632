"""What became of a flight: does it hold, and if not, what failed, where and when."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.validity import InvalidRunError

Array = NDArray[np.float64]

HELD = 0.10
"""[m] A vertex that moves no farther under half as much tension again is held."""

JUDGED = 0.5
"""[s] Over which a vertex's place is averaged before the pull test, and at its end."""


SUCCEEDED, FAILED, NOT_SIMULATED = "succeeded", "failed", "not simulated"

START, INVALID = "start", "invalid"
UNSIMULATED = (START, INVALID)
"""The kinds of failure that are the simulation's own: it could not begin, or left its range."""


@dataclass(frozen=True)
class Failure:
    """One thing that went wrong.

    Attributes
    ----------
    kind: one of UNSIMULATED, which say nothing of the plan, or ``touch``, ``unlinked``,
        ``tangled``, ``lost`` (cables that do not bear on each other), ``slipped`` (moved under the
        pull test).
    where: names of drones, cables or vertices.
    time: [s], from the flight's start.
    words: what happened.
    """

    kind: str
    where: tuple[str, ...]
    time: float
    words: str


@dataclass(frozen=True)
class Clasp:
    """Whether one vertex is hitched.

    Attributes
    ----------
    name: p0, p1, ….
    linking: Gauss's linking number of its two cables, ±1 for a clasp. Cables that merely cross may
        have any of 0 and ±1: a clasp bears as well.
    bearing: how hard they press on each other after the rest [N].
    least_bearing: from where on they bear [N].
    moved: how far the vertex moved under the pull test [m]; nan without one.
    holds: linked once, bearing, and held.
    """

    name: str
    linking: int
    bearing: float
    least_bearing: float
    moved: float
    holds: bool

    @property
    def bears(self) -> bool:
        """Whether its cables press on each other as those of a clasp do."""
        return self.bearing >= self.least_bearing > 0.0


@dataclass(frozen=True)
class Outcome:
    """What became of a flight.

    Attributes
    ----------
    clasps: of a plan that ends with a hitch, once it has rested; else none.
    failures: all that went wrong, by time; none is a success.
    """

    clasps: tuple[Clasp, ...]
    failures: tuple[Failure, ...]

    @property
    def verdict(self) -> str:
        """Return SUCCEEDED, FAILED, or NOT_SIMULATED where nothing but the simulation failed."""
        if self.succeeded:
            return SUCCEEDED
        simulated = any(failure.kind not in UNSIMULATED for failure in self.failures)
        return FAILED if simulated else NOT_SIMULATED

    @property
    def succeeded(self) -> bool:
        """Whether nothing went wrong."""
        return not self.failures

    @property
    def hitched(self) -> bool:
        """Whether every vertex holds, and there are any."""
        return bool(self.clasps) and all(clasp.holds for clasp in self.clasps)


def judge(flight: Flight, team: Team, *, formed: bool) -> Outcome:
    """Return what became of a flight.

    Parameters
    ----------
    flight: simulated.
    team: who flew.
    formed: whether the plan ends with a hitch; else its cables are to be free of each other.
    """
    failures = [
        Failure("touch", (e.first, e.second), e.time, f"{e.first} touches {e.second}")
        for e in flight.events
    ]
    if flight.error is not None:
        time = flight.error.time if isinstance(flight.error, InvalidRunError) else np.nan
        where = (flight.error.where,) if isinstance(flight.error, InvalidRunError) else ()
        failures.append(Failure(INVALID, where, float(time), str(flight.error)))
    clasps: tuple[Clasp, ...] = ()
    if flight.linking is not None:
        clasps = _clasps(flight, flight.linking, team) if formed else ()
        failures += _wrong_links(flight, flight.linking, team, formed=formed)
        failures += [failure for clasp in clasps for failure in _weak(flight, clasp)]
    failures.sort(key=lambda failure: failure.time)
    return Outcome(clasps, tuple(failures))


def _clasps(flight: Flight, links: NDArray[np.int64], team: Team) -> tuple[Clasp, ...]:
    layout, record = team.layout, flight.record
    before, bearing = _mean_place(flight, flight.rested)
    after, _ = _mean_place(flight, flight.pulled)
    moved = np.linalg.norm(after - before, axis=-1)
    tested = record.t[-1] >= flight.pulled  # false where there is none: nan
    found = []
    for c, point in enumerate(layout.clasps):
        linking = int(links[layout.behind[c], layout.ahead[c]])
        held = bool(moved[c] <= HELD) if tested else np.isnan(flight.pulled)
        clasp = Clasp(
            team.point_names[point],
            linking,
            float(bearing[c]),
            float(flight.least_bearing[c]),
            float(moved[c]) if tested else float("nan"),
            holds=False,
        )
        holds = abs(linking) == 1 and clasp.bears and bool(held) and flight.error is None
        found.append(replace(clasp, holds=holds))
    return tuple(found)


def _mean_place(flight: Flight, end: float) -> tuple[Array, Array]:
    """Return the vertices' places and forces over the last JUDGED seconds until ``end`` [s]."""
    record = flight.record
    chosen = (record.t > end - JUDGED) & (record.t <= end + 1e-9)
    vertices, bearing = record.vertices[chosen], record.bearing[chosen]
    there = np.isfinite(vertices[..., :1])
    count = np.sum(there, axis=0)
    sums = np.sum(np.where(there, vertices, 0.0), axis=0)
    places: Array = np.divide(sums, count, out=np.full_like(sums, np.nan), where=count > 0)
    forces: Array = np.sum(bearing, axis=0) / max(len(bearing), 1)
    return places, forces


def _wrong_links(
    flight: Flight, linking: NDArray[np.int64], team: Team, *, formed: bool
) -> list[Failure]:
    layout = team.layout
    wanted = np.zeros_like(linking)
    if formed:
        wanted[layout.behind, layout.ahead] = wanted[layout.ahead, layout.behind] = 1
    point = {
        tuple(sorted((int(j), int(k)))): team.point_names[p]
        for j, k, p in zip(layout.behind, layout.ahead, layout.clasps, strict=True)
    }
    failures = []
    for i, j in np.argwhere(np.triu(np.abs(linking) != wanted, 1)):
        number = int(linking[i, j])
        if wanted[i, j]:
            name = point[int(i), int(j)]
            words = f"{name}: cables {i} and {j} are linked {number} times, not once"
            failures.append(Failure("unlinked", (name,), flight.rested, words))
        else:
            names = (f"cable {i}", f"cable {j}")
            words = f"cables {i} and {j} are linked {number} times, and should not be"
            failures.append(Failure("tangled", names, flight.rested, words))
    return failures


def _weak(flight: Flight, clasp: Clasp) -> list[Failure]:
    """Return what is wrong with a clasp that is linked."""
    if abs(clasp.linking) != 1:
        return []
    if not clasp.bears:
        words = (
            f"{clasp.name}: its cables press with {clasp.bearing:.3f} N, less than the "
            f"{clasp.least_bearing:.3f} N from which on a clasp bears: they merely cross"
        )
        return [Failure("lost", (clasp.name,), flight.rested, words)]
    if clasp.moved > HELD:
        words = f"{clasp.name}: moves {clasp.moved:.3f} m under the pull test, more than {HELD} m"
        return [Failure("slipped", (clasp.name,), flight.pulled, words)]
    return []
