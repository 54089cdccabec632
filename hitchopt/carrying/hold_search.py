"""The search of a hold below a rim, over all clasps, slack splits and rolls.

Every clasp, every cable's split and every clasp's roll is free. Sequential linear programming
maximises the smallest margin of all limits at rest, without and with the whole weight: margins are
linearized by forward differences, and steps are limited by a trust region (Conn, Gould and Toint
2000, chapter 6, for the largest of several functions). The search is local.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hitchopt.carrying.holds import RestHold
from hitchopt.carrying.polygons import MIN_INSET, sides_of
from hitchopt.errors import check_time
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length, turn
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import cable_forces, if_balanced
from hitchopt.hitch.pairs import TautBodies, limits_of, scales_of
from hitchopt.hitch.requirements import STANDING, Requirements
from hitchopt.motion.loads import RIM_CUT
from hitchopt.objects.placing import in_frame, in_world
from hitchopt.values import Array, known

STEPS = np.array([0.03, 0.03, 0.08, 0.15])
"""Largest first steps of a clasp's x and y [m], of a split, and of a roll [rad]."""

DIFFERENCE = 1e-5  # Step of forward differences, over STEPS
MARGIN = 0.06  # Margin at which a search ends, which a carry reduces by leaning legs
MAX_PROGRAMS = 60  # Maximum number of linear programs of a search
GROWTH = 1.7  # Factor of the trust region after a better step
SHRINKAGE = 0.4  # Factor of the trust region after a worse step
MAX_REGION = 3.0  # Largest size of the trust region, over STEPS
MIN_REGION = 2e-3  # Size of the trust region below which a search ends, over STEPS
GAIN_SHARE = 0.1  # Smallest gain of a step over the predicted one
MIN_GAIN = 1e-6  # Smallest gain of a step

MIN_PREDICTED_GAIN = 1e-3
"""Smallest predicted gain of a step; a search ends where programs predict less."""

PATIENCE = 4
"""Number of programs in turn after which a search ends if they predict negative margins."""

HOPE = 3e-3  # Rise of these predictions with which the search goes on
ROW_RANGE = 3.0  # Margins above the smallest one by more than this do not enter programs
MIN_LIGHTEST = 0.4  # Smallest share of the weight on a clasp, over the mean share
MIN_TURN = math.radians(12.0)  # [rad] Smallest turn of the polygon at a clasp
MIN_EDGE = 0.05  # [m] Shortest edge
MAX_ROLL = math.radians(60.0)  # [rad] Largest roll

LEGS_CHANGED = (0.0, 0.6)
"""Places on the way from around the object, 0, to the hold, 1, at which legs have its splits and
rolls. Around it, where edges are long, short cables have legs that are too short for most."""

CLOSURES = np.array([0.0, 0.3, 0.6, 0.8])  # Places on that way at which distances are compared

LEG_SAMPLES = np.linspace(0.25, 1.0, 4)[:, None, None]
"""Places on a leg, as shares of its length, whose distances to other objects are compared."""

START_SPLITS = (0.2, 0.35, 0.8, 0.65)
"""Slack splits of all cables from which searches start. With equal ones legs of regular polygons
cross symmetrically, and no small change separates them."""

SPLIT_RANGE = (0.05, 0.95)  # Smallest and largest slack split


@dataclass(frozen=True, eq=False)
class HoldSearch:
    """The search of a hold below a rim.

    Variables (…, n, 4) are each clasp's x and y in the object's frame [m], its cable's slack split,
    and its roll [rad].
    """

    start: RestHold  # A hold of the team, from whose clasps searches start
    # The hitch around the object, from which clasps and then legs close evenly to a hold
    around: RestHold
    tension: Array  # (n,) [N], of cables while they hold the object
    # Limits and distances, and all other objects at their current positions
    requirements: Requirements
    gap: float  # Depth below the rim at which legs close [m]
    # Place of LEGS_CHANGED at which legs have changed to the hold's
    legs_changed: float = LEGS_CHANGED[0]

    def holds(self) -> Iterator[RestHold]:
        """Yield holds that keep all margins at rest, from several slack splits."""
        clasps = self.start.polygon
        level = np.zeros(len(clasps))
        for split in START_SPLITS:
            hold = self.found(np.column_stack([clasps, np.full(len(clasps), split), level]))
            if hold is not None:
                yield hold

    def at_rest(self, hold: RestHold) -> float:
        """Return the smallest margin of a hold's distances and forces with the whole weight."""
        curves = _at_rest(hold, self.tension, 1.0)
        if curves is None:
            return -math.inf
        margins = [*self._distances(curves), *self._of_legs(hold, curves, 1.0)]
        return min(float(np.min(each)) for each in margins)

    def improved(self, hold: RestHold) -> RestHold | None:
        """Return the hold that a search reaches from another; None if it breaks a limit."""
        return self.found(np.column_stack([hold.polygon, hold.fractions, hold.roll]))

    def changing_legs(self, hold: RestHold) -> HoldSearch:
        """Return the search whose legs change where a hold's have the largest margin."""
        return self._by_margin(hold)[0]

    def _by_margin(self, hold: RestHold) -> list[HoldSearch]:
        """Return the searches for LEGS_CHANGED, first that with a hold's largest margin."""
        searches = [replace(self, legs_changed=place) for place in LEGS_CHANGED]
        return sorted(searches, key=lambda search: -search.closing_margin(hold))

    def closing_margin(self, hold: RestHold) -> float:
        """Return the smallest margin on the way from around the object to a hold."""
        curves = _at_rest(self.closing(hold, CLOSURES), hold.team.tension, 0.0)
        if curves is None:
            return -math.inf
        return min(float(np.min(each)) for each in self._distances(curves))

    def changed_legs(self, hold: RestHold) -> RestHold:
        """Return the first hitch on the way from around the object that has a hold's legs."""
        search = self.changing_legs(hold)
        return search.closing(hold, search.legs_changed)

    def found(self, guess: Array) -> RestHold | None:
        """Return the hold that a search reaches from a guess (n, 4); None if it breaks a limit."""
        reached = (search.reached(guess) for search in self._by_margin(self._hold(guess)))
        return next((hold for hold in reached if hold is not None), None)

    def reached(self, guess: Array) -> RestHold | None:
        """Return ``found``, with legs that change at this search's place."""
        margins, gradients, region = self.margins(guess), None, 1.0
        predictions = list[float]()
        for _ in range(MAX_PROGRAMS):
            smallest = float(np.min(margins))
            if smallest >= MARGIN or region < MIN_REGION or not math.isfinite(smallest):
                break
            check_time()
            if gradients is None:
                gradients = self._gradients(guess, margins)
            step, predicted = _best_step(guess, margins, gradients, region)
            predictions.append(predicted)
            if predicted - smallest < MIN_PREDICTED_GAIN or _is_hopeless(predictions):
                break
            trial = guess + STEPS * step
            trial_margins = self.margins(trial)
            gain = float(np.min(trial_margins)) - smallest
            if gain > max(GAIN_SHARE * (predicted - smallest), MIN_GAIN):
                guess, margins, gradients = trial, trial_margins, None
                region = min(GROWTH * region, MAX_REGION)
            else:
                region *= SHRINKAGE
        return self._hold(guess) if np.min(margins) > 0.0 else None

    def _gradients(self, guess: Array, margins: Array) -> Array:
        """Return the derivatives (4 n, rows) of margins (rows,) at a guess, per step of STEPS."""
        size = guess.size
        moves = DIFFERENCE * np.eye(size).reshape(size, *guess.shape) * STEPS
        return np.asarray((self.margins(guess + moves) - margins) / DIFFERENCE)

    def _hold(self, variables: Array) -> RestHold:
        """Return the hold of variables (…, n, 4)."""
        return replace(
            self.start,
            polygon=variables[..., :2],
            fractions=variables[..., 2],
            roll=variables[..., 3],
        )

    def margins(self, variables: Array) -> Array:
        """Return the margins (…, rows) of variables (…, n, 4): distances over limits, minus 1.

        They are minus infinity if tensions bear no weight.
        """
        unbalanced = np.full((*variables.shape[:-2], 1), -np.inf)
        hold = self._hold(variables)
        margins = self._of_clasps(hold)
        closing = _at_rest(self.closing(hold, CLOSURES), hold.team.tension, 0.0)
        if closing is None:
            return unbalanced
        margins += [np.moveaxis(each, 0, -1) for each in self._distances(closing)]
        for load_share in (0.0, 1.0):
            curves = _at_rest(hold, self.tension, load_share)
            if curves is None:
                return unbalanced
            margins += self._distances(curves)
            margins += self._of_legs(hold, curves, load_share)
        lead = variables.shape[:-2]
        return np.concatenate([np.reshape(each, (*lead, -1)) for each in margins], axis=-1)

    def closing(self, hold: RestHold, closures: Array | float) -> RestHold:
        """Return the hitches at places between that around the object, 0, and a hold, 1.

        Places (k,) are a leading axis of polygon, splits and rolls.
        """
        around, change_at = self.around, self.legs_changed
        changed = np.where(closures < change_at, closures / max(change_at, MIN_GAIN), 1.0)

        def between(before: Array, after: Array, shares: Array | float) -> Array:
            """Return values between those around the object and those of the hold."""
            places = np.reshape(shares, (*np.shape(shares), *np.ones(after.ndim, dtype=np.intp)))
            return np.asarray(before + places * (after - before))

        return replace(
            hold,
            polygon=between(around.polygon, hold.polygon, closures),
            fractions=between(around.fractions, hold.fractions, changed),
            roll=between(around.roll, hold.roll, changed),
        )

    def _of_clasps(self, hold: RestHold) -> list[Array]:
        """Return the margins (…, n) of clasps and edges below the rim."""
        polygon, body = hold.polygon, hold.body
        outward, offsets = sides_of(polygon)
        edges = np.roll(polygon, -1, axis=-2) - polygon
        turns = -turn(edges, np.roll(edges, -1, axis=-2))
        insets = [-known(body.rim).section.clearance(polygon)[0]]
        if body.stem is not None:
            insets.append(offsets - body.stem.support(outward))
        return [
            *(inset / MIN_INSET - 1.0 for inset in insets),
            hold.team.robots * hold.supports.shares / MIN_LIGHTEST - 1.0,
            turns / MIN_TURN - 1.0,
            length(edges) / MIN_EDGE - 1.0,
        ]

    def _distances(self, curves: dict[str, Array]) -> list[Array]:
        """Return the margins of distances of drones and cables, and of lengths of legs, at rest."""
        requirements = self.requirements
        bodies = TautBodies.of(self.start.team.layout)
        first, second, kind = bodies.all_pairs
        points = np.concatenate([curves["vertices"], curves["drones"]], axis=-2)
        nodes = points[..., bodies.nodes, :]
        between = differences(nodes[..., first, :, :], nodes[..., second, :, :])
        distances = length(shortest_offset(between * scales_of(requirements)[kind][:, None]))
        return [
            distances / limits_of(requirements.separation)[kind] - 1.0,
            curves["legs"] / requirements.limits.leg - 1.0,
        ]

    def _of_legs(self, hold: RestHold, curves: dict[str, Array], load_share: float) -> list[Array]:
        """Return the margins of forces, rim, ground and objects, with a share of the weight."""
        team, requirements = hold.team, self.requirements
        separation = requirements.separation
        drones = curves["drones"]
        anchors = curves["vertices"][..., team.layout.anchors, :]

        pulls = np.repeat(self.tension, 2)
        taut = np.ones(team.robots)
        thrusts = -cable_forces(team, drones, anchors, pulls, taut)
        thrusts[..., 2] += GRAVITY * team.mass
        tilts = np.arctan2(length(thrusts[..., :2]), thrusts[..., 2])

        over_ground = float(hold.body.at[2]) - requirements.ground_for(STANDING)
        height = over_ground - (1.0 - load_share) * self.gap
        margins = [
            (RIM_CUT - hold.rim_heights(curves)) / separation.object,
            1.0 - length(thrusts) / team.max_thrust,
            1.0 - tilts / np.minimum(requirements.limits.tilt, team.max_tilt),
            (drones[..., 2] + height) / separation.object - 1.0,
        ]
        if load_share == 1.0:
            margins.append(self._bearing(hold))
        margins += [
            slab.clearance(drones).distance / separation.radius - 1.0 for slab in hold.body.slabs
        ]
        legs = anchors[..., None, :, :] + LEG_SAMPLES * (drones - anchors)[..., None, :, :]
        for body in requirements.objects.values():
            local = in_frame(body.pose, in_world(hold.body.pose, legs))
            for slab in body.slabs:
                distance = slab.clearance(local).distance
                margins.append(distance[..., -1, :] / separation.radius - 1.0)
                margins.append(distance / separation.object - 1.0)
        return margins

    def _bearing(self, hold: RestHold) -> Array:
        """Return the margins (…, n) of straight legs whose pulls bear the load at a clasp.

        Both pulls close a triangle with that of the edges and the weight.
        """
        team, behind = hold.team, partial(np.roll, shift=1, axis=-1)
        edges = np.roll(hold.polygon, -1, axis=-2) - hold.polygon
        lengths = length(edges)
        half_weights = 0.5 * GRAVITY * team.cable_density * lengths
        weights = GRAVITY * hold.body.mass * hold.supports.shares
        weights = weights + half_weights + behind(half_weights)
        pulls = self.tension[:, None] * edges / lengths[..., None]
        level = length(np.roll(pulls, 1, axis=-2) - pulls)
        return np.asarray((self.tension + behind(self.tension)) / np.hypot(level, weights) - 1.0)


def _is_hopeless(predictions: list[float]) -> bool:
    """Return whether the last predicted margins are negative and do not rise."""
    last = predictions[-PATIENCE:]
    return len(last) == PATIENCE and max(last) < 0.0 and max(last) - last[0] < HOPE


def _best_step(
    guess: Array, margins: Array, gradients: Array, region: float
) -> tuple[Array, float]:
    """Return the step (n, 4), over STEPS, with the largest predicted smallest margin, and that.

    Parameters
    ----------
    guess: (n, 4), variables.
    margins: (rows,), at the guess.
    gradients: (4 n, rows), of margins per step of STEPS.
    region: largest size of the step.
    """
    from scipy.optimize import linprog

    if not np.all(np.isfinite(gradients)):  # clasps are about to lose their balance
        return np.zeros_like(guess), -math.inf
    splits, rolls = np.array(SPLIT_RANGE), np.array([-MAX_ROLL, MAX_ROLL])
    ends = np.stack([np.full(2, -np.inf), np.full(2, np.inf)])
    ranges = np.column_stack([ends, splits, rolls])[:, None]  # (2, 1, 4)
    bounds = np.clip((ranges - guess) / STEPS, -region, region)
    near = margins < np.min(margins) + ROW_RANGE
    # Maximise t subject to margins + step · gradients >= t
    program = linprog(
        np.append(np.zeros(guess.size), -1.0),
        A_ub=np.column_stack([-gradients[:, near].T, np.ones(np.count_nonzero(near))]),
        b_ub=margins[near],
        bounds=[*bounds.reshape(2, -1).T, (None, None)],
    )
    *step, smallest = np.asarray(program.x).tolist()
    return np.reshape(step, guess.shape), smallest


def _at_rest(hold: RestHold, tension: Array, load_share: float) -> dict[str, Array] | None:
    """Return the curves of a hold at rest with tensions (n,) [N]; None if they bear no weight."""
    return if_balanced(partial(hold.at_rest, tension, load_share), None)
