"""Clock, frame and names of a recorded flight, from its bodies and the drones of the plan.

At every offset of the clock, mean squared distances assign bodies to drones: in the plan's frame or
with y upright if drones are then near their plan, else in frames turned about the vertical. The
clock is then refined by robust least squares in which every drone has a constant displacement. A
lag that all drones share becomes part of the clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares, linear_sum_assignment

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.flights.flight import RecordedFlight, sampled
from hitchopt.simulation.task import Task
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array, Indices

STEP = 0.05  # Of the compared times [s]
# Least difference of a clock's rate from 1, and largest ratio of costs, at which it is not 1
MIN_DRIFT, GAIN = 2e-3, 0.8
# Scales of offsets [s] and of the rate in their solution, and its range over these
CLOCK_SCALE, RATE_SCALE, RANGE = 0.05, 2e-3, 12.0
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
# Steps of the offset in known frames and in turned ones [s], number of turns and of times in the
# search, and of turned frames that are refined
KNOWN_STEP, TURNED_STEP, TURNS, COMPARED, CLOSER = 0.2, 0.5, 36, 60, 40
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
    offset_error, rate_error: standard errors, from the flight without each drone and without each
        part of its time; nan if not fitted.
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


@dataclass(frozen=True, eq=False)
class _Fit:
    """Clock, frame and assignment under trial; clocks count from the middle of the recording."""

    offsets: Array  # (2n,) of every drone [s]
    frame: str
    rotation: Array
    shift: Array
    body: Indices  # (2n,), index of every drone's body
    score: float = np.inf  # Mean square distance over the plan [m²]
    rival: float = np.inf  # Score of the next best assignment over the best
    rate: float = 1.0
    cost: float = np.inf  # Mean of robust squares without the displacements of drones
    errors: Array = field(default_factory=lambda: np.full(2, np.nan))  # Of offset and rate


def align(
    flight: RecordedFlight,
    task: Task,
    *,
    names: Mapping[str, str] | None = None,
    frame: str | None = None,
    start: float | None = None,
) -> Alignment:
    """Return clock, frame and names of a recorded flight of a plan.

    Parameters
    ----------
    flight, task: the recording, and the plan.
    names: drones of the plan by recorded names; None: by their positions.
    frame: ``plan``, ``y-up``, ``fit``, or a JSON file with ``rotation`` and ``shift``, such as the
        evaluation of another flight; None: the first of these that brings drones near their plan.
    start: time in the recording at which the plan begins [s]; None: fitted.

    Raises
    ------
    FileError: fewer bodies than drones, nothing moves, too little of the plan, another plan, or
        two assignments that fit alike.
    InputError: names or a frame that do not exist.
    """
    trial = _Trial(flight, task, dict(names or {}))
    if start is None:
        trial.require_motion()
    elif not flight.one_clock:
        raise InputError("start", start, "left out: drones have clocks of their own", "omit it")
    known = frame not in (None, "fit")
    frames = _stated_frame(str(frame)) if known else UP if frame is None else {}
    if not flight.one_clock and not frames:
        raise InputError("frame", frame, "plan or y-up: drones have clocks of their own", "omit it")
    fit = trial.nearest(frames, start)
    if not (known or (fit and fit.score < MAX_RMS**2)) and flight.one_clock:
        fit = trial.nearest_turned(start)
    if fit is None:
        raise trial.error(f"is too short; record at least {MIN_TIME:g} s of the plan")
    return trial.judged(trial.timed(fit) if start is None else trial.framed(fit), start)


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
    """A recording and a plan at common times."""

    def __init__(self, flight: RecordedFlight, task: Task, names: dict[str, str]) -> None:
        self._flight, self._task, team = flight, task, task.team
        others = [name for name in flight.tracks if name not in team.point_names]
        self._bodies = others if len(others) >= team.drones else list(flight.tracks)
        if len(self._bodies) < team.drones:
            listed = ", ".join(self._bodies) or "none"
            count = f"holds {len(self._bodies)} bodies ({listed}) of {team.drones} drones"
            raise self.error(f"{count}; export all rigid bodies")
        self._allowed = self._pairs(names)
        # Set points, if they were logged, have no lag.
        commanded = set(self._bodies) <= set(flight.setpoints)
        tracks = [(flight.setpoints if commanded else flight.tracks)[b] for b in self._bodies]
        ends = np.array([[track.t[0], track.t[-1]] for track in tracks])
        if flight.one_clock:
            ends[:] = np.min(ends), np.max(ends)
        self._origins, half = np.mean(ends, axis=1), 0.5 * float(np.max(np.ptp(ends, axis=1)))
        self._t = np.linspace(-half, half, int(2.0 * half / STEP) + 2)
        each = [sampled(x, self._t + o) for x, o in zip(tracks, self._origins, strict=True)]
        self._through = np.stack([positions for positions, _ in each], axis=1)  # Straight in gaps
        self._near = np.stack([near for _, near in each], axis=1)
        self._curves = [
            make_interp_spline(task.t - task.t[0], x, k=1)
            for x in np.moveaxis(task.setpoints.positions, 1, 0)
        ]

    def error(self, words: str) -> FileError:
        """Return the error of a recording that cannot be compared with the plan."""
        return FileError(f"{self._flight.source}: {words}")

    def _pairs(self, names: dict[str, str]) -> NDArray[np.bool_]:
        """Return whether a body may be a drone (m, 2n), by names of the request."""
        drones, bodies = list(self._task.team.drone_names), self._bodies
        allowed = np.ones((len(bodies), len(drones)), np.bool_)
        for name, drone in names.items():
            if name not in bodies:
                raise InputError("names", name, f"one of {', '.join(bodies)}", "write cf231=q0,…")
            if drone not in drones or list(names.values()).count(drone) > 1:
                bound = f"one of {', '.join(drones)}, once"
                raise InputError(f"names.{name}", drone, bound, "write cf231=q0,…")
            b, i = bodies.index(name), drones.index(drone)
            allowed[b], allowed[:, i] = False, False
            allowed[b, i] = True
        return allowed

    def _planned(self, tau: Array) -> Array:
        """Return planned positions (times, 2n, 3) [m] at plan times (times, 2n)."""
        tau = np.clip(tau, 0.0, self._task.duration)
        return np.stack([at(t) for at, t in zip(self._curves, tau.T, strict=True)], axis=1)

    def require_motion(self) -> None:
        """Raise FileError if the plan or the recording stands still, which leaves clocks open."""
        for words, x in (("plan", self._task.setpoints.positions), ("recording", self._through)):
            if np.max(np.ptp(x, axis=0)) < MIN_MOTION:
                remedy = "say when the plan begins with start="
                raise self.error(
                    f"nothing moves in the {words}, so no clock can be fitted; {remedy}"
                )

    def _offsets(self, start: float | None, step: float) -> Array:
        """Return the offsets of the clock that are compared (k,) [s]."""
        if start is not None:
            return np.array([self._origins[0] - start])
        half = self._t[-1] - 0.5 * MIN_TIME
        return np.arange(-half, self._task.duration + half, step)

    def nearest(self, frames: Mapping[str, Frame], start: float | None) -> _Fit | None:
        """Return the best fit in some frames; None if there is none."""
        fits, drones = list[_Fit](), np.arange(self._task.team.drones)
        offsets = self._offsets(start, KNOWN_STEP)
        for frame, (R, p) in frames.items() if len(offsets) else ():
            costs = np.stack([self._costs(offset, R[None], p)[0] for offset in offsets])
            if self._flight.one_clock:
                each = [self._assigned(one) for one in costs]
                i = np.full(len(drones), np.argmin([score for _, score in each]))
                body, score = each[i[0]]
            else:
                body, score = self._assigned(np.min(costs, axis=0))
                i = np.argmin(costs, axis=0)[body, drones]
            fits.append(_Fit(offsets[i], frame, R, p, body, score))
        return min(fits, key=lambda fit: fit.score, default=None)

    def nearest_turned(self, start: float | None) -> _Fit | None:
        """Return the best fit in frames turned about the vertical; None if there is none."""
        yaws = np.linspace(0.0, 2.0 * np.pi, TURNS, endpoint=False)
        rotations = np.array([_turn(yaw) @ up for up, _ in UP.values() for yaw in yaws])
        trials = [
            (score, offset, R, body)
            for offset in self._offsets(start, TURNED_STEP)
            for R, costs in zip(rotations, self._costs(offset, rotations, None), strict=True)
            for body, score in (self._assigned(costs),)
        ]
        best = dict[tuple[int, ...], _Fit]()  # By assignment
        for _, offset, R, body in sorted(trials, key=lambda each: each[0])[:CLOSER]:
            fit = self.framed(_Fit(np.full(len(body), offset), "fit", R, np.zeros(3), body))
            best[tuple(body)] = min(best.get(tuple(body), fit), fit, key=lambda each: each.score)
        fits = sorted(best.values(), key=lambda fit: fit.score)
        if len(fits) < 2:
            return fits[0] if fits else None
        return replace(fits[0], rival=fits[1].score / fits[0].score)

    def _costs(self, offset: float, rotations: Array, p: Array | None) -> Array:
        """Return mean squared distances of bodies and drones (rotations, m, 2n) at an offset.

        They are those of centred positions if the shift p is None. UNSEEN counts for the part of
        the plan that is not recorded.
        """
        tau = offset + self._t
        rows = np.flatnonzero((tau >= 0.0) & (tau <= self._task.duration))
        share = min(1.0, len(rows) * STEP / self._task.duration)
        rows = rows[:: max(1, len(rows) // COMPARED)]
        if not len(rows):
            return np.full((len(rotations), *self._allowed.shape), EXCLUDED)
        plan = self._planned(np.repeat(tau[rows, None], self._task.team.drones, axis=1))
        x = np.einsum("fij,tbj->ftbi", rotations, self._through[rows])
        middle = np.mean(plan, axis=(0, 1))
        shift = p - middle if p is not None else -np.mean(x, axis=(1, 2), keepdims=True)
        x, plan = x + shift, plan - middle
        squares = np.sum(x**2, axis=-1).mean(axis=1)[..., None] + np.sum(plan**2, axis=-1).mean(0)
        squares -= 2.0 * np.einsum("ftbi,tki->fbk", x, plan) / len(rows)
        return np.asarray(share * squares + (1.0 - share) * UNSEEN**2)

    def _assigned(self, costs: Array) -> tuple[Indices, float]:
        """Return the body of every drone with the least mean cost, of costs (m, 2n)."""
        b, i = linear_sum_assignment(np.where(self._allowed, costs, EXCLUDED))
        return b[np.argsort(i)], float(np.mean(costs[b, i]))

    def _apart(self, fit: _Fit) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return offsets of drones from the plan (times, 2n, 3) [m], which count, and the plan."""
        tau = fit.rate * self._t[:, None] + fit.offsets
        plan = self._planned(tau)
        apart = self._through[:, fit.body] @ fit.rotation.T + fit.shift - plan
        return apart, (tau >= 0.0) & (tau <= self._task.duration) & self._near[:, fit.body], plan

    def framed(self, fit: _Fit) -> _Fit:
        """Return a fit with its score, and with a better frame if that is fitted."""
        apart, use, plan = self._apart(fit)
        if fit.frame == "fit" and np.any(use):
            up = min((R for R, _ in UP.values()), key=lambda R: -R[2] @ fit.rotation[2])
            R, p = _fitted_frame(self._through[:, fit.body][use], plan[use], up)
            fit = replace(fit, rotation=R, shift=p)
            apart, use, _ = self._apart(fit)
        total = max(self._task.duration / (STEP * fit.rate) * use.shape[1], np.sum(use))
        squares = np.sum(apart[use] ** 2) + (total - np.sum(use)) * UNSEEN**2
        return replace(fit, score=float(squares / total))

    def timed(self, fit: _Fit) -> _Fit:
        """Return a fit with better clocks, at a rate of 1 unless another one gains clearly."""
        plain = self._clocked(self._clocked(fit, with_rate=False), with_rate=False)
        other = self._clocked(self._clocked(plain, with_rate=True), with_rate=True)
        clearly = other.cost < GAIN * plain.cost and abs(other.rate - 1.0) > MIN_DRIFT
        return other if clearly else plain

    def _clocked(self, fit: _Fit, *, with_rate: bool) -> _Fit:
        """Return a fit with better clocks, their cost and standard errors, and a better frame."""
        clocks = 1 if self._flight.one_clock else len(fit.body)
        scale = np.append(np.full(clocks, CLOCK_SCALE), [RATE_SCALE] * with_rate)

        def at(unknown: Array) -> _Fit:
            change = scale * (unknown - 1.0)  # Differences are taken relative to unknowns
            rate = fit.rate + float(np.sum(change[clocks:]))
            return replace(fit, offsets=fit.offsets + change[:clocks], rate=rate)

        use = self._apart(fit)[1]

        def residuals(unknown: Array) -> Array:
            return self._displaced(at(unknown), use).ravel()

        bounds = 1.0 - RANGE, 1.0 + RANGE
        robust: Any = {"loss": "soft_l1", "f_scale": ROBUST, "diff_step": 1e-2, "bounds": bounds}
        solution: Any = least_squares(residuals, np.ones(len(scale)), **robust)
        steps = 0.1 * np.eye(len(scale))
        J = np.stack([residuals(solution.x + h) - residuals(solution.x - h) for h in steps]) / 0.2
        squares = scale**2 * self._variances(J.reshape(-1, *use.shape, 3), solution.fun)
        errors = np.sqrt([np.mean(squares[:clocks]), *squares[clocks:], np.nan][:2])
        cost = float(solution.cost / max(1, 3 * np.count_nonzero(use)))
        return self.framed(replace(at(solution.x), errors=errors, cost=cost))

    def _displaced(self, fit: _Fit, use: NDArray[np.bool_]) -> Array:
        """Return offsets from the plan (times, 2n, 3) [m] without every drone's median."""
        apart = np.where(use[..., None], self._apart(fit)[0], np.nan)
        return np.nan_to_num(apart - _median(apart))

    def _variances(self, J: Array, residuals: Array) -> Array:
        """Return variances of unknowns by leaving out each drone, and each part of the time.

        ``J`` are derivatives (unknowns, times, 2n, 3). Drones differ for the whole flight, and what
        displaces all of them lasts for a while: both variances are added.
        """
        weights = 1.0 / np.sqrt(1.0 + (residuals.reshape(J.shape[1:]) / ROBUST) ** 2)
        g = np.einsum("utix,tix->uti", J, weights * residuals.reshape(J.shape[1:]))
        H = np.einsum("utix,vtix,tix->uvti", J, J, weights)
        parts = np.unique(self._t // BLOCK, return_inverse=True)[1]
        groups = [np.eye(J.shape[2])] if self._flight.one_clock else []
        groups.append(np.eye(int(np.max(parts)) + 1)[parts])
        total = np.zeros(len(J))
        for group, axis in zip(groups[::-1], "ti", strict=False):
            own = np.einsum(f"uti,{axis}b->ub", g, group)
            left = np.sum(H, axis=(2, 3)) - np.einsum(f"uvti,{axis}b->buv", H, group)
            changes = np.einsum("buv,vb->ub", np.linalg.pinv(left, hermitian=True), own)
            total += np.sum(changes**2, axis=1) * (1.0 - 1.0 / group.shape[1])
        return total

    def judged(self, fit: _Fit, start: float | None) -> Alignment:
        """Return the alignment of the best fit, unless it has to be refused."""
        apart, use, plan = self._apart(fit)
        rms = float(np.sqrt(np.mean(np.sum(apart[use] ** 2, axis=-1)))) if use.any() else np.inf
        seen = float(np.max(np.sum(use, axis=0)) * STEP * fit.rate)
        largest, needed = MAX_RMS, MIN_TIME
        if fit.frame == "fit":
            largest, needed = MAX_FITTED_RMS, max(0.5 * self._task.duration, MIN_TIME)
        needed = min(needed, self._task.duration)
        moved = np.where(use[..., None], plan, np.nan)
        moved = np.nan_to_num(moved - _median(moved))
        unplanned = float(np.sum(self._displaced(fit, use) ** 2) / max(np.sum(moved**2), 1e-12))
        other = start is None and unplanned > MAX_UNPLANNED**2
        if rms > largest or seen < needed - STEP or other:
            words = f"{rms:.2f} m from the plan (root mean square) for {seen:.1f} s of it"
            words += f", and move {100.0 * np.sqrt(unplanned):.0f} % as much off it as in it"
            raise self.error(
                f"its drones are {words if np.any(use) else 'nowhere near the plan'}; its own are "
                f"within {largest:g} m for at least {needed:.1f} s, and move at most "
                f"{100.0 * MAX_UNPLANNED:.0f} % as much off it: name the plan that was flown, or "
                "record more of it"
            )
        if fit.rival < ALIKE**2:
            raise self.error("two assignments of names fit alike: give names=, or frame='plan'")
        parts = {
            "clock": start is None,
            "rate": fit.rate != 1.0,
            "frame": fit.frame == "fit",
            "names": np.any(np.sum(self._allowed, axis=0) > 1),
        }
        return Alignment(
            fit.offsets - fit.rate * self._origins[fit.body],
            fit.rate,
            float(fit.errors[0]),
            float(fit.errors[1]),
            fit.rotation,
            fit.shift,
            tuple(self._bodies[b] for b in fit.body),
            rms,
            tuple(name for name, fitted in parts.items() if fitted),
            fit.frame,
        )


def _median(values: Array) -> Array:
    """Return medians over the first axis of finite values; zero if there is none."""
    none = ~np.any(np.isfinite(values), axis=0)
    return np.asarray(np.nanmedian(np.where(none, 0.0, values), axis=0))


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
