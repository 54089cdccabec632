"""Calibration of single drones from hovers: trims, tilts, thrust factors, lags and tracking errors.

A drone whose rigid body is defined tilted by an angle interprets level flight as a tilt. Its
position loop, without an integral, then settles where its force cancels that of the tilt: at a
distance from the setpoint of ``m g/kp`` times the tangent of the angle. So the trim, setpoint minus
rest position, is ``m g/kp`` times the horizontal part of the body's z axis over its vertical part,
and turns with yaw. Position-only commands trail by the speed times ``kd/kp``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain, combinations_with_replacement
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.lab.flights.readers import read_flight
from hitchopt.lab.flights.recordings import RecordedFlight, Signal, drones_by_name, interpolated
from hitchopt.storage.files import with_nulls
from hitchopt.storage.yaml_file import flow
from hitchopt.values import Array, positive, true_runs
from hitchopt.values import path as checked_path
from hitchopt.values.fields import suggest_keywords

RATE = 50.0  # Rate of the samples that are compared [Hz]
SPEED_TIME = 1.0  # Time over which speeds are means [s]
MAX_LEVEL_SPEED = 0.08  # Maximum horizontal speed of a drone at rest [m/s]
MAX_CLIMB = 0.06  # Maximum vertical speed of a drone at rest [m/s]
MAX_COMMAND_SPEED = 0.02  # Largest speed of setpoints at rest [m/s]
TRANSIENT = 2.5  # After a movement, until the drone is settled [s]
MAX_BREAK = 1.0  # Longest movement within a settled part [s]
MIN_SETTLED = 1.0  # Settled time that is needed [s]
ENOUGH = 10.0  # Settled time that is enough [s]
MIN_RISE = 0.15  # Smallest height of flight [m]
STILL = 0.01  # Largest motion on the ground [m]
MIN_GROUND = 0.3  # Shortest time on the ground [s]

WANDER = 0.01  # Smallest standard deviation of the horizontal wander about the rest position [m]
REPEATABILITY = 0.01  # Smallest standard deviation of trims from flight to flight [m]
MIN_CORRELATION = 1.0  # Shortest correlation time of the wander [s]
MOTION_ERROR = 0.03  # Least error of a trim from motion: drag and tilt of the way are omitted [m]
MAX_RATIO = 3.0  # Largest difference of trims over its standard error
# Relative error of a trim that is expected from a tilt: drones with cables scatter by a quarter
MODEL_ERROR = 0.25
LEVEL = 1.5  # Largest tilt that needs no word [deg]
NEAR = 0.03  # Largest trim that needs no word [m]
TURNED = 45.0  # Change of yaw that distinguishes trims of bodies from those of the world [deg]
MAX_LAG = 4.0  # Longest lag that is tried [s]
LAG_STEP = 0.02  # Step of lags that are tried [s]
MIN_MOVING = 2.0  # Shortest duration of a movement that determines a lag [s]
MIN_PATH = 0.3  # Shortest path of a movement that determines a lag [m]
COMMANDED = "commanded"  # Source of a setpoint: a recorded command
ABOVE_START = "above the take-off position"  # Source of a setpoint without recorded commands
IN_MOTION = "commanded, in motion"
DIRECTIONS = ("+x", "+x +y", "+y", "-x +y", "-x", "-x -y", "-y", "+x -y")


@dataclass(frozen=True)
class DroneHover(OneLine):
    """Findings about one drone in hovers; nan where they are not determined.

    Attributes
    ----------
    name: in the recording, or of the team.
    trim: horizontal setpoint minus rest position, in the body's frame at yaw 0 [m].
    trim_error: standard error of both [m].
    setpoint: its source: ``commanded``, ``above the take-off position``, or ``commanded, in
        motion``, where the trim is fitted to the position loop's response.
    settled: time at rest [s].
    tilt: horizontal part of the body's z axis over its vertical part, in the same frame.
    tilt_deg: angle of the body's z axis from vertical [deg].
    expected_trim: by the tilt and ``lever``, m g/kp of the gains or of all drones' tilts [m].
    lever: trim per tangent of the tilt that is expected [m].
    fixed_to: ``body``, ``world``, or empty if undetermined.
    spread: standard deviation of the horizontal position at rest [m].
    thrust_factor: commanded thrust over weight, and its standard error.
    lag, expected_lag: of moving commands, measured, and kd/kp if known and positions only [s].
    tracking: largest distances from the setpoint plus trim, horizontal and vertical [m].
    remarks: reasons why values are not determined.
    """

    name: str
    trim: tuple[float, float] = (math.nan, math.nan)
    trim_error: float = math.nan
    setpoint: str = ""
    settled: float = 0.0
    tilt: tuple[float, float] = (math.nan, math.nan)
    tilt_deg: float = math.nan
    expected_trim: tuple[float, float] = (math.nan, math.nan)
    lever: float = math.nan
    fixed_to: str = ""
    spread: float = math.nan
    yaw_deg: float = math.nan
    thrust_factor: float = math.nan
    thrust_factor_error: float = math.nan
    lag: float = math.nan
    lag_error: float = math.nan
    expected_lag: float = math.nan
    tracking: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def agrees(self) -> bool | None:
        """Return whether the tilt explains the trim; None if one of them, or m g/kp, is unknown."""
        off = math.dist(self.trim, self.expected_trim)
        size = MODEL_ERROR * math.hypot(*self.expected_trim)
        return None if math.isnan(off) else off <= MAX_RATIO * math.hypot(self.trim_error, size)

    def to_dict(self) -> dict[str, Any]:
        """Return all findings as plain data, with None for what is not determined."""
        content = {**asdict(self), "agrees": self.agrees, "sentence": self.sentence}
        return {name: with_nulls(value) for name, value in content.items()}

    @property
    def sentence(self) -> str:
        """The findings and their remedy in one sentence."""
        if math.isnan(self.trim[0]):
            reasons = "; ".join(self.remarks) or "nothing is determined"
            return f"{self.name}: {reasons}{self._lag_words}"
        return f"{self.name} {self._trim_words}{self._lag_words}{self._settled_words}"

    @property
    def _trim_words(self) -> str:
        """Tilt and trim, and what to do about them."""
        off = math.hypot(*self.trim)
        toward = direction_of(-self.trim[0], -self.trim[1])
        error = 100.0 * self.trim_error
        beside = f"{100.0 * off:.0f} cm from its setpoint, toward {toward} (± {error:.1g} cm)"
        if math.isnan(self.tilt_deg):
            return f"hovers {beside}; its tilt is not recorded"
        if self.tilt_deg < LEVEL and off < max(NEAR, 2.0 * self.trim_error):
            return f"is level at rest and hovers within {100.0 * off:.1f} cm of its setpoint"
        tilted = f"is tilted by {self.tilt_deg:.1f}° at rest"
        if self.agrees is not False:
            return f"{tilted}: redefine its rigid body; until then it hovers {beside}"
        by_tilt = 100.0 * math.hypot(*self.expected_trim)
        toward = direction_of(-self.expected_trim[0], -self.expected_trim[1])
        return (
            f"{tilted}, which explains {by_tilt:.0f} cm toward {toward}, but hovers {beside}: "
            "its tilt does not explain the trim: look for a bent arm, wind or a pull"
        )

    @property
    def _settled_words(self) -> str:
        """What to do about a hover that is too short."""
        if self.settled >= ENOUGH:
            return ""
        only = f"only {self.settled:.1f} s were settled" if self.settled else "never settled"
        return f"; {only}: hover for {ENOUGH:g} s"

    @property
    def _lag_words(self) -> str:
        if math.isnan(self.lag):
            return ""
        text = f"; it follows commands {self.lag:.2f} s late (± {self.lag_error:.1g})"
        known = not math.isnan(self.expected_lag)
        return f"{text}; its gains predict {self.expected_lag:.2f} s" if known else text


@dataclass(frozen=True, eq=False)
class HoverCalibration(OneLine):
    """Calibration of single drones from hovers, by their names."""

    drones: Mapping[str, DroneHover]
    notes: tuple[str, ...] = ()

    @property
    def quadrotor(self) -> dict[str, dict[str, Any]]:
        """The values of ``team.quadrotor`` by drone, without trims that the tilt contradicts."""
        kinds = dict[str, dict[str, Any]]()
        for name, drone in self.drones.items():
            kind = kinds[name] = {}
            is_explained = drone.agrees is not False and drone.fixed_to != "world"
            if is_explained and not math.isnan(drone.trim[0]):
                kind["trim"] = [round(x, 4) + 0.0 for x in drone.trim]
            if not math.isnan(drone.thrust_factor):
                kind["thrust_factor"] = round(drone.thrust_factor, 4)
            if drone.tracking:
                kind["tracking"] = {
                    axis: max(math.ceil(100.0 * size) / 100.0, 0.01)
                    for axis, size in drone.tracking.items()
                }
        return kinds

    @property
    def text(self) -> str:
        """The block ``quadrotor:`` in YAML, with each drone's sentence as a comment."""
        kinds = self.quadrotor.items()
        lines = [f"  # {self.drones[n].sentence}\n  {flow({n: kind})[1:-1]}" for n, kind in kinds]
        return "\n".join(["quadrotor:", *lines, ""])

    def save(self, path: Path | str) -> None:
        """Write ``text`` to a file."""
        checked_path("path", path).write_text(self.text, encoding="utf-8")


def direction_of(x: float, y: float) -> str:
    """Return the nearest of eight horizontal directions in words."""
    return DIRECTIONS[round(4.0 * math.atan2(y, x) / math.pi) % 8]


@suggest_keywords
def calibrate_hover(
    recordings: RecordedFlight | Path | str | Sequence[RecordedFlight | Path | str],
    *,
    mass: float | None = None,
    kp: float | None = None,
    kd: float | None = None,
    names: Mapping[str, str] | str | None = None,
) -> HoverCalibration:
    """Estimate trims, tilts, thrust factors and lags of drones from hovers, without a plan.

    A drone is at rest while it flies, and neither it nor its setpoint moves; the first seconds
    after each movement are omitted. Without commands the setpoint is above the take-off position.

    Parameters
    ----------
    recordings: one hover or several, files or directories in a format of ``read_flight``.
    mass: of every drone [kg], for thrust factors and expected trims; None: unknown.
    kp, kd: horizontal gains of the position loop [N/m], [N s/m]; None: unknown.
    names: names of the team by those of the recordings, such as ``cf2=q0,cf7=r0``.

    Raises
    ------
    FileError: a recording that cannot be read, or in which no drone flies at rest.
    InputError: an argument out of its range, or trims of a drone that differ between hovers by
        more than their errors.
    """
    gains = {"mass": mass, "kp": kp, "kd": kd}
    known = {key: positive(key, value) for key, value in gains.items() if value is not None}
    one = isinstance(recordings, RecordedFlight | Path | str)
    sources: Sequence[Any] = [recordings] if one else list(recordings)  # type: ignore[arg-type]
    if not sources:
        raise InputError("recordings", (), "a hover or several", "name the files")
    flights = [
        each if isinstance(each, RecordedFlight) else read_flight(checked_path("recordings", each))
        for each in sources
    ]
    names = drones_by_name(names)
    labels = [each.source if isinstance(each, RecordedFlight) else str(each) for each in sources]
    drones = dict[str, DroneHover]()
    recorded_names = dict.fromkeys(chain.from_iterable(flight.tracks for flight in flights))
    for name in recorded_names:
        series = [
            HoverSeries(flight, name, label)
            for label, flight in zip(labels, flights, strict=True)
            if name in flight.tracks
        ]
        drones[name] = _drone(name, series, known)
    if all(math.isnan(drone.trim[0]) and math.isnan(drone.lag) for drone in drones.values()):
        remarks = chain.from_iterable(drone.remarks for drone in drones.values())
        reasons = "; ".join(dict.fromkeys(remarks))
        problem = f"no drone of {', '.join(drones)} is at rest in flight: {reasons}"
        raise FileError(f"{', '.join(labels)}: {problem}; flights of a plan need plan=")
    drones = _with_expected_trims(drones, known)
    if names is not None:
        if unknown := sorted(set(names) - set(drones)):
            bound = f"of {', '.join(drones)}"
            raise InputError("names", ", ".join(unknown), bound, "use names of the recording")
        drones = {
            names[name]: replace(drone, name=names[name])
            for name, drone in drones.items()
            if name in names
        }
    notes = tuple(dict.fromkeys(note for flight in flights for note in flight.notes))
    return HoverCalibration(drones, notes)


@dataclass(frozen=True, eq=False)
class _Rest:
    """A settled part of a hover, or a part in motion whose trim is fitted.

    Attributes
    ----------
    hover: the drone's hover.
    source: where the setpoint is known from, as in ``DroneHover.setpoint``.
    mask: (times,), the part's samples.
    world, body: trims (2,) in the world, and in the body's frame at yaw 0 [m].
    yaw: mean yaw [rad].
    error: standard error of the trims [m].
    """

    hover: HoverSeries
    source: str
    mask: NDArray[np.bool_]
    world: Array
    body: Array
    yaw: float
    error: float

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(np.sum(self.mask))

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.samples / RATE

    @property
    def in_motion(self) -> bool:
        return self.source == IN_MOTION

    @property
    def spread(self) -> float:
        """Standard deviation of the horizontal position [m]."""
        places = self.hover.x[self.mask, :2]
        return float(np.sqrt(np.sum(np.var(places, axis=0))))

    @property
    def tilt(self) -> Array:
        """Mean tilt (2,) in the body's frame at yaw 0; nan if it is not known."""
        return self.hover.tilt(self)

    def trim(self, frame: str) -> Array:
        """Return the trim (2,) in a frame, ``body`` or ``world`` [m]."""
        return self.body if frame == "body" else self.world


class HoverSeries:
    """A drone in a recording, sampled at RATE.

    Attributes
    ----------
    t: (times,) [s].
    x, velocity: (times, 3) [m], [m/s].
    commanded, commanded_velocity: of setpoints (times, 3) [m], [m/s]; nan if none are recorded.
    began, ended: times of the first and the last setpoint [s]; infinite if none are recorded.
    """

    def __init__(self, flight: RecordedFlight, name: str, label: str = "") -> None:
        self.label = label  # Name of the recording in messages
        track = flight.tracks[name]
        own = flight.signals.get(name, {})
        self.t = np.arange(track.t[0], track.t[-1], 1.0 / RATE)
        self.x, self.visible = track.at(self.t)
        self.thrust = own.get("thrust")
        parts = ("velocity", "acceleration")
        self.moving = {x: own[f"commanded_{x}"] for x in parts if f"commanded_{x}" in own}
        attitude = own.get("attitude") or own.get("estimated_attitude")
        self.estimated = "attitude" not in own
        self.axis, self.yaw = self._attitude(attitude)
        self.ground = self._ground()
        self.velocity = _velocity(self.t, self.x)
        lowest = self.ground[2] if self.ground is not None else np.min(self.x[:, 2])
        z = self.x[:, 2]
        top = float(np.max(self.x[:, 2]))
        self.flying = z > lowest + max(MIN_RISE, 0.5 * (top - lowest))
        if self.ground is None and top - lowest < MIN_RISE:  # Recorded in flight
            self.flying[:] = True
        self.commanded = np.full_like(self.x, np.nan)
        sent = np.zeros(len(z), np.bool_)
        self.began = math.inf
        self.ended = -math.inf
        if (commands := flight.setpoints.get(name)) is not None:
            self.commanded, sent = commands.at(self.t)
            self.began, self.ended = commands.t[[0, -1]].tolist()
        self.commanded_velocity = _velocity(self.t, self.commanded)
        before = self.t < self.began
        self.setpoint = np.where(sent[:, None], self.commanded, np.nan)
        self.source = np.where(sent, COMMANDED, "").astype(object)  # Of setpoints
        if self.ground is not None:
            self.setpoint[before] = [*self.ground[:2], np.nan]
            self.source[before] = ABOVE_START
        moving = np.flatnonzero(sent & (length(self.commanded_velocity) > MAX_COMMAND_SPEED))
        self.still = (_since(self.t, self.t[moving]) > TRANSIENT) & (before | sent)

    def _attitude(self, attitude: Signal | None) -> tuple[Array, Array]:
        """Return the body's z axis (times, 3) and yaw (times,) [rad]; nan and 0 if unknown."""
        if attitude is None:
            return np.full((len(self.t), 3), np.nan), np.zeros(len(self.t))
        i = np.clip(np.searchsorted(attitude.t, self.t), 0, len(attitude.t) - 1)
        turned = Rotation.from_quat(attitude.values[i])
        axis = turned.as_matrix()[..., 2]
        axis[(self.t < attitude.t[0]) | (self.t > attitude.t[-1])] = np.nan
        return axis, turned.as_euler("ZYX")[:, 0]

    def _ground(self) -> Array | None:
        """Return the position (3,) [m] before take-off; None if the recording begins in flight."""
        moved = length(self.x - self.x[0]) > STILL
        end = int(np.argmax(moved)) if np.any(moved) else len(moved)
        rises = float(np.max(self.x[:, 2]) - self.x[0, 2]) > MIN_RISE
        if end < MIN_GROUND * RATE or not rises:
            return None
        return np.asarray(np.median(self.x[:end], axis=0))

    def rests(self) -> Iterator[_Rest]:
        """Yield the settled parts with a known setpoint."""
        level = length(self.velocity[:, :2])
        climb = np.abs(self.velocity[:, 2])
        slow = (level < MAX_LEVEL_SPEED) & (climb < MAX_CLIMB) & self.flying & self.visible
        slow = _bridged(slow, MAX_BREAK) & self.flying & self.still
        for kind in (COMMANDED, ABOVE_START):
            for start, end in true_runs(slow & (self.source == kind)):
                first = start + int(min(TRANSIENT * RATE, 0.5 * (end - start)))
                mask = np.zeros(len(self.t), np.bool_)
                mask[first:end] = True
                if np.sum(mask) < 0.5 * MIN_SETTLED * RATE:
                    continue
                off = (self.setpoint - self.x)[mask, :2]
                world, body = np.mean([off, _turned(off, -self.yaw[mask])], axis=1)
                error = mean_error(off, np.sum(mask) / RATE)
                yield _Rest(self, kind, mask, world, body, self._mean_yaw(mask), error)

    def _mean_yaw(self, mask: NDArray[np.bool_]) -> float:
        return float(np.angle(np.mean(np.exp(1j * self.yaw[mask]))))

    def moving_part(self, gains: Mapping[str, float]) -> slice | None:
        """Return the samples of the longest flight under moving commands; None without gains."""
        if not {"mass", "kp", "kd"} <= set(gains):
            return None
        mask = (self.t >= self.began) & (self.t <= self.ended) & self.flying & self.visible
        start, end = max(true_runs(mask), key=lambda run: run[1] - run[0], default=(0, 0))
        speed = length(self.commanded_velocity[start:end, :2])
        is_moving = np.sum(speed > MAX_COMMAND_SPEED) >= MIN_MOVING * RATE
        return slice(start, end) if is_moving else None

    def predicted(self, part: slice, trim: Array, gains: Mapping[str, float]) -> Array:
        """Return the positions (times, 2) [m] of the position loop with a trim (2,) [m].

        They follow from ``kp (command - trim - position) + kd (commanded velocity - velocity)``,
        plus the mass times commanded accelerations.
        """
        mass, kp, kd = gains["mass"], gains["kp"], gains["kd"]
        force = kp * (self.commanded[part, :2] - _turned(trim, self.yaw[part]))
        for quantity, gain in (("velocity", kd), ("acceleration", mass)):
            if quantity in self.moving:
                force = force + gain * self.moving[quantity].at(self.t[part])[:, :2]
        first = np.concatenate([self.x[part.start, :2], self.velocity[part.start, :2]])
        return loop_response(force, first, mass, kp, kd)

    def response(self, gains: Mapping[str, float]) -> Iterator[_Rest]:
        """Yield the trim that fits the response of the position loop to moving commands."""
        part = self.moving_part(gains)
        if part is None:
            return
        x = self.x[part, :2]
        trims = (np.zeros(2), *np.eye(2))
        base, *shifted = (self.predicted(part, trim, gains) for trim in trims)
        effects = np.stack([(each - base).ravel() for each in shifted], axis=1)  # They add up
        body: Array = np.linalg.lstsq(effects, (x - base).ravel(), rcond=None)[0].astype(np.float64)
        residual = x - self.predicted(part, body, gains)
        mask = np.zeros(len(self.t), np.bool_)
        mask[part] = True
        error = math.hypot(mean_error(residual, len(residual) / RATE), MOTION_ERROR)
        yaw = self._mean_yaw(mask)
        yield _Rest(self, IN_MOTION, mask, _turned(body, yaw), body, yaw, error)

    def tilt(self, rest: _Rest) -> Array:
        """Return the mean tilt (2,) in the body's frame at yaw 0; nan if it is not known.

        Of a drone in motion it is the tilt while it is slow.
        """
        mask = rest.mask
        if rest.source == IN_MOTION:
            slow = length(self.velocity[:, :2]) < MAX_LEVEL_SPEED
            mask = slow & self.flying & self.visible & (self.source != COMMANDED)
        axis = self.axis[mask]
        tilts = _turned(axis[:, :2], -self.yaw[mask]) / np.abs(axis[:, 2:])
        tilts = tilts[np.isfinite(tilts).all(axis=1)]
        unknown: Array = np.full(2, np.nan)
        return np.mean(tilts, axis=0) if len(tilts) else unknown

    def lag(self, trim: Array | None) -> tuple[float, float]:
        """Return the lag of the drone behind moving commands, and its standard error [s].

        It is the time constant of a first-order lag, kd/kp of a slow loop. An unknown trim is
        fitted.
        """
        speed = length(self.commanded_velocity[:, :2])
        moving = (self.t > self.began + TRANSIENT) & (self.t <= self.ended)
        moving &= self.flying & self.visible & (speed > MAX_COMMAND_SPEED)
        path = float(np.sum(speed[moving])) / RATE
        if np.sum(moving) < MIN_MOVING * RATE or path < MIN_PATH:
            return math.nan, math.nan
        start, end = max(true_runs(moving), key=lambda run: run[1] - run[0])
        place, command = self.x[start:end, :2], self.commanded[start:end, :2]
        place = place if trim is None else place + _turned(trim, self.yaw[start:end])
        lags = np.arange(LAG_STEP, MAX_LAG, LAG_STEP)
        off = np.empty((len(lags), *place.shape))
        for i, lag in enumerate(lags.tolist()):  # Of first order
            decay = math.exp(-1.0 / (RATE * lag))
            initial = decay * place[:1]
            numbers = ([1.0 - decay], [1.0, -decay])
            off[i] = place - lfilter(*numbers, command, axis=0, zi=initial)[0]
        if trim is None:
            off -= np.mean(off, axis=1, keepdims=True)
        squares = np.mean(np.sum(off**2, axis=2), axis=1)
        best = int(np.argmin(squares))
        count = max(float(np.sum(moving)) / RATE / TRANSIENT, 1.0)
        speed_range = float(np.mean(speed[moving]))
        if trim is None:  # Only changes of the velocity tell a lag from a trim
            speed_range = float(np.mean(np.std(self.velocity[moving, :2], axis=0)))
        resolution = math.sqrt(squares[best]) + 0.5 * WANDER
        error = resolution / max(speed_range, 1e-6) / math.sqrt(count)
        return float(lags[best]), error

    def tracking(self, trim: Array, rests: Sequence[_Rest]) -> dict[str, float]:
        """Return the largest distances from setpoints plus trim while these are known [m]."""
        used: NDArray[np.bool_] = np.any([rest.mask for rest in rests], axis=0)
        sent = (self.source == COMMANDED) & self.flying & self.visible
        used |= sent & (self.t > self.began + TRANSIENT)
        off = self.setpoint - self.x
        off[:, :2] -= _turned(trim, self.yaw)
        heights = off[used, 2]
        if not np.isfinite(heights).any():  # Above the take-off position, at unknown height
            heights = self.x[used, 2] - np.median(self.x[used, 2])
        level = length(off[used, :2])
        return {"level": float(np.nanmax(level)), "height": float(np.nanmax(np.abs(heights)))}


def _drone(name: str, hovers: Sequence[HoverSeries], known: Mapping[str, float]) -> DroneHover:
    """Return the findings about a drone, without the trims expected from all drones' tilts.

    Raises InputError for trims that differ by more than their errors.
    """
    parts = [part for hover in hovers for part in (*hover.rests(), *hover.response(known))]
    if not parts:
        return _restless_drone(name, hovers)
    frame, fixed_to = _frame_of_trims(name, parts)
    trim, trim_error = _mean_trim(parts, frame)
    settled = [part for part in parts if not part.in_motion]
    shown = settled or parts  # Parts that show the drone's tilt and yaw
    tilt = _mean_tilt(shown)
    longest = max(shown, key=lambda part: part.samples)
    used = [hover for hover in hovers if any(part.hover is hover for part in parts)]
    thrust_factor, thrust_error = _thrust_factor(settled, known.get("mass"))
    lag, lag_error = _best_lag(used, trim)
    return DroneHover(
        name,
        (float(trim[0]), float(trim[1])),
        trim_error,
        longest.source,
        sum(part.seconds for part in settled),
        (float(tilt[0]), float(tilt[1])),
        math.degrees(math.atan(math.hypot(*tilt))),
        fixed_to=fixed_to,
        spread=max((part.spread for part in settled), default=math.nan),
        yaw_deg=math.degrees(longest.yaw),
        thrust_factor=thrust_factor,
        thrust_factor_error=thrust_error,
        lag=lag,
        lag_error=lag_error,
        expected_lag=_expected_lag(used, known),
        tracking=_largest_tracking(used, parts, trim),
        remarks=tuple(_remarks(used, tilt, thrust_factor)),
    )


def _restless_drone(name: str, hovers: Sequence[HoverSeries]) -> DroneHover:
    """Return a drone that is never at rest in flight with a known setpoint; it may have a lag."""
    if not any(hover.flying.any() for hover in hovers):
        reason, remedy = "it does not fly", "hover for ten seconds"
    elif any(np.isfinite(hover.setpoint[:, 0]).any() for hover in hovers):
        reason, remedy = "it is never at rest in flight", "hover for ten seconds"
    else:
        reason, remedy = "its setpoint is unknown", "record commands, or record from the ground"
    lags = [hover.lag(None) for hover in hovers]
    lag, error = next((each for each in lags if not math.isnan(each[0])), lags[0])
    return DroneHover(name, lag=lag, lag_error=error, remarks=(f"{reason}; {remedy}",))


def _frame_of_trims(name: str, parts: Sequence[_Rest]) -> tuple[str, str]:
    """Return the frame in which trims agree best, and the same if turns of the drone show it.

    Raises InputError if trims differ in this frame by more than their errors.
    """
    pairs = list(combinations_with_replacement(parts, 2))
    farthest = {
        frame: max(pairs, key=lambda pair: _ratio(*pair, frame=frame))
        for frame in ("body", "world")
    }
    yaws = np.degrees(np.unwrap([part.yaw for part in parts]))
    has_turned = np.ptp(yaws) > TURNED
    frame = "body"
    if has_turned:
        frame = min(farthest, key=lambda frame: _ratio(*farthest[frame], frame=frame))
    first, second = farthest[frame]
    if _ratio(first, second, frame=frame) > MAX_RATIO:
        raise _changed_trim(name, frame, first, second)
    return frame, frame if has_turned else ""


def _ratio(first: _Rest, second: _Rest, *, frame: str) -> float:
    """Return the distance of two trims over its standard error."""
    error = math.hypot(first.error, second.error, math.sqrt(2.0) * REPEATABILITY)
    return float(math.dist(first.trim(frame), second.trim(frame))) / error


def _changed_trim(name: str, frame: str, *parts: _Rest) -> InputError:
    """Return the error for two trims in a frame that differ by more than their errors."""
    places = list[str]()
    for part in parts:
        x, y = (100.0 * part.trim(frame)).tolist()
        places.append(f"[{x:.1f}, {y:.1f}] cm in {part.hover.label}")
    errors = " and ".join(f"{100.0 * part.error:.1f}" for part in parts)
    bound = f"equal within {MAX_RATIO:g} standard errors, of {errors} cm"
    remedy = "it was bent or its rigid body redefined between them: calibrate the last hover"
    return InputError(f"trim of {name}", f"{places[0]}, but {places[1]}", bound, remedy)


def _mean_trim(parts: Sequence[_Rest], frame: str) -> tuple[Array, float]:
    """Return the mean trim (2,) in a frame, weighed by errors, and its standard error [m]."""
    trims = np.stack([part.trim(frame) for part in parts])
    weights = np.array([1.0 / part.error**2 for part in parts])
    mean = weights @ trims / np.sum(weights)
    return mean, math.hypot(1.0 / math.sqrt(float(np.sum(weights))), REPEATABILITY)


def _mean_tilt(parts: Sequence[_Rest]) -> Array:
    """Return the mean tilt (2,) over the time in which it is known; nan if it never is."""
    tilts = np.stack([part.tilt for part in parts])
    is_known = np.isfinite(tilts[:, 0])
    if not np.any(is_known):
        return np.full(2, np.nan)
    samples = np.array([part.samples for part in parts], np.float64)
    return np.asarray(np.average(tilts[is_known], axis=0, weights=samples[is_known]))


def _best_lag(hovers: Sequence[HoverSeries], trim: Array) -> tuple[float, float]:
    """Return the lag with the smallest standard error, and that error [s]; nan if there is none."""
    lags = [hover.lag(trim) for hover in hovers]
    known = [(lag, error) for lag, error in lags if not math.isnan(lag)]
    return min(known, key=itemgetter(1), default=(math.nan, math.nan))


def _expected_lag(hovers: Sequence[HoverSeries], known: Mapping[str, float]) -> float:
    """Return the lag by the gains [s]: 0 where velocities are commanded too; nan without gains."""
    if not {"kp", "kd"} <= set(known):
        return math.nan
    return 0.0 if any(hover.moving for hover in hovers) else known["kd"] / known["kp"]


def _largest_tracking(
    hovers: Sequence[HoverSeries], parts: Sequence[_Rest], trim: Array
) -> dict[str, float]:
    """Return the largest distances from setpoints plus trim, horizontal and vertical [m]."""
    tubes = [
        hover.tracking(trim, [part for part in parts if part.hover is hover]) for hover in hovers
    ]
    return {axis: max(tube[axis] for tube in tubes) for axis in ("level", "height")}


def _remarks(hovers: Sequence[HoverSeries], tilt: Array, thrust_factor: float) -> Iterator[str]:
    """Yield what is not determined, or estimated by the drone."""
    if any(hover.estimated for hover in hovers) and not np.isnan(tilt[0]):
        yield "the tilt is the one that the drone estimates"
    if all(np.isnan(hover.axis).all() for hover in hovers):
        yield "no attitude is recorded: yaw is taken as 0"
    if math.isnan(thrust_factor) and any(hover.thrust is not None for hover in hovers):
        yield "thrust factors need mass="


def _thrust_factor(parts: Sequence[_Rest], mass: float | None) -> tuple[float, float]:
    """Return the commanded thrust at rest over the weight, and its standard error."""
    thrusts = list[Array]()
    times = 0.0
    for rest in parts:
        if (thrust := rest.hover.thrust) is not None:
            t = rest.hover.t[rest.mask]
            inside = (t >= thrust.t[0]) & (t <= thrust.t[-1])
            thrusts.append(thrust.at(t[inside]))
            times += float(np.sum(inside)) / RATE
    samples = np.concatenate(thrusts) if thrusts else np.zeros((0, 1))
    if mass is None or not len(samples):
        return math.nan, math.nan
    weight = mass * GRAVITY
    spread = float(np.std(samples)) * math.sqrt(2.0 * MIN_CORRELATION / max(times, MIN_SETTLED))
    return float(np.mean(samples)) / weight, math.hypot(spread / weight, 1e-3)


def _with_expected_trims(
    drones: Mapping[str, DroneHover], known: Mapping[str, float]
) -> dict[str, DroneHover]:
    """Return drones with the trims that their tilts lead to expect."""
    lever = math.nan
    result = dict[str, DroneHover]()
    tilted = [
        drone
        for drone in drones.values()
        if drone.tilt_deg > LEVEL and not math.isnan(drone.trim[0])
    ]
    if {"mass", "kp"} <= set(known):
        lever = known["mass"] * GRAVITY / known["kp"]
    elif len(tilted) > 1:  # What most drones have in common
        lever = float(np.median([np.dot(x.trim, x.tilt) / np.dot(x.tilt, x.tilt) for x in tilted]))
    for name, drone in drones.items():
        expected = lever * drone.tilt[0], lever * drone.tilt[1]
        one = replace(drone, expected_trim=expected, lever=lever)
        if one.agrees and drone.tilt_deg > LEVEL and not drone.fixed_to:
            one = replace(one, fixed_to="body")
        result[name] = one
    return result


def loop_response(force: Array, first: Array, mass: float, kp: float, kd: float) -> Array:
    """Return positions x (times, 2) [m] of a mass under ``force - kp x - kd velocity`` at RATE.

    ``first`` (4,) are position and velocity at the first time.
    """
    A = np.array([[0.0, 1.0, 0.0], [-kp / mass, -kd / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    step = expm(A / RATE)
    state = first.reshape(2, 2)
    places = np.empty_like(force)
    for i, each in enumerate(force):
        places[i] = state[0]
        state = step[:2, :2] @ state + step[:2, 2:] * each
    return places


def mean_error(values: Array, seconds: float) -> float:
    """Return the standard error of means of a wandering position (times, 2) [m] over a time [s].

    Samples within the correlation time of the wander count once. Short hovers do not show slow
    wander, so at least WANDER is assumed.
    """
    off = values - np.mean(values, axis=0)
    variance = float(np.mean(np.sum(off**2, axis=1))) / 2.0
    lags = range(int(RATE * 0.1), len(off) // 2, int(RATE * 0.1))
    products = [float(np.mean(np.sum(off[k:] * off[:-k], axis=1))) / 2.0 for k in lags]
    below = next((k for k, x in zip(lags, products, strict=True) if x < variance / math.e), None)
    time = seconds / 4.0 if below is None else below / RATE
    independent = seconds / (2.0 * max(time, MIN_CORRELATION))
    return math.sqrt(max(variance, WANDER**2) / min(independent, seconds * RATE))


def _velocity(t: Array, x: Array) -> Array:
    """Return velocities (times, 3) [m/s], means over SPEED_TIME."""
    half = 0.5 * SPEED_TIME
    ahead, behind = (np.clip(t + sign * half, t[0], t[-1]) for sign in (1.0, -1.0))
    steps = interpolated(ahead, t, x) - interpolated(behind, t, x)
    return steps / np.maximum(ahead - behind, 1e-9)[:, None]


def _turned(vectors: Array, yaw: Array | float) -> Array:
    """Return horizontal vectors (…, 2) turned by angles (…) [rad]."""
    c = np.cos(yaw)
    s = np.sin(yaw)
    x = vectors[..., 0]
    y = vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _since(t: Array, events: Array) -> Array:
    """Return the time (times,) [s] since the last event; infinite before the first one."""
    i = np.searchsorted(events, t, side="right") - 1
    past = np.append(events, -np.inf)[i]
    return np.asarray(t - np.where(i < 0, -np.inf, past))


def _bridged(mask: NDArray[np.bool_], seconds: float) -> NDArray[np.bool_]:
    """Return a mask whose gaps between true values are closed, up to a duration [s]."""
    bridged = mask.copy()
    for start, end in true_runs(~mask):
        if start > 0 and end < len(mask) and end - start <= seconds * RATE:
            bridged[start:end] = True
    return bridged
