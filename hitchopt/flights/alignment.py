"""Clock, frame and names of a recorded flight, from its bodies and the drones of the plan.

Mean squared distances assign bodies to drones at every offset of the clock, in the plan's frame or
with y upright; if drones are then far from their plan, in frames turned about the vertical. The
best assignments are refined by robust least squares of the clock, in which every drone has a
constant displacement. A lag that all drones share becomes part of the clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import linear_sum_assignment

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.flights.recordings import RecordedFlight
from hitchopt.simulation.task import Task
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array

STEP, COARSE = 0.05, 5  # Of the compared times [s], and as many of them in the search
TURNS = 36  # Frames about the vertical in the search
REFINED, STEPS = 5, 10  # Best assignments that are refined, and steps of each
BLUR = 0.01  # Difference of clocks by which costs are differentiated [s]
LARGEST_CHANGE = 0.5  # Of a clock's offset, by refinement [s]
# Least and largest difference of a clock's rate from 1, and the largest ratio of costs, at which it
# is not 1
MIN_DRIFT, MAX_DRIFT, GAIN = 2e-3, 0.024, 0.8
ROBUST = 0.02  # Distance from which on residuals count less [m]
BLOCK = 2.0  # Time after which displacements of drones count as independent [s]
# Largest distance of drones from their plan, root mean square, and in a frame that is fitted [m];
# largest ratio of movements off the plan to those in it, root mean square
MAX_RMS, MAX_FITTED_RMS, MAX_UNPLANNED = 0.15, 0.08, 0.5
UNSEEN = 0.15  # Distance that counts while the plan is not recorded [m]
MIN_TIME = 2.0  # Least recorded time of the plan [s]; in a frame that is fitted, half of it too
MIN_MOTION = 0.05  # Least distance between positions of a team that moves [m]
ALIKE = 1.25  # Ratio of distances up to which two assignments fit alike
LIFTED = 0.05  # Least difference of heights that is fitted [m]
EXCLUDED = 1e6  # Cost of a pair that is excluded [m²]

Frame = tuple[Array, Array]
"""Rotation (3, 3) and shift (3,) [m] from a recording to the plan's frame."""

UP: dict[str, Frame] = {
    "plan": (np.eye(3), np.zeros(3)),
    "y-up": (np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3)),
}
"""Frames that need not be fitted."""


@dataclass(frozen=True, eq=False)
class Alignment(OneLine):
    """Clock, frame and names: plan time is ``rate t + offset``, its frame ``rotation x + shift``.

    Attributes
    ----------
    offsets: of the clock of every drone q0, r0, … (2n,) [s]; equal if they share one.
    rate: seconds of the plan per second of the recording.
    offset_error, rate_error: standard errors, from how drones and parts of the flight differ; nan
        if not fitted.
    rotation, shift: from the recording's frame to the plan's (3, 3), (3,) [m].
    names: recorded names of the drones q0, r0, q1, …
    rms: distance of the drones from the plan, root mean square [m].
    fitted: fitted parts, among ``clock``, ``rate``, ``frame`` and ``names``.
    frame: ``plan``, ``y-up``, ``fit``, or the path of the file with it.
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
        """Offset of the clock that the drones share, or mean of their offsets [s]."""
        return float(np.mean(self.offsets))

    @property
    def frame_error(self) -> float:
        """Standard error of positions by a frame that is fitted [m]; zero of a known one.

        The displacement that drones share is part of the frame; its squares are taken to be half
        of those in which drones differ.
        """
        return self.rms / np.sqrt(2.0) if "frame" in self.fitted else 0.0

    def placed(self, positions: Array) -> Array:
        """Return recorded positions (…, 3) [m] in the plan's frame."""
        return np.asarray(positions @ self.rotation.T + self.shift)


def align(
    flight: RecordedFlight,
    task: Task,
    *,
    names: Mapping[str, str] | None = None,
    frame: str | None = None,
    start: float | None = None,
) -> Alignment:
    """Return clock, frame and names of a recorded flight of a plan; see ``evaluate``.

    Raises
    ------
    FileError: fewer bodies than drones, nothing moves, too little of the plan, another plan, or
        two assignments that fit alike.
    InputError: names or a frame that do not exist.
    """
    for name, value in (("start", start), ("frame", frame if frame == "fit" else None)):
        if value is not None and not flight.one_clock:
            raise InputError(name, value, "left out", "drones have clocks of their own")
    trial = _Trial(flight, task, names or {}, start)
    if frame is not None and frame != "fit":
        return trial.judged(trial.fits(_stated_frame(frame)))
    fits = trial.fits(UP) if frame is None else []
    if flight.one_clock and not (fits and trial.score(fits[0]) < MAX_RMS**2):
        fits = trial.fits(UP, turned=True)
    return trial.judged(fits)


def _stated_frame(frame: str) -> dict[str, Frame]:
    """Return the frame of a name, or of a JSON file."""
    if frame in UP:
        return {frame: UP[frame]}
    try:
        content = parsed_json(Path(frame).read_text(encoding="utf-8"))
        content = content.get("alignment", content)
        R, p = (np.array(content[key], np.float64) for key in ("rotation", "shift"))
        if p.shape != (3,) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise ValueError("rotation is not orthonormal, or shift not of three numbers")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        bound = "plan, y-up, fit, or a JSON file with rotation and shift"
        raise InputError("frame", frame, bound, f"write plan ({error})") from error
    return {frame: (R, p)}


class _Trial:
    """A recording and a plan at common times; offsets of fits count from the recording's middle."""

    def __init__(
        self, flight: RecordedFlight, task: Task, names: Mapping[str, str], start: float | None
    ) -> None:
        self._task, self._one_clock, drones = task, flight.one_clock, task.team.drone_names
        bodies = [name for name in flight.tracks if name not in task.team.point_names]
        if len(bodies) < len(drones):
            count = f"holds {len(bodies)} bodies ({', '.join(bodies) or 'none'})"
            raise FileError(f"{count} of {len(drones)} drones; export all rigid bodies")
        self._bodies, remedy = bodies, "write cf231=q0,…"
        self._allowed = np.ones((len(bodies), len(drones)), np.bool_)  # Pairs, by the request
        for name, drone in names.items():
            if name not in bodies:
                raise InputError("names", name, f"one of {', '.join(bodies)}", remedy)
            if drone not in drones or list(names.values()).count(drone) > 1:
                raise InputError(
                    f"names.{name}", drone, f"one of {', '.join(drones)}, once", remedy
                )
            b, i = bodies.index(name), drones.index(drone)
            self._allowed[b], self._allowed[:, i] = False, False
            self._allowed[b, i] = True
        # Set points, if they were logged, have no lag
        logged = flight.setpoints if set(bodies) <= set(flight.setpoints) else flight.tracks
        tracks = [logged[name] for name in bodies]
        ends = np.array([track.t[[0, -1]] for track in tracks])
        if flight.one_clock:
            ends[:] = np.min(ends), np.max(ends)
        self._origins, half = np.mean(ends, axis=1), 0.5 * float(np.max(np.ptp(ends, axis=1)))
        self._t = np.linspace(-half, half, int(2.0 * half / STEP) + 2)
        each = [track.at(self._t + o) for track, o in zip(tracks, self._origins, strict=True)]
        self._x, self._near = (np.stack(part, axis=1) for part in zip(*each, strict=True))
        plan, self._timed = task.setpoints.positions, start is None
        self._curves = [make_interp_spline(task.t - task.t[0], x, 1) for x in plan.swapaxes(0, 1)]
        for words, places in (("plan", plan), ("recording", self._x)):
            if self._timed and np.max(np.ptp(places, axis=0)) < MIN_MOTION:
                remedy = "no clock can be fitted; say when the plan begins with start="
                raise FileError(f"nothing moves in the {words}, so {remedy}")
        half -= 0.5 * MIN_TIME
        offsets = np.arange(-half, task.duration + half, COARSE * STEP)  # In the search [s]
        self._offsets = offsets if start is None else np.array([self._origins[0] - start])

    def fits(self, frames: Mapping[str, Frame], *, turned: bool = False) -> list[Alignment]:
        """Return refined fits of the best assignments, best first, in frames or in turned ones."""
        yaws, drones = 2.0 * np.pi * np.arange(TURNS if turned else 1) / TURNS, len(self._curves)
        turns, best = np.stack([_turn(yaw) for yaw in yaws]), dict[Any, tuple[float, Alignment]]()
        for name, (R, p) in frames.items() if len(self._offsets) else ():
            x = self._x[::COARSE] @ R.T + p
            costs = np.stack([self._costs(x, o, turns, turned) for o in self._offsets])
            clocks = np.broadcast_to(self._offsets[:, None, None, None], costs.shape)
            if not self._one_clock:
                clocks = self._offsets[np.argmin(costs, axis=0)][None]
                costs = np.min(costs, axis=0, keepdims=True)
            costs = np.where(self._allowed, costs, EXCLUDED)
            for i, k in np.ndindex(costs.shape[:2]):
                body = linear_sum_assignment(costs[i, k].T)[1]
                pairs, key = (i, k, body, np.arange(drones)), tuple(self._bodies[b] for b in body)
                score = float(np.mean(costs[pairs]))
                if key not in best or score < best[key][0]:
                    placed = turns[k] @ R, p, key, np.nan, (), "fit" if turned else name
                    best[key] = score, Alignment(clocks[pairs], 1.0, np.nan, np.nan, *placed)
        ranked = sorted(best.values(), key=lambda each: each[0])[:REFINED]
        return sorted((self._refined(fit) for _, fit in ranked), key=self.score)

    def _costs(self, x: Array, offset: float, turns: Array, centred: bool) -> Array:
        """Return mean squared distances of bodies and drones (turns, m, 2n) at an offset.

        Positions x (times, m, 3) are turned, after centring on demand. UNSEEN counts for the part
        of the plan that is not recorded.
        """
        tau = offset + self._t[::COARSE]
        on = (tau >= 0.0) & (tau <= self._task.duration)
        if not np.any(on):
            return np.full((len(turns), *self._allowed.shape), EXCLUDED)
        share = min(1.0, np.sum(on) * COARSE * STEP / self._task.duration)
        plan = np.stack([curve(tau[on]) for curve in self._curves], axis=1)
        middle = np.mean(plan, axis=(0, 1))
        plan, x = plan - middle, x[on] - (np.mean(x[on], axis=(0, 1)) if centred else middle)
        squares = np.mean(np.sum(x**2, -1), 0)[:, None] + np.mean(np.sum(plan**2, -1), 0)
        products = np.tensordot(x, plan, (0, 0)) / len(x)  # (m, 3, 2n, 3)
        squares = squares - 2.0 * np.einsum("bjki,fij->fbk", products, turns)
        return np.asarray(share * squares + (1.0 - share) * UNSEEN**2)

    def _apart(
        self, fit: Alignment, use: NDArray[np.bool_] | None = None
    ) -> tuple[Frame, Array, NDArray[np.bool_], Array]:
        """Return the frame, fitted on demand, offsets from the plan [m], which count, and the plan.

        Shapes of the latter are (times, 2n, 3) and (times, 2n). Offsets that do not count are zero.
        """
        index = [self._bodies.index(name) for name in fit.names]
        tau, x = fit.rate * self._t[:, None] + fit.offsets, self._x[:, index]
        inside = np.clip(tau, 0.0, self._task.duration)
        plan = np.stack([at(t) for at, t in zip(self._curves, inside.T, strict=True)], axis=1)
        frame, here = (fit.rotation, fit.shift), (tau == inside) & self._near[:, index]
        use = here if use is None else use
        if fit.frame == "fit" and np.any(use):
            up = min((R for R, _ in UP.values()), key=lambda R: -R[2] @ fit.rotation[2])
            frame = _fitted_frame(x[use], plan[use], up)
        return frame, (x @ frame[0].T + frame[1] - plan) * use[..., None], use, plan

    def score(self, fit: Alignment) -> float:
        """Return the mean squared distance over the plan [m²]."""
        _, apart, use, _ = self._apart(fit)
        total = max(self._task.duration / (STEP * fit.rate) * use.shape[1], np.sum(use))
        return float((np.sum(apart**2) + (total - np.sum(use)) * UNSEEN**2) / total)

    def _refined(self, fit: Alignment) -> Alignment:
        """Return a fit with better clocks, at a rate of 1 unless another one gains clearly."""
        if not self._timed:
            return fit
        fit, cost = self._clocked(fit, 0)
        other, least = self._clocked(fit, 1)
        drifts = MIN_DRIFT < abs(other.rate - 1.0) < MAX_DRIFT
        return other if drifts and least < GAIN * cost else fit

    def _clocked(self, fit: Alignment, rates: int) -> tuple[Alignment, float]:
        """Return a fit with better clocks and their standard errors, and the mean robust square.

        Errors are the jackknife's over drones and over blocks of time: drones differ for the whole
        flight, and what displaces all of them lasts for a while.
        """
        own = np.ones((1, len(fit.names))) if self._one_clock else np.eye(len(fit.names))
        many = len(own)

        def moved(u: Array) -> Alignment:
            rate = fit.rate + float(np.sum(u[many:]))
            return replace(fit, offsets=fit.offsets + u[:many] @ own, rate=rate)

        def residuals(u: Array, use: Any = None) -> tuple[Array, NDArray[np.bool_]]:
            """Return vectors with squares 2 ((1 + d²)^½ - 1) of distances d, and which count."""
            _, apart, use, _ = self._apart(moved(u), use)
            off = _centred(apart, use) / ROBUST
            root = np.sqrt(1.0 + np.sum(off**2, axis=-1, keepdims=True))
            return off * np.sqrt(2.0 / (1.0 + root)), use

        u, steps = np.zeros(many + rates), np.diag([BLUR] * many + [BLUR / 10.0] * rates)
        for _ in range(STEPS):  # Of Gauss and Newton
            r, use = residuals(u)
            J = np.stack([(residuals(u + h, use)[0] - r) / np.max(h) for h in steps], axis=-1)
            g, H = np.einsum("tixu,tix->tiu", J, r), np.einsum("tixu,tixv->tiuv", J, J)
            step = np.linalg.pinv(H.sum(axis=(0, 1)), hermitian=True) @ g.sum(axis=(0, 1))
            u = np.clip(u - step, -LARGEST_CHANGE, LARGEST_CHANGE)
        begins = np.unique(self._t // BLOCK, return_index=True)[1]
        variances = _left_out(*(np.add.reduceat(each.sum(axis=1), begins) for each in (H, g)))
        variances += _left_out(H.sum(axis=0), g.sum(axis=0))
        errors = np.sqrt([np.mean(variances[:many]), *variances[many:], np.nan])
        fit = replace(moved(u), offset_error=float(errors[0]), rate_error=float(errors[1]))
        return fit, 0.5 * float(np.sum(r**2)) / max(1, int(np.sum(use)))

    def judged(self, fits: Sequence[Alignment]) -> Alignment:
        """Return the best fit, unless it has to be refused."""
        if not fits:
            raise FileError(f"is too short; record at least {MIN_TIME:g} s of the plan")
        fit, ((R, p), apart, use, plan) = fits[0], self._apart(fits[0])
        rms = float(np.sqrt(np.sum(apart**2) / np.sum(use))) if np.any(use) else np.inf
        seen = float(np.max(np.sum(use, axis=0)) * STEP * fit.rate)
        largest, needed = MAX_RMS, MIN_TIME
        if fit.frame == "fit":
            largest, needed = MAX_FITTED_RMS, max(0.5 * self._task.duration, MIN_TIME)
        needed = min(needed, self._task.duration)
        off, moves = (np.sum(_centred(x, use) ** 2) for x in (apart, plan))
        unplanned = float(np.sqrt(off / max(moves, 1e-12)))
        if rms > largest or seen < needed - STEP or (self._timed and unplanned > MAX_UNPLANNED):
            words = f"{rms:.2f} m from the plan (root mean square) for {seen:.1f} s of it, and move"
            words = f"{words} {100.0 * unplanned:.0f} % as much off it as in it"
            raise FileError(
                f"its drones are {words if np.any(use) else 'nowhere near the plan'}; its own are "
                f"within {largest:g} m for at least {needed:.1f} s, and move at most "
                f"{100.0 * MAX_UNPLANNED:.0f} % as much off it: name the plan that was flown, or "
                "record more of it"
            )
        if len(fits) > 1 and self.score(fits[1]) < ALIKE**2 * self.score(fit):
            raise FileError("two assignments of names fit alike: give names=, or frame='plan'")
        parts = {
            "clock": self._timed,
            "rate": fit.rate != 1.0,
            "frame": fit.frame == "fit",
            "names": np.any(np.sum(self._allowed, axis=0) > 1),
        }
        origins = self._origins[[self._bodies.index(name) for name in fit.names]]
        fitted = tuple(name for name, there in parts.items() if there)
        placed: Any = {"rotation": R, "shift": p, "rms": rms, "fitted": fitted}
        return replace(fit, offsets=fit.offsets - fit.rate * origins, **placed)


def _centred(values: Array, use: NDArray[np.bool_]) -> Array:
    """Return values (times, 2n, 3) without their means over the times that count, else zero."""
    total = np.maximum(np.sum(use, axis=0), 1)[:, None]
    means = np.sum(values * use[..., None], axis=0) / total
    return np.asarray((values - means) * use[..., None])


def _left_out(H: Array, g: Array) -> Array:
    """Return the jackknife's variances (u,), of parts of normal equations (b, u, u), (b, u)."""
    changes = np.linalg.pinv(np.sum(H, axis=0) - H, hermitian=True) @ g[..., None]
    return np.asarray(np.sum(changes[..., 0] ** 2, axis=0) * (1.0 - 1.0 / len(g)))


def _turn(yaw: float) -> Array:
    """Return the rotation (3, 3) about the vertical by an angle [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _fitted_frame(x: Array, plan: Array, up: Array) -> Frame:
    """Return the frame that brings points (k, 3) [m] next to the plan's, after the rotation up.

    Yaw and level shift are fitted, and heights if they differ by more than LIFTED.
    """
    a = x @ up.T
    (u, v), (s, w) = ((y - np.mean(y, axis=0))[:, :2].T for y in (a, plan))
    turn = _turn(float(np.arctan2(np.sum(u * w - v * s), np.sum(u * s + v * w))))
    shift = np.mean(plan, axis=0) - turn @ np.mean(a, axis=0)
    shift[2] = shift[2] if abs(shift[2]) > LIFTED else 0.0
    return turn @ up, shift
