"""Attitude filters, replayed on the sensors of a recorded flight.

Usage: python -m benchmarks replay RECORDING

The Kalman filter of Crazyflies runs on the logged gyroscope, accelerometer and positions: with the
firmware's parameters for one marker and for rigid bodies, and with those that exports set. Logs
need ``gyro``, an attitude (``stateEstimate.qx``, ``roll``, ``stateEstimateZ.quat`` or
``ctrlLeeP.rpyx``) and positions.

A filter is fed with the recorded gyroscope, accelerometer and positions, and never with the logged
attitude, which it is compared with. How much of a cable's pull it sees follows from a second run in
which the drone leans against a small additional pull: the share of that lean that it believes.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from hitchopt.cli.output import known_text
from hitchopt.drones.controllers import FIRMWARE, HELD, ONE_MARKER, EstimatorParameters
from hitchopt.errors import FileError, OneLine
from hitchopt.geometry.vectors import dot, left_of, length
from hitchopt.hitch import GRAVITY
from hitchopt.lab.flights.readers import read_flight
from hitchopt.lab.flights.recordings import RecordedFlight, interpolated
from hitchopt.lab.simulation.estimator import Filter, rotation
from hitchopt.tables import table
from hitchopt.values import Array
from hitchopt.values import path as checked_path

RATE = 100.0  # Of samples that are compared over all bodies [Hz]
SMOOTHING = 0.06  # Standard deviation of the smoothing before derivatives [s]
SETTLING, END = 1.0, 0.3  # Time after the start, and before the end, that is not compared [s]
# Shifts of the gyroscope's samples to those of the logged attitude that are tried [s]
DELAYS = np.arange(-5e-3, 30e-3, 5e-4)
LEAN = 0.01  # Mean additional lean [rad]
STEADY_START = 1.0  # Start of the additional pull of a drone without a load [s]

FILTERS: Mapping[str, EstimatorParameters] = {
    "stock, one marker": ONE_MARKER,
    "stock, rigid body": FIRMWARE,
    "exported": HELD,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rms tilt of replayed filters from logged and captured attitudes.

    Arguments are those of the process by default.
    """
    cli = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cli.add_argument("recording", type=Path, help="logs, in a format of read_flight")
    flight = read_flight(cli.parse_args(arguments).recording)
    rows, remarks = list[dict[str, object]](), dict[str, None]()
    for each in replay_filters(flight):
        share = f"{100.0 * each.pull_seen:.0f}"
        rows.append(
            {
                "drone": each.drone,
                "filter": each.filter,
                "off the logged [°]": known_text(each.logged_rms_deg, digits=".2f"),
                "off the captured [°]": known_text(each.captured_rms_deg, digits=".2f"),
                "pull seen [%]": share,
            }
        )
        remarks |= {each.remark: None} if each.remark else {}
    if not flight.loads:
        remarks["no load is recorded: the pull is a steady one"] = None
    sys.stdout.write("\n".join([table("Replayed filters", rows), "", *remarks]).rstrip() + "\n")


@dataclass(frozen=True)
class ReplayedFilter(OneLine):
    """A filter replayed on a drone's record; nan where it is not determined.

    Attributes
    ----------
    drone, filter: names.
    logged_rms_deg: root mean square tilt error from the attitude that the drone logged [deg].
    captured_rms_deg: the same from the captured attitude [deg].
    pull_seen: share of the cable's pull that it sees.
    seconds: time that is compared [s].
    remark: reason for which it was not replayed, or empty.
    """

    drone: str
    filter: str
    logged_rms_deg: float = math.nan
    captured_rms_deg: float = math.nan
    pull_seen: float = math.nan
    seconds: float = 0.0
    remark: str = ""


def replay_filters(
    recording: RecordedFlight | Path | str,
    filters: Mapping[str, EstimatorParameters] | None = None,
) -> tuple[ReplayedFilter, ...]:
    """Replay filters on all drones of a recorded flight with gyroscopes.

    The pull is that of the recorded load, or a steady one. Without a logged accelerometer the
    force along the body's z axis follows from the velocity.

    Parameters
    ----------
    recording: a file or directory in a format of ``read_flight``, or a ``RecordedFlight``.
    filters: parameters by name; None: the firmware's for one marker and for rigid bodies, and
        those that exports set. Filters of rigid bodies need captured attitudes.

    Raises
    ------
    FileError: a recording that cannot be read, or without gyroscopes and attitudes.
    """
    flight = recording
    if not isinstance(flight, RecordedFlight):
        flight = read_flight(checked_path("recording", flight))
    series = {name: x for name in flight.tracks if (x := Series.of(flight, name)) is not None}
    if not series:
        held = sorted({quantity for own in flight.signals.values() for quantity in own})
        problem = f"holds {', '.join(held) or 'positions only'}: filters need rates and attitudes"
        raise FileError(f"{flight.source}: {problem}; log gyro and stateEstimate")
    return tuple(
        one.replayed(name, label, parameters)
        for name, one in series.items()
        for label, parameters in (FILTERS if filters is None else filters).items()
    )


@dataclass(frozen=True, eq=False)
class Series:
    """A drone's record at the times of its positions."""

    t: Array  # (m,) [s]
    positions: Array  # (m, 3) [m]
    velocities: Array  # (m, 3) [m/s]
    rates: Array  # (m, 3) [rad/s], shifted to the times of the logged attitude
    force: Array  # (m,) [m/s²], specific force along the body's z axis
    known: Array  # captured attitudes, or logged ones (m, 3, 3)
    logged: Array | None  # attitudes (m, 3, 3); None if not recorded
    captured: Array | None  # the same
    pull: Array | None  # (m, 3) [m/s²], by the load's cable up to a factor; None without a load

    @classmethod
    def of(cls, flight: RecordedFlight, name: str) -> Series | None:
        """Return a drone's record; None without rates or an attitude."""
        own, track = flight.signals.get(name, {}), flight.tracks[name]
        known = [own[x] for x in ("estimated_attitude", "attitude") if x in own]
        if "rates" not in own or not known:
            return None
        start = max([track.t[0], own["rates"].t[0], *(x.t[0] for x in known)])
        end = min([track.t[-1], own["rates"].t[-1], *(x.t[-1] for x in known)])
        inside = (track.t >= start) & (track.t <= end)
        t, positions = track.t[inside], track.positions[inside]
        if len(t) < 2.0 * RATE * SETTLING:
            return None
        logged, captured = (
            attitudes_at(own[x].t, own[x].values, t) if x in own else None
            for x in ("estimated_attitude", "attitude")
        )
        attitudes: Any = captured if logged is None else logged
        delay = gyro_delay(t, attitudes, own["rates"].at)
        velocities = derivative(t, positions, 0.5 * SMOOTHING)
        if "estimated_velocity" in own:
            velocities = own["estimated_velocity"].at(t)
        if "specific_force" in own:
            force = own["specific_force"].at(t)[:, 2]
        else:
            acceleration = derivative(t, velocities, 0.5 * SMOOTHING) + [0.0, 0.0, GRAVITY]
            force = np.einsum("ia,ia->i", acceleration, attitudes[..., 2])
        pull = None
        if len(flight.loads) == 1 and flight.one_clock:
            pull = cable_pulls(flight, t)[list(flight.tracks).index(name)]
        rates = own["rates"].at(t - delay)
        exact: Any = logged if captured is None else captured
        return cls(t, positions, velocities, rates, force, exact, logged, captured, pull)

    @property
    def used(self) -> NDArray[np.bool_]:
        """Return whether samples (m,) are compared."""
        return np.asarray((self.t > self.t[0] + SETTLING) & (self.t < self.t[-1] - END))

    def replayed(self, drone: str, label: str, parameters: EstimatorParameters) -> ReplayedFilter:
        """Return the errors of a filter, and the share of the pull that it sees."""
        leaning, rates = self._leaning()
        true = np.stack([self.known, leaning])
        believed = self._run(parameters, np.stack([self.rates, rates]), true)[:, self.used]
        axes = believed[..., :2, 2], true[:, self.used][..., :2, 2]
        seen, lean = (each[1] - each[0] for each in axes)  # Level changes of the thrust axis
        share = float(np.sum(seen * lean)) / max(float(np.sum(lean**2)), 1e-12)
        if parameters.attitude_error and self.captured is None:
            remark = "no captured attitude is recorded: its error is unknown"
            return ReplayedFilter(drone, label, pull_seen=share, remark=remark)
        errors = [
            math.nan if x is None else tilt_rms_deg(believed[0, ..., 2], x[self.used][..., 2])
            for x in (self.logged, self.captured)
        ]
        t = self.t[self.used]
        return ReplayedFilter(drone, label, errors[0], errors[1], share, float(t[-1] - t[0]))

    def believed(self, parameters: EstimatorParameters) -> Array:
        """Return the attitudes (m, 3, 3) that a filter believes."""
        return np.asarray(self._run(parameters, self.rates[None], self.known[None])[0])

    def _run(self, parameters: EstimatorParameters, rates: Array, captured: Array) -> Array:
        """Return attitudes (runs, m, 3, 3) that filters believe.

        ``rates`` are (runs, m, 3), and captured attitudes, the first of which are known to the
        filters, (runs, m, 3, 3).
        """
        each, first = np.ones((len(rates), 1)), captured[:, 0]
        filters = Filter(parameters, each * self.positions[0], each * self.velocities[0], first)
        middle = 0.5 * (rates[:, 1:] + rates[:, :-1])
        attitudes = np.empty_like(captured)
        attitudes[:, 0] = first
        for i, dt in enumerate(np.diff(self.t).tolist(), 1):
            filters.advance(middle[:, i - 1], each[:, 0] * self.force[i], dt)
            filters.observe(each * self.positions[i], captured[:, i])
            attitudes[:, i] = filters.attitudes
        return attitudes

    def _leaning(self) -> tuple[Array, Array]:
        """Return attitudes and rates with an additional lean against a pull."""
        pull = self.pull
        if pull is None:
            steady = (self.t > self.t[0] + STEADY_START).astype(np.float64)
            ramp = gaussian_filter1d(steady, SMOOTHING * RATE)
            pull = ramp[:, None] * np.array([1.0, 0.0, 0.0])
        level = left_of(pull)
        turn = -LEAN / max(_rms(length(level)), 1e-9) * level
        turning = np.einsum("iba,ib->ia", self.known, derivative(self.t, turn, 0.5 * SMOOTHING))
        return rotation(turn) @ self.known, self.rates + turning


def attitudes_at(t: Array, quaternions: Array, times: Array) -> Array:
    """Return attitudes (times, 3, 3) between quaternions (m, 4) at times (m,)."""
    signs = np.cumprod(np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0, -1.0, 1.0))
    smooth = quaternions * np.append(1.0, signs)[:, None]
    return np.asarray(Rotation.from_quat(interpolated(times, t, smooth)).as_matrix())


def gyro_delay(t: Array, attitudes: Array, rates_at: Any) -> float:
    """Return the time by which a logged attitude (m, 3, 3) trails the gyroscope [s]."""
    steps = np.diff(t)
    relative = attitudes[:-1].transpose(0, 2, 1) @ attitudes[1:]
    turning = Rotation.from_matrix(relative).as_rotvec() / steps[:, None]
    middle = 0.5 * (t[1:] + t[:-1])
    squares = [
        np.mean(np.minimum(np.sum((rates_at(middle - d) - turning)[:, :2] ** 2, axis=1), 1.0))
        for d in DELAYS.tolist()
    ]
    return float(DELAYS[int(np.argmin(squares))])


def cable_pulls(flight: RecordedFlight, t: Array, load: float = 1.0) -> Array:
    """Return the forces (drones, times, 3) [N] of straight cables to a load [kg] at a point.

    The drones' tensions carry the load's weight and acceleration, with least squares.
    """
    place = next(iter(flight.loads.values())).at(t)[0]
    carried = load * (smoothed(t, place, order=2) + [0.0, 0.0, GRAVITY])
    drones = np.stack([track.at(t)[0] for track in flight.tracks.values()])
    drones = np.stack([smoothed(t, x) for x in drones])
    off = smoothed(t, place) - drones
    units = off / np.linalg.norm(off, axis=-1, keepdims=True)  # From drones to the load
    tensions = np.einsum("tda,ta->td", np.linalg.pinv(-units.transpose(1, 2, 0)), carried)
    return np.asarray(tensions.T[..., None] * units)


def smoothed(t: Array, values: Array, time: float = SMOOTHING, order: int = 0) -> Array:
    """Return values (m, k), or a derivative of them, smoothed over a time [s]."""
    grid = np.arange(t[0], t[-1], 1.0 / RATE)
    even = gaussian_filter1d(interpolated(grid, t, values), time * RATE, axis=0, mode="nearest")
    for _ in range(order):
        even = np.gradient(even, 1.0 / RATE, axis=0)
    return interpolated(t, grid, even)


def derivative(t: Array, values: Array, time: float = SMOOTHING) -> Array:
    """Return derivatives (m, k) of values that are smoothed over a time [s]."""
    return smoothed(t, values, time, order=1)


def tilt_rms_deg(a: Array, b: Array) -> float:
    """Return the root mean square angle [deg] between axes (m, 3) of unit length."""
    return math.degrees(_rms(np.arctan2(length(np.cross(a, b)), dot(a, b))))


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))
