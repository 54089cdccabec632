"""Alignment of a recorded flight with its plan: clock, frame and names of the drones.

A search over clock offsets assigns bodies to drones by mean squared distances, in the plan's frame
or with y up. If drones are then far from their plan, frames that are turned about the vertical are
searched too. Robust least squares refine the clock of the best assignments, with a constant
displacement of each drone. A common lag of all drones is absorbed by the clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import linear_sum_assignment

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.lab.flights.recordings import RecordedFlight
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.storage.files import file_text, parsed_json
from hitchopt.values import Array

STEP = 0.05  # Step of compared times [s]
COARSE_STEPS = 5  # Number of these steps in one of the search
YAWS = 36  # Headings in the search for a frame
MAX_REFINED = 5  # Maximum number of assignments that are refined
ITERATIONS = 10  # Number of Gauss-Newton iterations of each
CLOCK_STEP = 0.01  # Finite-difference step of clock offsets [s]
MAX_CLOCK_STEP = 0.5  # Largest change of a clock offset by refinement [s]
MIN_DRIFT = 2e-3  # Smallest clock drift
MAX_DRIFT = 0.024  # Largest clock drift
GAIN = 0.8  # Largest ratio of costs at which a drift is accepted
ROBUST_SCALE = 0.02  # Scale of the robust loss [m]
BLOCK = 2.0  # Time after which displacements of drones are independent [s]
MAX_RMS = 0.15  # Largest root mean square distance of drones from their plan [m]
# Largest root mean square distance of drones from their plan in a fitted frame [m]
MAX_FITTED_RMS = 0.08
MAX_UNPLANNED = 0.5  # Largest root mean square ratio of unplanned to planned motion
UNRECORDED = 0.15  # Distance assumed while the plan is not recorded [m]
MIN_TIME = 2.0  # Smallest recorded time of the plan [s]; with a fitted frame also half of the plan
MIN_MOTION = 0.05  # Minimum distance between positions of a team that moves [m]
AMBIGUITY_RATIO = 1.25  # Largest ratio of distances of two ambiguous assignments
LIFT_RATIO = 3.0  # Smallest height difference that is fitted, over its standard error
EXCLUDED = 1e6  # Cost of a pair that is excluded [m²]

Frame = tuple[Array, Array]
"""Rotation (3, 3) and shift (3,) [m] from a recording's frame to the plan's."""

FRAMES: dict[str, Frame] = {
    "plan": (np.eye(3), np.zeros(3)),
    "y-up": (np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3)),
}
"""Frames by name that are not fitted."""


@dataclass(frozen=True, eq=False)
class Alignment(OneLine):
    """Clock, frame and names: plan times are ``rate t + offset``, positions ``rotation x + shift``.

    Attributes
    ----------
    offsets: clock offset of every drone q0, r0, … (2n,) [s]; equal for a common clock.
    rate: seconds of the plan per second of the recording.
    offset_error, rate_error: standard errors from a jackknife over drones and time; nan if not
        fitted.
    rotation, shift: from the recording's frame to the plan's (3, 3), (3,) [m].
    names: recorded names of the drones q0, r0, q1, …
    rms: root mean square distance of the drones from the plan [m].
    fitted: fitted parts, among ``clock``, ``rate``, ``frame`` and ``names``.
    frame: ``plan``, ``y-up``, ``fit``, or the path of a file with the frame.
    """

    offsets: Array
    rate: float
    offset_error: float
    rate_error: float
    rotation: Array
    shift: Array
    names: tuple[str, ...]
    rms: float
    fitted: tuple[str, ...]
    frame: str

    @property
    def offset(self) -> float:
        """Mean clock offset of the drones [s]."""
        return float(np.mean(self.offsets))

    @property
    def frame_error(self) -> float:
        """Standard error of positions due to a fitted frame [m]; zero if it is not fitted.

        A fitted frame absorbs the common displacement of the drones, whose variance is assumed to
        be half of that of their individual displacements.
        """
        return self.rms / np.sqrt(2.0) if "frame" in self.fitted else 0.0

    def placed(self, positions: Array) -> Array:
        """Return recorded positions (…, 3) [m] in the plan's frame."""
        return np.asarray(positions @ self.rotation.T + self.shift)


def align(
    flight: RecordedFlight,
    task: TeamTask,
    *,
    names: Mapping[str, str] | None = None,
    frame: str | None = None,
    start: float | None = None,
) -> Alignment:
    """Return clock, frame and names of a recorded flight of a plan; see ``evaluate``.

    Raises FileError for fewer bodies than drones, no motion, too short a recording, another plan,
    or an ambiguous assignment, and InputError for unknown names or an unknown frame.
    """
    for name, value in (("start", start), ("frame", frame if frame == "fit" else None)):
        if value is not None and not flight.one_clock:
            raise InputError(name, value, "omitted", "drones have separate clocks")
    trial = _Trial(flight, task, names or {}, start)
    if frame is not None and frame != "fit":
        return trial.checked_best(trial.fits(_stated_frame(frame)))
    fits = trial.fits(FRAMES) if frame is None else []
    if flight.one_clock and not (fits and trial.score(fits[0]) < MAX_RMS**2):
        fits = trial.fits(FRAMES, turned=True)
    return trial.checked_best(fits)


def _stated_frame(frame: str) -> dict[str, Frame]:
    """Return a frame by its name, or from a JSON file."""
    if frame in FRAMES:
        return {frame: FRAMES[frame]}
    try:
        content = parsed_json(file_text(frame))
        content = content.get("alignment", content)
        R, p = (np.array(content[key], np.float64) for key in ("rotation", "shift"))
        if p.shape != (3,) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise ValueError("rotation is not orthonormal, or shift does not have three numbers")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        bound = "plan, y-up, fit, or a JSON file with rotation and shift"
        raise InputError("frame", frame, bound, f"write plan ({error})") from error
    return {frame: (R, p)}


class _Trial:
    """Search for the alignment of a recording; offsets of fits count from its middle."""

    def __init__(
        self,
        flight: RecordedFlight,
        task: TeamTask,
        requested: Mapping[str, str],
        start: float | None,
    ) -> None:
        self._task = task
        self._one_clock = flight.one_clock
        drones = task.team.drone_names
        bodies = [name for name in flight.tracks if name not in task.team.point_names]
        if len(bodies) < len(drones):
            noun = "body" if len(bodies) == 1 else "bodies"
            count = f"contains {len(bodies)} {noun} ({', '.join(bodies) or 'none'})"
            notes = [note for note in flight.notes if "topic=" in note or "omitted" in note]
            remedy = "; ".join(["export all rigid bodies", *notes])
            raise FileError(f"{count} for {len(drones)} drones; {remedy}")
        self._bodies = bodies
        remedy = "write cf231=q0,…"
        self._allowed = np.ones((len(bodies), len(drones)), np.bool_)  # Permitted pairs
        for name, drone in requested.items():
            if name not in bodies:
                raise InputError("names", name, f"one of {', '.join(bodies)}", remedy)
            if drone not in drones or list(requested.values()).count(drone) > 1:
                listed = ", ".join(task.team.listed_names)
                raise InputError(f"names.{name}", drone, f"one of {listed}, once", remedy)
            b, i = bodies.index(name), drones.index(drone)
            self._allowed[b], self._allowed[:, i] = False, False
            self._allowed[b, i] = True
        # Setpoints that all drones logged have no lag
        has_logged = set(bodies) <= set(flight.setpoints) and not flight.as_sent
        logged = flight.setpoints if has_logged else flight.tracks
        tracks = [logged[name] for name in bodies]
        ends = np.array([track.t[[0, -1]] for track in tracks])
        if flight.one_clock:
            ends[:] = np.min(ends), np.max(ends)
        self._origins = np.mean(ends, axis=1)
        half = 0.5 * float(np.max(np.ptp(ends, axis=1)))
        self._t = np.linspace(-half, half, int(2.0 * half / STEP) + 2)
        each = [track.at(self._t + o) for track, o in zip(tracks, self._origins, strict=True)]
        self._x, self._near = (np.stack(part, axis=1) for part in zip(*each, strict=True))
        plan = task.states.positions
        self._timed = start is None
        t = task.states.t - task.states.t[0]
        self._curves = [make_interp_spline(t, x, 1) for x in plan.swapaxes(0, 1)]
        for source, positions in (("plan", plan), ("recording", self._x)):
            if self._timed and np.max(np.ptp(positions, axis=0)) < MIN_MOTION:
                remedy = "no clock can be fitted; state when the plan begins with start="
                raise FileError(f"nothing moves in the {source}, so {remedy}")
        half -= 0.5 * MIN_TIME
        offsets = np.arange(-half, task.duration + half, COARSE_STEPS * STEP)  # Candidates [s]
        self._offsets = offsets if start is None else np.array([self._origins[0] - start])

    def fits(self, frames: Mapping[str, Frame], *, turned: bool = False) -> list[Alignment]:
        """Return refined fits of the best assignments, best first; ``turned`` searches headings."""
        yaws = 2.0 * np.pi * np.arange(YAWS if turned else 1) / YAWS
        drones = len(self._curves)
        turns = np.stack([_turn(yaw) for yaw in yaws])
        best = dict[Any, tuple[float, Alignment]]()
        for name, (R, p) in frames.items() if len(self._offsets) else ():
            x = self._x[::COARSE_STEPS] @ R.T + p
            costs = np.stack([self._costs(x, o, turns, turned) for o in self._offsets])
            clocks = np.broadcast_to(self._offsets[:, None, None, None], costs.shape)
            if not self._one_clock:
                clocks = self._offsets[np.argmin(costs, axis=0)][None]
                costs = np.min(costs, axis=0, keepdims=True)
            costs = np.where(self._allowed, costs, EXCLUDED)
            for i, k in np.ndindex(costs.shape[:2]):
                body = linear_sum_assignment(costs[i, k].T)[1]
                pairs = (i, k, body, np.arange(drones))
                key = tuple(self._bodies[b] for b in body)
                score = float(np.mean(costs[pairs]))
                if key not in best or score < best[key][0]:
                    frame = turns[k] @ R, p, key, np.nan, (), "fit" if turned else name
                    best[key] = score, Alignment(clocks[pairs], 1.0, np.nan, np.nan, *frame)
        ranked = sorted(best.values(), key=lambda each: each[0])[:MAX_REFINED]
        return sorted((self._refined(fit) for _, fit in ranked), key=self.score)

    def _costs(self, x: Array, offset: float, turns: Array, centred: bool) -> Array:
        """Return mean squared distances of bodies and drones (turns, m, 2n) [m²] at an offset.

        Positions x (times, m, 3) are rotated, after centring if requested. The part of the plan
        that is not recorded counts with the distance UNRECORDED.
        """
        tau = offset + self._t[::COARSE_STEPS]
        recorded = (tau >= 0.0) & (tau <= self._task.duration)
        if not np.any(recorded):
            return np.full((len(turns), *self._allowed.shape), EXCLUDED)
        share = min(1.0, np.sum(recorded) * COARSE_STEPS * STEP / self._task.duration)
        plan = np.stack([at(tau[recorded]) for at in self._curves], axis=1)
        x = x[recorded]
        middle = np.mean(plan, axis=(0, 1))
        plan = plan - middle
        x = x - (np.mean(x, axis=(0, 1)) if centred else middle)
        squares = np.mean(np.sum(x**2, -1), 0)[:, None] + np.mean(np.sum(plan**2, -1), 0)
        products = np.tensordot(x, plan, (0, 0)) / len(x)  # (m, 3, 2n, 3)
        squares = squares - 2.0 * np.einsum("bjki,fij->fbk", products, turns)
        return np.asarray(share * squares + (1.0 - share) * UNRECORDED**2)

    def _deviations(
        self, fit: Alignment, use: NDArray[np.bool_] | None = None
    ) -> tuple[Frame, Array, NDArray[np.bool_], Array]:
        """Return the frame, which is fitted if requested, and deviations from the plan.

        Then follow deviations (times, 2n, 3) [m], zero where they are not used, a mask of those
        that are used (times, 2n), and planned positions (times, 2n, 3) [m].
        """
        index = [self._bodies.index(name) for name in fit.names]
        tau = fit.rate * self._t[:, None] + fit.offsets
        x = self._x[:, index]
        clipped = np.clip(tau, 0.0, self._task.duration)
        plan = np.stack([at(t) for at, t in zip(self._curves, clipped.T, strict=True)], axis=1)
        frame = (fit.rotation, fit.shift)
        visible = (tau == clipped) & self._near[:, index]
        use = visible if use is None else use
        if fit.frame == "fit" and np.any(use):
            up = min((R for R, _ in FRAMES.values()), key=lambda R: -R[2] @ fit.rotation[2])
            frame = _fitted_frame(x, plan, use, up)
        return frame, (x @ frame[0].T + frame[1] - plan) * use[..., None], use, plan

    def score(self, fit: Alignment) -> float:
        """Return the mean squared distance over the plan [m²]."""
        _, off, use, _ = self._deviations(fit)
        total = max(self._task.duration / (STEP * fit.rate) * use.shape[1], np.sum(use))
        return float((np.sum(off**2) + (total - np.sum(use)) * UNRECORDED**2) / total)

    def _refined(self, fit: Alignment) -> Alignment:
        """Return a fit with refined clocks, with a drift only if that clearly lowers the cost."""
        if not self._timed:
            return fit
        fit, cost = self._with_clocks(fit, 0)
        drifting, drifting_cost = self._with_clocks(fit, 1)
        drifts = MIN_DRIFT < abs(drifting.rate - 1.0) < MAX_DRIFT
        return drifting if drifts and drifting_cost < GAIN * cost else fit

    def _with_clocks(self, fit: Alignment, with_rate: int) -> tuple[Alignment, float]:
        """Return a fit with refined clocks and their standard errors, and the mean robust loss.

        Errors are from a jackknife over drones and over blocks of time: displacements of a drone
        persist for the whole flight, common ones for some time.
        """
        basis = np.ones((1, len(fit.names))) if self._one_clock else np.eye(len(fit.names))
        clocks = len(basis)

        def moved(u: Array) -> Alignment:
            rate = fit.rate + float(np.sum(u[clocks:]))
            return replace(fit, offsets=fit.offsets + u[:clocks] @ basis, rate=rate)

        def residuals(u: Array, use: Any = None) -> tuple[Array, NDArray[np.bool_]]:
            """Return vectors of squares 2 ((1 + d²)^½ - 1) for distances d, and the mask used."""
            _, off, use, _ = self._deviations(moved(u), use)
            off = _centred(off, use) / ROBUST_SCALE
            root = np.sqrt(1.0 + np.sum(off**2, axis=-1, keepdims=True))
            return off * np.sqrt(2.0 / (1.0 + root)), use

        u = np.zeros(clocks + with_rate)
        steps = np.diag([CLOCK_STEP] * clocks + [CLOCK_STEP / 10.0] * with_rate)
        for _ in range(ITERATIONS):
            r, use = residuals(u)
            J = np.stack([(residuals(u + h, use)[0] - r) / np.max(h) for h in steps], axis=-1)
            g, H = np.einsum("tixu,tix->tiu", J, r), np.einsum("tixu,tixv->tiuv", J, J)
            step = np.linalg.pinv(H.sum(axis=(0, 1)), hermitian=True) @ g.sum(axis=(0, 1))
            u = np.clip(u - step, -MAX_CLOCK_STEP, MAX_CLOCK_STEP)
        starts = np.unique(self._t // BLOCK, return_index=True)[1]
        variances = _jackknife(*(np.add.reduceat(each.sum(axis=1), starts) for each in (H, g)))
        variances += _jackknife(H.sum(axis=0), g.sum(axis=0))
        errors = np.sqrt([np.mean(variances[:clocks]), *variances[clocks:], np.nan])
        fit = replace(moved(u), offset_error=float(errors[0]), rate_error=float(errors[1]))
        return fit, 0.5 * float(np.sum(r**2)) / max(1, int(np.sum(use)))

    def checked_best(self, fits: Sequence[Alignment]) -> Alignment:
        """Return the best fit; FileError if it is poor or ambiguous."""
        if not fits:
            raise FileError(f"is too short; record at least {MIN_TIME:g} s of the plan")
        fit = fits[0]
        ((R, p), off, use, plan) = self._deviations(fits[0])
        rms = float(np.sqrt(np.sum(off**2) / np.sum(use))) if np.any(use) else np.inf
        recorded = float(np.max(np.sum(use, axis=0)) * STEP * fit.rate)
        largest, needed = MAX_RMS, MIN_TIME
        if fit.frame == "fit":
            largest = MAX_FITTED_RMS
            needed = max(0.5 * self._task.duration, MIN_TIME)
        needed = min(needed, self._task.duration)
        deviating, moving = (np.sum(_centred(x, use) ** 2) for x in (off, plan))
        unplanned = float(np.sqrt(deviating / max(moving, 1e-12)))
        if rms > largest or recorded < needed - STEP or (self._timed and unplanned > MAX_UNPLANNED):
            fit_in_words = (
                f"{rms:.2f} m from the plan (root mean square) for {recorded:.1f} s of it, and "
                f"their unplanned motion is {100.0 * unplanned:.0f} % of the planned one"
            )
            raise FileError(
                f"its drones are {fit_in_words if np.any(use) else 'nowhere near the plan'}; "
                f"limits are {largest:g} m, {needed:.1f} s and {100.0 * MAX_UNPLANNED:.0f} %: name "
                "the plan that was flown, or record more of it"
            )
        if len(fits) > 1 and self.score(fits[1]) < AMBIGUITY_RATIO**2 * self.score(fit):
            raise FileError(_ambiguity(fit, fits[1], self._task.team.drone_names))
        parts = {
            "clock": self._timed,
            "rate": fit.rate != 1.0,
            "frame": fit.frame == "fit",
            "names": np.any(np.sum(self._allowed, axis=0) > 1),
        }
        origins = self._origins[[self._bodies.index(name) for name in fit.names]]
        fitted = tuple(name for name, is_fitted in parts.items() if is_fitted)
        values: Any = {"rotation": R, "shift": p, "rms": rms, "fitted": fitted}
        return replace(fit, offsets=fit.offsets - fit.rate * origins, **values)


def _ambiguity(fit: Alignment, other: Alignment, drones: Sequence[str]) -> str:
    """Return the words for two assignments that fit equally well, and the remedy."""
    pairs = zip(drones, fit.names, other.names, strict=True)
    drone, *bodies = next(pair for pair in pairs if pair[1] != pair[2])
    words = f"two assignments fit equally well: {bodies[0]} or {bodies[1]} is {drone}"
    remedy = " or frame='plan'" if fit.frame == "fit" else ""
    return f"{words}; pass names=, such as {bodies[0]}={drone},{remedy}".rstrip(",")


def _centred(values: Array, use: NDArray[np.bool_]) -> Array:
    """Return values (times, 2n, 3) less their means over the times used, zero elsewhere."""
    total = np.maximum(np.sum(use, axis=0), 1)[:, None]
    means = np.sum(values * use[..., None], axis=0) / total
    return np.asarray((values - means) * use[..., None])


def _jackknife(H: Array, g: Array) -> Array:
    """Return jackknife variances (u,) from blocks of normal equations (b, u, u), (b, u)."""
    changes = np.linalg.pinv(np.sum(H, axis=0) - H, hermitian=True) @ g[..., None]
    return np.asarray(np.sum(changes[..., 0] ** 2, axis=0) * (1.0 - 1.0 / len(g)))


def _turn(yaw: float) -> Array:
    """Return the rotation (3, 3) about the vertical by an angle [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _fitted_frame(x: Array, plan: Array, use: NDArray[np.bool_], up: Array) -> Frame:
    """Return the frame that fits positions (times, 2n, 3) [m] to the plan's, after rotation ``up``.

    Heading and horizontal shift are fitted where ``use`` (times, 2n) is true. So is the height if
    the drones' median height differs by more than LIFT_RATIO of its standard errors.
    """
    a = x @ up.T
    (u, v), (s, w) = ((y[use] - np.mean(y[use], axis=0))[:, :2].T for y in (a, plan))
    turn = _turn(float(np.arctan2(np.sum(u * w - v * s), np.sum(u * s + v * w))))
    shift = np.mean(plan[use], axis=0) - turn @ np.mean(a[use], axis=0)
    counts = np.sum(use, axis=0)
    lifts = np.sum((plan - a)[..., 2] * use, axis=0)[counts > 0] / counts[counts > 0]
    # A median of k normal values has (pi / 2)^½ the standard error of their mean
    error = np.sqrt(0.5 * np.pi / len(lifts)) * np.std(lifts, ddof=1) if len(lifts) > 1 else np.inf
    lift = float(np.median(lifts))
    shift[2] = lift if abs(lift) > LIFT_RATIO * error else 0.0
    return turn @ up, shift
