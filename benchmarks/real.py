"""Models against public flights of drones with cables that others recorded.

Usage: python -m benchmarks real --flights DIR [--fit DIR] [--json FILE] [-o FOLDER]

DIR holds, in any folders, bags or folders of uSD logs of drones with one load. Each flight is
predicted from other flights: those of ``--fit``, by default all others of DIR. Every figure has its
standard error over the series.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Array, Table, parser
from benchmarks.replay import (
    RATE,
    SETTLING,
    Series,
    cable_pulls,
    smoothed,
    tilt_rms_deg,
)
from hitchopt.drones.controllers import HELD, ONE_MARKER
from hitchopt.hitch import GRAVITY
from hitchopt.lab.flights.recordings import RecordedFlight

# Masses of drones whose logs hold a thrust in newtons or a vector of it, and of their load [kg]
MASSES, LOAD = {"ctrlLeeP.thrustSI": 0.0345, "ctrlLeeP.ux": 0.0356}, 0.01
TAUT = 0.5  # Smallest tension over its median at which a cable's length is measured

LIMITATIONS = (
    "public recordings; masses and gains as their sources state them; straight cables, a load at a "
    "point; positions of drones with a load are those that they estimated"
)


@dataclass(frozen=True)
class Figure:
    """A figure, its standard error, and the number of series it is of; nan without one."""

    value: float
    standard_error: float
    n: int

    @classmethod
    def mean(cls, values: Sequence[float]) -> Figure:
        """Return the mean of independent values."""
        x = np.array(values, np.float64)
        if not len(x):
            return cls(math.nan, math.nan, 0)
        error = float(np.std(x, ddof=1)) / math.sqrt(len(x)) if len(x) > 1 else math.nan
        return cls(float(np.mean(x)), error, len(x))

    @classmethod
    def rms(cls, values: Sequence[float]) -> Figure:
        """Return the root mean square of independent values."""
        squares = cls.mean([x**2 for x in values])
        rms = math.sqrt(squares.value) if squares.n else math.nan
        return cls(rms, squares.standard_error / (2.0 * rms) if rms else math.nan, squares.n)

    def scaled(self, factor: float) -> Figure:
        """Return the figure in another unit."""
        return Figure(factor * self.value, factor * self.standard_error, self.n)

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.standard_error:.1g}" if self.n else "–"

    @property
    def plain(self) -> dict[str, Any]:
        """The figure for JSON, with null for what no series has."""
        return {name: x if math.isfinite(x) else None for name, x in vars(self).items()}


@dataclass(frozen=True)
class LoadSeries:
    """Figures of a drone that carries a load, in one flight."""

    flight: Path
    drone: str  # name and kind of log, so that it is the same drone in other flights
    filter_rms_deg: float
    true_tilt_deg: float  # distance of the logged attitude from the one by forces
    logged_gain: float  # of the logged tilt on acceleration, and its share of the pull
    logged_share: float
    replayed_share: float
    exported_share: float
    length: float  # of the cable [m]
    commanded: float  # mean thrust [N]
    static: float  # mean thrust by statics [N]
    drag: float  # [N s/m]; nan without an accelerometer


def flights_in(folder: Path) -> dict[Path, RecordedFlight]:
    """Return the flights in a folder by their paths; what cannot be read is reported."""
    files = sorted(path for path in folder.resolve().rglob("*") if path.is_file())
    logs = {path.parent for path in files if _first_byte(path) == b"\xbc"}
    bags = {path for path in files if path.suffix == ".bag"}
    bags |= {path.parent for path in files if path.name == "metadata.yaml"}
    flights = dict[Path, RecordedFlight]()
    for path in sorted(logs | bags):
        try:
            flights[path] = ho.read_flight(path)
        except ho.HitchoptError as error:
            print(f"- not read: {error}", flush=True)
    return flights


def _first_byte(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(1)


def load_series(path: Path, flight: RecordedFlight) -> Iterator[LoadSeries]:
    """Yield the figures of the drones that carry one load."""
    if len(flight.loads) != 1 or not flight.one_clock:
        return
    load = next(iter(flight.loads.values()))
    for i, (drone, track) in enumerate(flight.tracks.items()):
        series, own = Series.of(flight, drone), flight.signals[drone]
        if series is None or series.logged is None or "thrust" not in own:
            continue
        kind = flight.sources[drone]["thrust"]
        mass = MASSES.get(kind, next(iter(MASSES.values())))
        t, used = series.t, series.used
        pull = cable_pulls(flight, t, LOAD)[i] / mass
        acceleration = smoothed(t, track.at(t)[0], order=2)
        lift = acceleration + [0.0, 0.0, GRAVITY] - pull
        stock = series.believed(ONE_MARKER)
        axes = [x[..., 2] for x in (stock, series.logged)]
        true = lift / np.linalg.norm(lift, axis=1, keepdims=True)
        pairs = (axes[0], axes[1]), (axes[1], true)
        errors = [tilt_rms_deg(a[used], b[used]) for a, b in pairs]
        shares = [_gain_and_share(t, x, lift, acceleration, pull, used) for x in axes[::-1]]
        replayed = series.replayed(drone, "exported", HELD).pull_seen
        tension = np.linalg.norm(pull, axis=1)
        taut = used & (tension > TAUT * np.median(tension))
        lengths = np.linalg.norm(load.at(t)[0] - track.at(t)[0], axis=1)
        thrusts = own["thrust"].at(t)[used, 0]
        yield LoadSeries(
            path,
            f"{drone.partition('_')[0]}, {kind}",
            errors[0],
            errors[1],
            shares[0][0],
            shares[0][1],
            shares[1][1],
            replayed,
            float(np.median(lengths[taut])),
            float(np.mean(thrusts)),
            mass * float(np.mean(np.linalg.norm(lift, axis=1)[used])),
            _drag(flight, drone, series, pull, mass),
        )


def _gain_and_share(
    t: Array, axis: Array, lift: Array, acceleration: Array, pull: Array, used: Any
) -> tuple[float, float]:
    """Return the gains of a believed thrust axis (times, 3) on acceleration and on the pull.

    Both are fitted to the level part, with a constant tilt along each axis.
    """
    believed = smoothed(t, axis[:, :2] / axis[:, 2:]) * lift[:, 2:]
    gain, share = _level_fit(*(x[used] for x in (believed, acceleration, -pull)))
    return gain, share


def _level_fit(values: Array, *parts: Array) -> list[float]:
    """Return the coefficients of parts (m, 2 or 3) in the level part of values.

    Fitted with a constant along each axis, by least squares.
    """
    columns = [np.concatenate([x[:, 0], x[:, 1]]) for x in (values, *parts)]
    constants = np.repeat(np.eye(2), len(values), axis=0)
    fit = np.linalg.lstsq(np.column_stack([*columns[1:], constants]), columns[0], rcond=None)[0]
    return [float(x) for x in fit[: len(parts)]]


def _drag(flight: RecordedFlight, drone: str, series: Series, pull: Array, mass: float) -> float:
    """Return the rotor drag [N s/m]: horizontal specific force of the body over its velocity."""
    own, logged = flight.signals[drone], series.logged
    if "specific_force" not in own or logged is None:
        return math.nan
    t, used = series.t, series.used
    force = smoothed(t, own["specific_force"].at(t))[used]
    velocity = smoothed(t, series.velocities)
    parts = [np.einsum("iba,ib->ia", logged, x)[used] for x in (velocity, pull)]
    return -mass * _level_fit(force, *parts)[0]


def predicted_by_others(
    series: Sequence[LoadSeries],
    fits: Sequence[LoadSeries],
    quantity: Callable[[LoadSeries], float],
) -> list[tuple[LoadSeries, float]]:
    """Return series with the mean of a quantity over other flights of the same drone; nan: none."""
    by_drone = defaultdict[str, list[LoadSeries]](list)
    for each in fits:
        by_drone[each.drone].append(each)
    pairs = list[tuple[LoadSeries, float]]()
    for each in series:
        values = [quantity(x) for x in by_drone[each.drone] if x.flight != each.flight]
        pairs.append((each, float(np.mean(values)) if values else math.nan))
    return pairs


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the table. Arguments are those of the process by default."""
    cli = parser(__doc__)
    cli.add_argument("--flights", type=Path, required=True, help="folder of the flights")
    cli.add_argument("--fit", type=Path, help="folder of the flights to fit on")
    cli.add_argument("--json", type=Path, help="file for the figures")
    options = cli.parse_args(arguments)
    flights = flights_in(options.flights)
    if not flights:
        cli.error(f"--flights: {options.flights} holds no bag and no uSD log")
    series = [x for path, flight in flights.items() for x in load_series(path, flight)]
    fits = series
    if options.fit is not None:
        others = flights_in(options.fit)
        fits = [x for path, flight in others.items() for x in load_series(path, flight)]
    figures = write_table(options.output, series, fits)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def write_table(output: Path, series: list[LoadSeries], fits: list[LoadSeries]) -> dict[str, Any]:
    """Print and write the table; return the figures for JSON."""
    lengths = predicted_by_others(series, fits, lambda x: x.length)
    factors = predicted_by_others(series, fits, lambda x: x.commanded / x.static)
    unknown = sum(math.isnan(factor) for _, factor in factors)
    errors = [
        x.commanded / (x.static * (1.0 if math.isnan(factor) else factor)) - 1.0
        for x, factor in factors
    ]
    plain = [x.commanded / x.static - 1.0 for x in series]
    off = [x.length - length for x, length in lengths if not math.isnan(length)]
    filters = Figure.rms([x.filter_rms_deg for x in series])
    seen = Figure.mean([x.logged_share for x in series])
    replayed = Figure.mean([x.replayed_share for x in series])
    length_error, thrust = Figure.rms(off).scaled(1e3), Figure.rms(errors)
    drags = [x.drag for x in series if not math.isnan(x.drag)]
    table = Table(output / "real.md", "What real flights say", LIMITATIONS)
    table.section("", "quantity", "series", "without", "with the model")
    rows: list[tuple[str, int, object, object]] = [
        (
            "error of the attitude [°], rms, relative to the one that forces imply: of the drone's "
            "estimate, and of our filter with the recorded gyroscope and accelerometer",
            filters.n,
            Figure.rms([x.true_tilt_deg for x in series]),
            filters,
        ),
        (
            "fraction of a cable's pull that is detected [%]: by the drone, and by our filter",
            seen.n,
            seen.scaled(100.0),
            replayed.scaled(100.0),
        ),
        (
            "the same with the exported parameters and captured attitudes [%], replayed",
            len(series),
            "",
            Figure.mean([x.exported_share for x in series]).scaled(100.0),
        ),
        (
            "gain of the estimated tilt on acceleration",
            len(series),
            "",
            Figure.mean([x.logged_gain for x in series]),
        ),
        (
            f"thrust command over statics [%], rms; with factors per drone of other flights "
            f"({unknown} series without one)",
            thrust.n,
            Figure.rms(plain).scaled(100.0),
            thrust.scaled(100.0),
        ),
        (
            "cable lengths by other flights [mm], rms",
            length_error.n,
            "",
            length_error,
        ),
        ("rotor drag [N s/m], not modelled", len(drags), Figure.mean(drags), ""),
    ]
    for row in rows:
        table.row(*row)
    table.section("Flights", "flight", "drone", "filter [°]", "pull seen [%]", "cable [m]",
                  "thrust / statics")  # fmt: skip
    for x in series:
        cells = f"{x.length:.4f}", f"{x.commanded / x.static:.3f}"
        share = f"{100.0 * x.logged_share:.0f}"
        table.row(x.flight.name, x.drone, f"{x.filter_rms_deg:.2f}", share, *cells)
    table.note(
        f"standard errors are over the series; filters are compared from {SETTLING:g} s on, "
        f"at about {RATE:g} Hz",
    )
    return {
        "filter_rms_deg": filters.plain,
        "cable_length_rms_mm": length_error.plain,
        "thrust_error": thrust.plain,
        "thrust_without_factors": {"n": unknown},
        "pull_seen": seen.plain,
        "pull_seen_replayed": replayed.plain,
    }


if __name__ == "__main__":
    main()
