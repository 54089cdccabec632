"""Calibration of single drones from hovers: trims, tilts, thrust factors, lags and tracking errors.

A drone whose rigid body is defined tilted by an angle takes level flight for a tilt. Its position
loop, without an integral, then settles where its force cancels the one of that tilt: beside the set
point by ``m g/kp`` times the tangent of the angle. So the trim, set point minus place at rest, is
``m g/kp`` times the level part of the body's z axis over its upright part, and turns with yaw.
Position-only commands trail by the speed times ``kd/kp``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
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
from hitchopt.lab.flights.recordings import RecordedFlight, Signal
from hitchopt.storage.yaml_file import flow
from hitchopt.values import Array, positive
from hitchopt.values import path as checked_path

RATE = 50.0  # Of the samples that are compared [Hz]
SPEED_TIME = 1.0  # Time over which speeds are means [s]
MAX_LEVEL_SPEED, MAX_CLIMB = 0.08, 0.06  # Of a drone at rest [m/s]
MAX_COMMAND_SPEED = 0.02  # Of set points at rest [m/s]
TRANSIENT = 2.5  # After a movement, until the drone is settled [s]
MAX_BREAK = 1.0  # Longest movement within a settled part [s]
MIN_SETTLED, ENOUGH = 1.0, 10.0  # Settled time that is needed, and that is enough [s]
MIN_RISE, STILL = 0.15, 0.01  # Height of flight, and motion on the ground [m]
MIN_GROUND = 0.3  # Shortest time on the ground [s]

# Standard deviation that is assumed at least of the level wander about the place at rest, and of
# trims from flight to flight [m]; shortest correlation time of the wander [s]
WANDER, REPEATABILITY, MIN_CORRELATION = 0.01, 0.01, 1.0
MOTION_ERROR = 0.03  # Least error of a trim from motion: drag and tilt of the way are left out [m]
MAX_RATIO = 3.0  # Largest difference of trims over its standard error
# Relative error of a trim that is expected from a tilt: drones with cables scatter by a quarter
MODEL_ERROR = 0.25
LEVEL, NEAR = 1.5, 0.03  # Tilt [deg] and trim [m] that need no word
TURNED = 45.0  # Change of yaw that tells trims of bodies from those of the world [deg]
MAX_LAG, LAG_STEP = 4.0, 0.02  # Lags that are tried, and their step [s]
MIN_MOVING, MIN_PATH = 2.0, 0.3  # Shortest movement that determines a lag [s], [m]
COMMANDED, ABOVE_START = "commanded", "above the place before take-off"
IN_MOTION = "commanded, in motion"
DIRECTIONS = ("+x", "+x +y", "+y", "-x +y", "-x", "-x -y", "-y", "+x -y")


@dataclass(frozen=True)
class DroneHover(OneLine):
    """Findings about one drone in hovers; nan where they are not determined.

    Attributes
    ----------
    name: in the recording, or of the team.
    trim: set point minus place at rest, level, in the body's frame at yaw 0 [m].
    trim_error: standard error of both [m].
    set_point: where it is known from: ``commanded``, ``above the place before take-off``, or
        ``commanded, in motion``, where the trim is fitted to the position loop's response.
    settled: time at rest [s].
    tilt: level part of the body's z axis over its upright part, in the same frame.
    tilt_deg: angle of the body's z axis from vertical [deg].
    expected_trim: by the tilt and ``lever``, m g/kp of the gains or of all drones' tilts [m].
    lever: trim per tangent of the tilt that is expected [m].
    fixed_to: ``body``, ``world``, or empty if nothing tells.
    spread: standard deviation of the level position at rest [m].
    thrust_factor: commanded thrust over weight, and its standard error.
    lag, expected_lag: of moving commands, measured, and kd/kp if known and positions only [s].
    tracking: largest distances from the set point plus trim, level and in height [m].
    remarks: reasons for which something is not determined.
    """

    name: str
    trim: tuple[float, float] = (math.nan, math.nan)
    trim_error: float = math.nan
    set_point: str = ""
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
        """Whether the tilt explains the trim; None if one of them, or m g/kp, is unknown."""
        off = math.dist(self.trim, self.expected_trim)
        size = MODEL_ERROR * math.hypot(*self.expected_trim)
        return None if math.isnan(off) else off <= MAX_RATIO * math.hypot(self.trim_error, size)

    def to_dict(self) -> dict[str, Any]:
        """Return all findings as plain data, with None for what is not determined."""
        values = {each.name: _plain(getattr(self, each.name)) for each in fields(self)}
        return {**values, "agrees": self.agrees, "sentence": self.sentence}

    @property
    def sentence(self) -> str:
        """The findings and their remedy in one sentence."""
        if math.isnan(self.trim[0]):
            reasons = "; ".join(self.remarks) or "nothing is determined"
            return f"{self.name}: {reasons}{self._lag_words}"
        off, error = math.hypot(*self.trim), 100.0 * self.trim_error
        beside = f"{100.0 * off:.0f} cm toward {direction_of(*(-x for x in self.trim))} of its "
        beside += f"set point (± {error:.1g} cm)"
        if math.isnan(self.tilt_deg):
            text = f"hovers {beside}; its tilt is not recorded"
        elif self.tilt_deg < LEVEL and off < max(NEAR, 2.0 * self.trim_error):
            text = f"stands level and hovers within {100.0 * off:.1f} cm of its set point"
        elif self.agrees is False:
            by_tilt = 100.0 * math.hypot(*self.expected_trim)
            text = f"stands {self.tilt_deg:.1f}° tilted, which would be {by_tilt:.0f} cm toward "
            text += f"{direction_of(*(-x for x in self.expected_trim))}, but hovers {beside}: its "
            text += "tilt does not explain the trim, look for a bent arm, wind or a pull"
        else:
            text = f"stands {self.tilt_deg:.1f}° tilted: redefine its rigid body; until then it "
            text += f"hovers {beside}"
        text += self._lag_words
        if self.settled < ENOUGH:
            only = f"only {self.settled:.1f} s were settled" if self.settled else "never settled"
            text += f"; {only}: hover for {ENOUGH:g} s"
        return f"{self.name} {text}"

    @property
    def _lag_words(self) -> str:
        if math.isnan(self.lag):
            return ""
        text = f"; it follows commands {self.lag:.2f} s late (± {self.lag_error:.1g})"
        known = not math.isnan(self.expected_lag)
        return f"{text}, {self.expected_lag:.2f} s by its gains" if known else text


@dataclass(frozen=True, eq=False)
class HoverCalibration(OneLine):
    """Calibration of single drones from hovers, by their names."""

    drones: Mapping[str, DroneHover]
    notes: tuple[str, ...] = ()

    @property
    def quadrotor(self) -> dict[str, dict[str, Any]]:
        """What ``team.quadrotor`` takes, by drone; trims that the tilt contradicts are left out."""
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


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def direction_of(x: float, y: float) -> str:
    """Return the nearest of eight level directions in words."""
    return DIRECTIONS[round(4.0 * math.atan2(y, x) / math.pi) % 8]


def calibrate_hover(
    recordings: RecordedFlight | Path | str | Sequence[RecordedFlight | Path | str],
    *,
    mass: float | None = None,
    kp: float | None = None,
    kd: float | None = None,
    names: Mapping[str, str] | str | None = None,
) -> HoverCalibration:
    """Estimate trims, tilts, thrust factors and lags of drones from hovers, without a plan.

    A drone is at rest while it flies, and neither it nor its set point moves; the first seconds
    after each movement are left out. Without commands the set point is above the place before
    take-off.

    Parameters
    ----------
    recordings: one hover or several, files or directories in a format of ``read_flight``.
    mass: of every drone [kg], for thrust factors and expected trims; None: unknown.
    kp, kd: level gains of the position loop [N/m], [N s/m]; None: unknown.
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
    if isinstance(names, str):
        pairs = names.replace(" ", "").split(",")
        names = {name: drone for name, _, drone in (pair.partition("=") for pair in pairs)}
    labels = [each.source if isinstance(each, RecordedFlight) else str(each) for each in sources]
    drones = dict[str, DroneHover]()
    for name in dict.fromkeys(name for flight in flights for name in flight.tracks):
        hovers = [
            (label, HoverSeries(flight, name))
            for label, flight in zip(labels, flights, strict=True)
            if name in flight.tracks
        ]
        drones[name] = _drone(name, hovers, known)
    if all(math.isnan(drone.trim[0]) and math.isnan(drone.lag) for drone in drones.values()):
        reasons = "; ".join(dict.fromkeys(x for drone in drones.values() for x in drone.remarks))
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


@dataclass(frozen=True)
class _Rest:
    """A settled part: its times, trims in the world and the body's frame, and their error."""

    label: str
    source: str
    mask: NDArray[np.bool_]
    world: Array  # (2,) [m]
    body: Array  # (2,) [m]
    yaw: float  # [rad]
    error: float  # [m]


class HoverSeries:
    """A drone in a recording, sampled at RATE.

    Attributes
    ----------
    t: (times,) [s].
    x, velocity: (times, 3) [m], [m/s].
    commands: set points, if there are any.
    """

    def __init__(self, flight: RecordedFlight, name: str) -> None:
        track, own = flight.tracks[name], flight.signals.get(name, {})
        self.t = np.arange(track.t[0], track.t[-1], 1.0 / RATE)
        self.x, self.visible = track.at(self.t)
        self.remarks = list[str]()
        self.thrust = own.get("thrust")
        parts = ("velocity", "acceleration")
        self.moving = {x: own[f"commanded_{x}"] for x in parts if f"commanded_{x}" in own}
        attitude = own.get("attitude") or own.get("estimated_attitude")
        self.estimated = "attitude" not in own
        self.axis, self.yaw = self._attitude(attitude)
        self.ground = self._ground()
        self.commands = flight.setpoints.get(name)
        self.velocity = _velocity(self.t, self.x)
        self.set_point, self.source, self.still = self._set_points()
        self.flying = self._flying()

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
        """Return the place (3,) [m] before take-off; None if the recording begins in flight."""
        moved = length(self.x - self.x[0]) > STILL
        end = int(np.argmax(moved)) if np.any(moved) else len(moved)
        rises = float(np.max(self.x[:, 2]) - self.x[0, 2]) > MIN_RISE
        if end < MIN_GROUND * RATE or not rises:
            return None
        return np.asarray(np.median(self.x[:end], axis=0))

    def _flying(self) -> NDArray[np.bool_]:
        """Return whether the drone flies (times,)."""
        lowest = self.ground[2] if self.ground is not None else np.min(self.x[:, 2])
        z, top = self.x[:, 2], float(np.max(self.x[:, 2]))
        if self.ground is None and top - lowest < MIN_RISE:
            return np.ones(len(z), np.bool_)  # Recorded in flight
        return z > lowest + max(MIN_RISE, 0.5 * (top - lowest))

    def _set_points(self) -> tuple[Array, NDArray[Any], NDArray[np.bool_]]:
        """Return set points (times, 3), where they are known from, and whether they are at rest."""
        t, unknown = self.t, np.full((len(self.t), 3), np.nan)
        source = np.full(len(t), "", dtype=object)
        still = np.ones(len(t), np.bool_)
        points = unknown
        before = np.ones(len(t), np.bool_)
        if self.commands is not None:
            at, sent = self.commands.at(t)
            points = np.where(sent[:, None], at, np.nan)
            source[sent] = COMMANDED
            speeds = length(_velocity(t, at))
            moving = np.flatnonzero(sent & (speeds > MAX_COMMAND_SPEED))
            still[:] = _since(t, t[moving]) > TRANSIENT
            before = t < self.commands.t[0]
            still &= before | sent
        if self.ground is not None:
            points = np.where(before[:, None], [*self.ground[:2], np.nan], points)
            source[before] = ABOVE_START
        return points, source, still

    def rests(self, label: str) -> Iterator[_Rest]:
        """Yield the settled parts with a known set point."""
        level, climb = length(self.velocity[:, :2]), np.abs(self.velocity[:, 2])
        slow = (level < MAX_LEVEL_SPEED) & (climb < MAX_CLIMB) & self.flying & self.visible
        slow = _bridged(slow, MAX_BREAK) & self.flying & self.still
        for kind in (COMMANDED, ABOVE_START):
            for start, end in _runs(slow & (self.source == kind)):
                first = start + int(min(TRANSIENT * RATE, 0.5 * (end - start)))
                mask = np.zeros(len(self.t), np.bool_)
                mask[first:end] = True
                if np.sum(mask) < 0.5 * MIN_SETTLED * RATE:
                    continue
                off = (self.set_point - self.x)[mask, :2]
                c, s = np.cos(self.yaw[mask]), np.sin(self.yaw[mask])
                body = np.stack([c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]], 1)
                yield _Rest(
                    label,
                    kind,
                    mask,
                    np.mean(off, axis=0),
                    np.mean(body, axis=0),
                    float(np.angle(np.mean(np.exp(1j * self.yaw[mask])))),
                    mean_error(off, np.sum(mask) / RATE),
                )

    def moving_part(self, gains: Mapping[str, float]) -> slice | None:
        """Return the samples of the longest flight under moving commands; None without gains."""
        if self.commands is None or not {"mass", "kp", "kd"} <= set(gains):
            return None
        ends = self.commands.t[[0, -1]]
        mask = (self.t >= ends[0]) & (self.t <= ends[1]) & self.flying & self.visible
        start, end = max(_runs(mask), key=lambda run: run[1] - run[0], default=(0, 0))
        speed = length(_velocity(self.t, self.commands.at(self.t)[0])[start:end, :2])
        is_moving = np.sum(speed > MAX_COMMAND_SPEED) >= MIN_MOVING * RATE
        return slice(start, end) if is_moving else None

    def predicted(self, part: slice, trim: Array, gains: Mapping[str, float]) -> Array:
        """Return the places (times, 2) [m] of the position loop with a trim (2,) [m].

        They follow from ``kp (command - trim - place) + kd (commanded velocity - velocity)``, plus
        the mass times commanded accelerations.
        """
        if self.commands is None:
            raise ValueError("a loop follows commands")
        mass, kp, kd = gains["mass"], gains["kp"], gains["kd"]
        t = self.t[part]
        force = kp * (self.commands.at(t)[0][:, :2] - self.in_world(trim)[part])
        for quantity, gain in (("velocity", kd), ("acceleration", mass)):
            if quantity in self.moving:
                force = force + gain * self.moving[quantity].at(t)[:, :2]
        first = np.concatenate([self.x[part.start, :2], self.velocity[part.start, :2]])
        return loop_response(force, first, mass, kp, kd)

    def response(self, label: str, gains: Mapping[str, float]) -> Iterator[_Rest]:
        """Yield the trim that fits the response of the position loop to moving commands."""
        part = self.moving_part(gains)
        if part is None:
            return
        x, trims = self.x[part, :2], (np.zeros(2), *np.eye(2))
        base, *shifted = (self.predicted(part, trim, gains) for trim in trims)
        effects = np.stack([(each - base).ravel() for each in shifted], axis=1)  # They add up
        body: Array = np.linalg.lstsq(effects, (x - base).ravel(), rcond=None)[0].astype(np.float64)
        residual = x - self.predicted(part, body, gains)
        mask = np.zeros(len(self.t), np.bool_)
        mask[part] = True
        yaw = float(np.angle(np.mean(np.exp(1j * self.yaw[mask]))))
        world = np.array([math.cos(yaw) * body[0] - math.sin(yaw) * body[1],
                          math.sin(yaw) * body[0] + math.cos(yaw) * body[1]])  # fmt: skip
        error = math.hypot(mean_error(residual, len(residual) / RATE), MOTION_ERROR)
        yield _Rest(label, IN_MOTION, mask, world, body, yaw, error)

    def tilt(self, rest: _Rest) -> Array:
        """Return the mean tilt (2,) in the body's frame at yaw 0; nan if it is not known.

        Of a drone in motion it is the tilt while it is slow.
        """
        mask = rest.mask
        if rest.source == IN_MOTION:
            slow = length(self.velocity[:, :2]) < MAX_LEVEL_SPEED
            mask = slow & self.flying & self.visible & (self.source != COMMANDED)
        x, y, z = self.axis[mask].T
        c, s = np.cos(self.yaw[mask]), np.sin(self.yaw[mask])
        tilts = np.stack([c * x + s * y, c * y - s * x], axis=1) / np.abs(z)[:, None]
        tilts = tilts[np.isfinite(tilts).all(axis=1)]
        unknown: Array = np.full(2, np.nan)
        return np.mean(tilts, axis=0) if len(tilts) else unknown

    def in_world(self, trim: Array) -> Array:
        """Return a trim of the body in the world's frame (times, 2) [m]."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.stack([c * trim[0] - s * trim[1], s * trim[0] + c * trim[1]], axis=1)

    def lag(self, trim: Array | None) -> tuple[float, float]:
        """Return the lag of the drone behind moving commands, and its standard error [s].

        It is the time constant of a first-order lag, kd/kp of a slow loop. An unknown trim is
        fitted.
        """
        if self.commands is None:
            return math.nan, math.nan
        ends = self.commands.t[[0, -1]]
        moving = (self.t > ends[0] + TRANSIENT) & (self.t <= ends[1]) & self.flying & self.visible
        speed = length(_velocity(self.t, self.commands.at(self.t)[0])[:, :2])
        moving &= speed > MAX_COMMAND_SPEED
        path = float(np.sum(speed[moving])) / RATE
        if np.sum(moving) < MIN_MOVING * RATE or path < MIN_PATH:
            return math.nan, math.nan
        start, end = max(_runs(moving), key=lambda run: run[1] - run[0])
        place, command = self.x[start:end, :2], self.commands.at(self.t[start:end])[0][:, :2]
        place = place if trim is None else place + self.in_world(trim)[start:end]
        lags = np.arange(LAG_STEP, MAX_LAG, LAG_STEP)
        off = np.stack([place - _trailing(command, place[0], lag) for lag in lags.tolist()])
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
        """Return the largest distances from set points plus trim while these are known [m]."""
        used: NDArray[np.bool_] = np.any([rest.mask for rest in rests], axis=0)
        if self.commands is not None:
            sent = (self.source == COMMANDED) & self.flying & self.visible
            used |= sent & (self.t > self.commands.t[0] + TRANSIENT)
        off = self.set_point - self.x
        off[:, :2] -= self.in_world(trim)
        heights = off[used, 2]
        if not np.isfinite(heights).any():  # Above the place before take-off, at unknown height
            heights = self.x[used, 2] - np.median(self.x[used, 2])
        level = length(off[used, :2])
        return {"level": float(np.nanmax(level)), "height": float(np.nanmax(np.abs(heights)))}


def _drone(
    name: str, hovers: Sequence[tuple[str, HoverSeries]], known: Mapping[str, float]
) -> DroneHover:
    """Return what hovers tell of a drone, without the trims that all drones' tilts lead to expect.

    Raises InputError for trims that differ by more than their errors.
    """
    rests = [
        (hover, [*hover.rests(label), *hover.response(label, known)]) for label, hover in hovers
    ]
    parts = [rest for _, own in rests for rest in own]
    if not parts:
        known_points = any(np.isfinite(hover.set_point[:, 0]).any() for _, hover in hovers)
        flies = any(hover.flying.any() for _, hover in hovers)
        reason = "it is never at rest in flight" if known_points else "its set point is unknown"
        remedy = "hover for ten seconds" if known_points else "record commands, or from the ground"
        reason = f"{reason if flies else 'it does not fly'}; {remedy}"
        lags = [hover.lag(None) for _, hover in hovers]
        lag, error = next((each for each in lags if not math.isnan(each[0])), lags[0])
        return DroneHover(name, lag=lag, lag_error=error, remarks=(reason,))
    body, world = (_combined(parts, frame) for frame in ("body", "world"))
    yaws = np.degrees(np.unwrap([rest.yaw for rest in parts]))
    is_turned, fixed_to = np.ptp(yaws) > TURNED, ""
    if is_turned:
        fixed_to = "body" if body[2] <= world[2] else "world"
    _refuse_changed(name, parts, "world" if fixed_to == "world" else "body")
    trim, error = (world if fixed_to == "world" else body)[:2]
    settled = sum(float(np.sum(x.mask)) / RATE for x in parts if x.source != IN_MOTION)
    weights = [(hover, rest) for hover, own in rests for rest in own]
    at_rest = [(hover, rest) for hover, rest in weights if rest.source != IN_MOTION]
    spread = max(
        (float(np.sqrt(np.sum(np.var(h.x[r.mask, :2], axis=0)))) for h, r in at_rest),
        default=math.nan,
    )
    tilt = _mean_tilt(at_rest or weights)
    longest = max((rest for _, rest in at_rest or weights), key=lambda rest: int(np.sum(rest.mask)))
    remarks = list[str]()
    if any(hover.estimated for hover, _ in weights) and not np.isnan(tilt[0]):
        remarks.append("the tilt is the one that the drone estimates")
    if all(np.isnan(hover.axis).all() for hover, _ in weights):
        remarks.append("no attitude is recorded: yaw is taken as 0")
    thrust_factor, thrust_error = _thrust_factor(at_rest, known.get("mass"))
    if math.isnan(thrust_factor) and any(hover.thrust is not None for hover, _ in weights):
        remarks.append("thrust factors need mass=")
    lags = [each for hover, _ in weights if not math.isnan((each := hover.lag(trim))[0])]
    lag, lag_error = min(lags, key=lambda each: each[1], default=(math.nan, math.nan))
    positions_only = not any(hover.moving for hover, _ in weights)
    expected_lag = math.nan
    if {"kp", "kd"} <= set(known):
        expected_lag = known["kd"] / known["kp"] if positions_only else 0.0
    tubes = [hover.tracking(trim, own) for hover, own in rests if own]
    tracking = {axis: max(tube[axis] for tube in tubes) for axis in ("level", "height")}
    x, y = trim.tolist()
    return DroneHover(
        name,
        (x, y),
        error,
        longest.source,
        settled,
        (float(tilt[0]), float(tilt[1])),
        math.degrees(math.atan(math.hypot(*tilt))),
        fixed_to=fixed_to,
        spread=spread,
        yaw_deg=math.degrees(longest.yaw),
        thrust_factor=thrust_factor,
        thrust_factor_error=thrust_error,
        lag=lag,
        lag_error=lag_error,
        expected_lag=expected_lag,
        tracking=tracking,
        remarks=tuple(remarks),
    )


def _mean_tilt(weights: Sequence[tuple[HoverSeries, _Rest]]) -> Array:
    """Return the mean tilt (2,) over settled parts, by their times; nan if none is known."""
    tilts = np.stack([hover.tilt(rest) for hover, rest in weights])
    sizes = np.array([float(np.sum(rest.mask)) for _, rest in weights])
    sizes[np.isnan(tilts[:, 0])] = 0.0
    unknown: Array = np.full(2, np.nan)
    return np.asarray(sizes @ np.nan_to_num(tilts) / np.sum(sizes)) if np.any(sizes) else unknown


def _refuse_changed(name: str, parts: Sequence[_Rest], frame: str) -> None:
    """Raise InputError for trims in a frame that differ by more than their errors."""
    pairs = [(a, b) for a in parts for b in parts]
    first, second = max(pairs, key=lambda pair: _ratio(pair[0], pair[1], frame))
    if _ratio(first, second, frame) <= MAX_RATIO:
        return
    trims = [(100.0 * getattr(rest, frame)).tolist() for rest in (first, second)]
    places = [
        f"[{x:.1f}, {y:.1f}] cm in {rest.label}"
        for (x, y), rest in zip(trims, (first, second), strict=True)
    ]
    errors = " and ".join(f"{100.0 * rest.error:.1f}" for rest in (first, second))
    bound = f"equal within {MAX_RATIO:g} standard errors, of {errors} cm"
    remedy = "its rigid body was redefined, or it was bent, in between: calibrate the last hover"
    raise InputError(f"trim of {name}", f"{places[0]}, but {places[1]}", bound, remedy)


def _combined(parts: Sequence[_Rest], frame: str) -> tuple[Array, float, float]:
    """Return the mean trim (2,) in a frame, its standard error, and the largest ratio of two."""
    trims = np.stack([getattr(rest, frame) for rest in parts])
    weights = np.array([1.0 / rest.error**2 for rest in parts])
    mean = weights @ trims / np.sum(weights)
    error = math.hypot(1.0 / math.sqrt(float(np.sum(weights))), REPEATABILITY)
    return mean, error, max(_ratio(a, b, frame) for a in parts for b in parts)


def _ratio(a: _Rest, b: _Rest, frame: str) -> float:
    """Return the distance of two trims over its standard error."""
    error = math.hypot(a.error, b.error, math.sqrt(2.0) * REPEATABILITY)
    return float(math.dist(getattr(a, frame), getattr(b, frame))) / error


def _thrust_factor(
    weights: Sequence[tuple[HoverSeries, _Rest]], mass: float | None
) -> tuple[float, float]:
    """Return the commanded thrust at rest over the weight, and its standard error."""
    thrusts, times = list[Array](), 0.0
    for hover, rest in weights:
        if hover.thrust is not None:
            t = hover.t[rest.mask]
            inside = (t >= hover.thrust.t[0]) & (t <= hover.thrust.t[-1])
            thrusts.append(hover.thrust.at(t[inside]))
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
    lever, result = math.nan, dict[str, DroneHover]()
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


def _trailing(commands: Array, first: Array, lag: float) -> Array:
    """Return places (times, 2) that follow commands with a first-order lag [s], from the first."""
    decay = math.exp(-1.0 / (RATE * lag))
    places, _ = lfilter([1.0 - decay], [1.0, -decay], commands, axis=0, zi=decay * first[None])
    return np.asarray(places)


def loop_response(force: Array, first: Array, mass: float, kp: float, kd: float) -> Array:
    """Return places (times, 2) [m] of a mass under ``force - kp place - kd velocity`` at RATE.

    ``first`` (4,) are place and velocity at the first time.
    """
    A = np.array([[0.0, 1.0, 0.0], [-kp / mass, -kd / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    step = expm(A / RATE)
    state, places = first.reshape(2, 2), np.empty_like(force)
    for i, each in enumerate(force):
        places[i] = state[0]
        state = step[:2, :2] @ state + step[:2, 2:] * each
    return places


def mean_error(values: Array, seconds: float) -> float:
    """Return the standard error of the means of a wandering place (times, 2) [m] over a time [s].

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
    steps = [np.interp(ahead, t, each) - np.interp(behind, t, each) for each in x.T]
    return np.stack(steps, axis=1) / np.maximum(ahead - behind, 1e-9)[:, None]


def _since(t: Array, events: Array) -> Array:
    """Return the time (times,) [s] since the last event; infinite before the first one."""
    i = np.searchsorted(events, t, side="right") - 1
    past = np.append(events, -np.inf)[i]
    return np.asarray(t - np.where(i < 0, -np.inf, past))


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and the last index, exclusive, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _bridged(mask: NDArray[np.bool_], seconds: float) -> NDArray[np.bool_]:
    """Return a mask with gaps between true values up to a time closed."""
    bridged = mask.copy()
    for start, end in _runs(~mask):
        if start > 0 and end < len(mask) and end - start <= seconds * RATE:
            bridged[start:end] = True
    return bridged
