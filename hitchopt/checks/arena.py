"""Check ``arena``: the drones stay within the walls."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rounding_margins import LAST_PLACE, ROUNDING, magnitude
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, smallest
from hitchopt.values import Array

EXPORTED = -1e-4
"""[m] How far exported curves may pass a wall, as those of a drone at rest on the floor do."""


def _find(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of any drone to a wall, negative outside."""
    arena = motion.requirements.arena
    if arena is None:
        return Finding(np.inf, 0.0)
    x = motion.drones.coefficients
    inside = np.concatenate([x - arena.lower[:, None], arena.upper[:, None] - x], axis=2)
    walls = float(max(np.max(np.abs(arena.lower)), np.max(np.abs(arena.upper))))
    size = magnitude(motion)  # walls that are farther off matter to nobody
    margin = ROUNDING * (size + walls)
    cells = Cells.over(motion.drones.breaks, [inside], margin)
    found = smallest(cells, _bound, within(limit, "min", size, 0.5))
    # Who rests on the floor, to the last place in which a plan is written, is not below it.
    worst = max(found.worst, 0.0) if np.min(inside) >= -LAST_PLACE * walls else found.worst
    return Finding(worst, found.time, (motion.team.drone_names[found.item],), size)


def _bound(blocks: tuple[Array, ...]) -> Estimate:
    (walls,) = blocks
    nearest = np.min(walls, axis=1)
    x = np.argmin(nearest, axis=-1) / max(1, bernstein.degree(walls))
    value = np.min(bernstein.evaluate(walls, x[:, None]), axis=-1)
    return Estimate(np.min(nearest, axis=-1), value, x)


RULE = CheckRule(
    "arena",
    "m",
    "min",
    lambda motion: None if motion.requirements.arena is None else 0.0,
    (Finder(_find, exported=True),),
    "enlarge the arena, or keep the hitch farther from its walls",
    exported_limit=EXPORTED,
)
