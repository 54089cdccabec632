"""Clock, frame and names of a recorded flight, from where its bodies and the plan's drones are.

At every offset of the clock, mean squared distances assign bodies to drones: in the plan's frame or
with y upright if drones are then near their plan, else in frames turned about the vertical. The
clock of the best is refined by robust least squares that leave a constant displacement of every
drone free. A lag that all drones share becomes part of the clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linear_sum_assignment

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.flights.flight import RecordedFlight, Track
from hitchopt.simulation.task import Task
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array, Indices

STEP, SEEN = 0.05, 0.1  # Of the compared times, and largest distance to a sample there [s]
# Rates of clocks that are tried: timestamps in logs of Crazyflies were slow by 84/85 until August
# 2026; least difference of a rate from 1, and ratio of costs with which it is not 1
RATES, LEAST_RATE, GAIN = (1.0, 85.0 / 84.0), 2e-3, 0.8
OFFSET, RATE = 0.05, 2e-3  # Scales of what is fitted of a clock [s], [–]
ROBUST = 0.02  # Distance from which on residuals count less [m]
# Largest distance of drones from their plan, root mean square, and in a frame that is fitted [m];
# in such a frame half of the plan has to be recorded
FARTHEST, FITTED = 0.15, 0.08
UNSEEN = 0.15  # Distance that counts where the plan was not recorded [m]
LEAST_TIME = 2.0  # Least recorded time of the plan [s]
STILL = 0.05  # Largest distance between places of a drone that stands still [m]
ALIKE = 1.25  # Ratio of distances up to which two assignments fit alike
LIFTED = 0.05  # Least difference of heights that is fitted [m]
# Steps of the offset, in known frames and in turned ones [s], and of the turns; the number of times
# that are compared, and of turned frames that are looked at closer
KNOWN_STEP, TURNED_STEP, YAWS = 0.2, 0.5, np.radians(np.arange(0.0, 360.0, 10.0))
COMPARED, CLOSER = 60, 40
HUGE = 1e6  # Cost of a pair that is excluded [m²]

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
    offset_error, rate_error: standard errors, from how drones differ; nan if not fitted.
    rotation, shift: from the recording's frame to the plan's (3, 3), (3,) [m].
    names: recorded names of the drones q0, r0, q1, …
    rms: distance of the drones from the plan, root mean square [m].
    fitted: what was fitted, among ``clock``, ``rate``, ``frame`` and ``names``.
    frame: ``plan``, ``y-up``, ``fit``, or the path of the file that it is from.
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
        """Standard error of places by a frame that is fitted [m]; zero of a known one."""
        return self.rms / np.sqrt(len(self.names)) if "frame" in self.fitted else 0.0

    def placed(self, positions: Array) -> Array:
        """Return recorded positions (…, 3) [m] in the plan's frame."""
        return np.asarray(positions @ self.rotation.T + self.shift)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Clocks, frame and assignment under trial; the clocks count from the origins of a trial."""

    offsets: Array  # (2n,) of every drone [s]
    rate: float
    rotation: Array
    shift: Array
    body: Indices  # (2n,), index of every drone's body
    frame: str
    score: float  # Mean square distance over the plan [m²]
    rival: float = np.inf  # That of the next best assignment, over the best
    cost: float = np.inf  # Mean of robust squares, after the displacements
    errors: Array = field(default_factory=lambda: np.full(2, np.nan))  # Of offset and rate


def sampled(track: Track, t: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return places at times (times, 3) [m], straight between samples, and whether it was seen."""
    places = np.column_stack([np.interp(t, track.t, axis) for axis in track.positions.T])
    i = np.searchsorted(track.t, t)
    near = track.t[np.clip([i - 1, i], 0, len(track.t) - 1)]
    return places, np.min(np.abs(near - t), axis=0) < SEEN


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
    names: drones of the plan by recorded names; None: by where they are.
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
    if start is None and (still := trial.still()):
        remedy = "say when the plan begins: --start SECONDS"
        raise trial.error(f"nothing moves in the {still}, so no clock can be fitted; {remedy}")
    if start is not None and not flight.one_clock:
        raise InputError("start", start, "left out: drones have clocks of their own", "omit it")
    known = frame not in (None, "fit")
    frames = _stated_frame(str(frame)) if known else UP if frame is None else {}
    if not flight.one_clock and not frames:
        raise InputError("frame", frame, "plan or y-up: drones have clocks of their own", "omit it")
    rates = RATES if start is None else (1.0,)
    fits = [fit for r in rates for fit in trial.searched(r, frames, start, known=known)]
    if not fits:
        raise trial.error(f"is too short; record at least {LEAST_TIME:g} s of the plan")
    return trial.judged(trial.best(fits, start), timed=start is not None)


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
        seen = [name for name, track in flight.tracks.items() if len(track.t)]
        others = [name for name in seen if name not in team.point_names]
        self._bodies = others if len(others) >= team.drones else seen
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
        self._origins = np.mean(ends, axis=1)
        half = 0.5 * float(np.max(np.ptp(ends, axis=1)))
        self._t = t = np.linspace(-half, half, int(2.0 * half / STEP) + 2)
        self._x = np.full((len(t), len(tracks), 3), np.nan)
        self._through = np.zeros_like(self._x)  # Straight through gaps
        for b, track in enumerate(tracks):
            self._through[:, b], near = sampled(track, t + self._origins[b])
            self._x[near, b] = self._through[near, b]

    def error(self, words: str) -> FileError:
        """Return the error of a recording that cannot be compared with the plan."""
        return FileError(f"{self._flight.source}: {words}")

    def _pairs(self, names: dict[str, str]) -> NDArray[np.bool_]:
        """Return whether a body may be a drone (m, 2n), by names that were given."""
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

    def _planned(self, tau: Array, drones: Indices | slice = slice(None)) -> Array:
        """Return planned positions (times, drones, 3) [m] at plan times (times, drones)."""
        t, x = self._task.t - self._task.t[0], self._task.setpoints.positions[:, drones]
        i = np.clip(np.searchsorted(t, tau, side="right") - 1, 0, len(t) - 2)
        share = np.clip((tau - t[i]) / (t[i + 1] - t[i]), 0.0, 1.0)[..., None]
        k = np.arange(x.shape[1])
        return np.asarray((1.0 - share) * x[i, k] + share * x[i + 1, k])

    def still(self) -> str:
        """Return which stands still, the plan or the recording; else nothing."""
        for words, x in (("plan", self._task.setpoints.positions), ("recording", self._through)):
            if np.max(np.ptp(x, axis=0)) < STILL:
                return words
        return ""

    def searched(
        self, rate: float, frames: Mapping[str, Frame], start: float | None, *, known: bool
    ) -> Iterator[_Fit]:
        """Yield the best fits at a rate, in each frame; if none is near, in some turned ones."""
        first, last = rate * self._t[[0, -1]]
        ends = -last + 0.5 * LEAST_TIME, self._task.duration - first - 0.5 * LEAST_TIME
        begun = None if start is None else np.array([self._origins[0] - start])
        offsets = np.arange(*ends, KNOWN_STEP) if begun is None else begun
        near, k = False, np.arange(self._task.team.drones)
        for word, (R, p) in frames.items():
            costs = np.stack([self._costs(offset, rate, R, p) for offset in offsets])
            if self._flight.one_clock:
                each = [self._assigned(one) for one in costs]
                at = np.full(len(k), np.argmin([score for _, score in each]))
                body, score = each[at[0]]
            else:
                body, score = self._assigned(np.min(costs, axis=0))
                at = np.argmin(costs, axis=0)[body, k]
            near |= score < FARTHEST**2
            yield _Fit(offsets[at], rate, R, p, body, word, score)
        if known or near or not self._flight.one_clock:
            return
        offsets = np.arange(*ends, TURNED_STEP) if begun is None else begun
        turns = [_turn(yaw) @ up for up, _ in UP.values() for yaw in YAWS]
        found = [
            (score, offset, R, body)
            for offset in offsets.tolist()
            for R in turns
            for body, score in (self._assigned(self._costs(offset, rate, R, None)),)
        ]
        fits: dict[tuple[int, ...], _Fit] = {}
        for _, offset, R, body in sorted(found, key=lambda each: each[0])[:CLOSER]:
            clocks = np.full(len(k), offset)
            fit = self._fitted(_Fit(clocks, rate, R, np.zeros(3), body, "fit", np.inf))
            if fit.score < fits.get(tuple(body), replace(fit, score=np.inf)).score:
                fits[tuple(body)] = fit
        best, *others = sorted(fits.values(), key=lambda fit: fit.score)
        yield replace(best, rival=others[0].score / best.score if others else np.inf)

    def _costs(self, offset: float, rate: float, R: Array, p: Array | None) -> Array:
        """Return mean squared distances of bodies and drones (m, 2n); p None: of centred ones.

        What was not recorded of the plan counts as UNSEEN.
        """
        tau = offset + rate * self._t
        rows = np.flatnonzero((tau >= 0.0) & (tau <= self._task.duration))
        share = min(1.0, len(rows) * STEP * rate / self._task.duration)
        rows = rows[:: max(1, len(rows) // COMPARED)]
        if not len(rows):
            return np.full(self._allowed.shape, HUGE)
        x = self._through[rows] @ R.T
        plan = self._planned(np.repeat(tau[rows, None], self._task.team.drones, axis=1))
        x += np.mean(plan, axis=(0, 1)) - np.mean(x, axis=(0, 1)) if p is None else p
        squares = np.sum((x[:, :, None] - plan[:, None]) ** 2, axis=-1)
        return np.asarray(share * np.mean(squares, axis=0) + (1.0 - share) * UNSEEN**2)

    def _assigned(self, costs: Array) -> tuple[Indices, float]:
        """Return the body of every drone with the least mean cost, of costs (m, 2n)."""
        b, i = linear_sum_assignment(np.where(self._allowed, costs, HUGE))
        return b[np.argsort(i)], float(np.mean(costs[b, i]))

    def _apart(self, fit: _Fit) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return offsets of drones from the plan (times, 2n, 3) [m], which count, and the plan."""
        tau = fit.rate * self._t[:, None] + fit.offsets
        plan = self._planned(tau)
        apart = self._x[:, fit.body] @ fit.rotation.T + fit.shift - plan
        use = (tau >= 0.0) & (tau <= self._task.duration) & np.isfinite(apart[..., 0])
        return apart, use, plan

    def _fitted(self, fit: _Fit) -> _Fit:
        """Return a fit with its score, and with a better frame if that is fitted."""
        apart, use, plan = self._apart(fit)
        if fit.frame == "fit" and np.any(use):
            up = min((R for R, _ in UP.values()), key=lambda R: -R[2] @ fit.rotation[2])
            R, p = _fitted_frame(self._x[:, fit.body][use], plan[use], up)
            fit = replace(fit, rotation=R, shift=p)
            apart, use, _ = self._apart(fit)
        total = max(self._task.duration / (STEP * fit.rate) * use.shape[1], np.sum(use))
        squares = np.sum(apart[use] ** 2) + (total - np.sum(use)) * UNSEEN**2
        return replace(fit, score=float(squares / total))

    def best(self, fits: Sequence[_Fit], start: float | None) -> _Fit:
        """Return the best fit with better clocks; at a rate of 1 unless another gains clearly."""
        nearest = {
            rate: min((fit for fit in fits if fit.rate == rate), key=lambda fit: fit.score)
            for rate in sorted({fit.rate for fit in fits})
        }
        if start is not None:
            begun = self._origins[nearest[1.0].body] - start
            return self._fitted(replace(nearest[1.0], offsets=begun))
        some = nearest.values()
        found = [self._clocked(self._clocked(fit, with_rate=False)) for fit in some]
        if self._flight.one_clock:
            found += [
                self._clocked(self._clocked(fit, with_rate=True), with_rate=True) for fit in some
            ]
        best, plain = min(found, key=lambda fit: fit.cost), found[0]
        clearly = best.cost < GAIN * plain.cost and abs(best.rate - 1.0) > LEAST_RATE
        clearly |= not self._flight.one_clock
        return best if clearly else plain

    def _clocked(self, fit: _Fit, *, with_rate: bool = False) -> _Fit:
        """Return a fit with better clocks, their cost and standard errors, and a better frame."""
        clocks = 1 if self._flight.one_clock else len(fit.body)
        scale = np.append(np.full(clocks, OFFSET), [RATE] * with_rate)

        def at(unknown: Array) -> _Fit:
            change = scale * (unknown - 1.0)  # Differences are taken relative to unknowns
            rate = fit.rate + float(np.sum(change[clocks:]))
            return replace(fit, offsets=fit.offsets + change[:clocks], rate=rate)

        seen = self._apart(fit)[1][..., None]

        def residuals(unknown: Array) -> Array:
            apart = self._apart(at(unknown))[0]
            return np.where(seen, apart - _median(np.where(seen, apart, np.nan)), 0.0).ravel()

        robust: Any = {"loss": "soft_l1", "f_scale": ROBUST, "diff_step": 1e-2}
        found: Any = least_squares(residuals, np.ones(len(scale)), **robust)
        J = found.jac.reshape(len(self._t), -1, 3, len(scale))
        gradients = np.einsum("tixk,tix->ik", J, found.fun.reshape(J.shape[:3]))
        inverse = np.linalg.pinv(found.jac.T @ found.jac)
        spread = scale**2 * np.diag(inverse @ gradients.T @ gradients @ inverse)
        errors = np.sqrt([np.mean(spread[:clocks]), *spread[clocks:], np.nan][:2])
        cost = float(found.cost / max(1, np.count_nonzero(seen)))
        return self._fitted(replace(at(found.x), errors=errors, cost=cost))

    def judged(self, fit: _Fit, *, timed: bool) -> Alignment:
        """Return the alignment of the best fit, unless it has to be refused."""
        apart, use, _ = self._apart(fit)
        distance = (
            float(np.sqrt(np.mean(np.sum(apart[use] ** 2, axis=-1)))) if use.any() else np.inf
        )
        seen = float(np.max(np.sum(use, axis=0)) * STEP * fit.rate)
        nearest, needed = FARTHEST, LEAST_TIME
        if fit.frame == "fit":
            nearest, needed = FITTED, max(0.5 * self._task.duration, LEAST_TIME)
        needed = min(needed, self._task.duration)
        if distance > nearest or seen < needed - STEP:
            where = f"{distance:.2f} m from the plan (root mean square) for {seen:.1f} s of it"
            raise self.error(
                f"its drones are {where if np.any(use) else 'nowhere near the plan'}; its own are "
                f"within {nearest:g} m for at least {needed:.1f} s: name the plan that was flown, "
                "or record more of it"
            )
        if fit.rival < ALIKE**2:
            raise self.error("two assignments of names fit alike: give --names, or --frame plan")
        fitted = {
            "clock": not timed,
            "rate": fit.rate != 1.0,
            "frame": fit.frame == "fit",
            "names": np.any(np.sum(self._allowed, axis=0) > 1),
        }
        offsets = fit.offsets - fit.rate * self._origins[fit.body]
        names = tuple(self._bodies[b] for b in fit.body)
        said = tuple(name for name, really in fitted.items() if really)
        clock, drift = fit.errors.tolist()
        frame = fit.rotation, fit.shift, names, distance, said, fit.frame
        return Alignment(offsets, fit.rate, clock, drift, *frame)


def _median(values: Array) -> Array:
    """Return medians over the first axis of what is finite; zero where nothing is."""
    none = ~np.any(np.isfinite(values), axis=0)
    return np.asarray(np.nanmedian(np.where(none, 0.0, values), axis=0))


def _turn(yaw: float) -> Array:
    """Return the rotation (3, 3) about the vertical by an angle [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _fitted_frame(x: Array, plan: Array, up: Array) -> Frame:
    """Return the frame that brings points (k, 3) [m] next to the plan's, after the rotation up.

    Yaw and level shift are fitted, and heights where they differ by more than LIFTED.
    """
    a = x @ up.T
    (u, v), (s, w) = ((y - np.mean(y, axis=0))[:, :2].T for y in (a, plan))
    turn = _turn(float(np.arctan2(np.sum(u * w - v * s), np.sum(u * s + v * w))))
    shift = np.mean(plan, axis=0) - turn @ np.mean(a, axis=0)
    shift[2] = shift[2] if abs(shift[2]) > LIFTED else 0.0
    return turn @ up, shift
