"""Recorded flights: contents of files, and drones and vertices on the plan's clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.errors import FileError, InputError, OneLine, optional_module
from hitchopt.lab.flights.stamps import before_the_clock, evened
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array, as_array, counted

# Units of length [m], and names of units in files
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
NAMES = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in", "feet": "ft"}

NEAR_ORIGIN = 0.1  # Largest distance of bodies near the origin [m]
MIN_EPOCH = 1e7  # Smallest time that counts from a date or from a computer's start [s]
MARKER = "marker"  # Name of the rows of unlabeled points

# Quantities of a body other than its measured position, with their units; those with True are in
# the file's unit of length. Attitudes are quaternions x, y, z, w, from the body (x forward, z up)
# to the world; rates and specific forces are in the body's frame; motors are fractions of full
# power
QUANTITIES: dict[str, tuple[str, bool]] = {
    "velocity": ("m/s", True),
    "attitude": ("1", False),
    "estimated_position": ("m", True),
    "estimated_velocity": ("m/s", True),
    "estimated_attitude": ("1", False),
    "commanded_position": ("m", True),
    "commanded_velocity": ("m/s", True),
    "commanded_acceleration": ("m/s²", True),
    "commanded_attitude": ("1", False),
    "commanded_yaw": ("rad", False),
    "rates": ("rad/s", False),
    "specific_force": ("m/s²", False),
    "motors": ("1", False),
    "thrust": ("N", False),
}

library = partial(optional_module, purpose="reading it needs", extra="logs")
"""Return an optional module; UnsupportedError names the extra to install."""

SHIFT_STEP = 0.02  # Between the shifts of clocks that are tried [s]
MAX_SAMPLES = 600  # Samples that are compared
MAX_RESIDUAL = 0.05  # Largest root mean square distance of two records of one motion [m]
# Smallest ratio by which the distance grows at a shift of GAIN_TIME from the best one
MIN_GAIN = 1.2
GAIN_TIME = 0.1  # That shift [s]
MIN_OVERLAP = 0.5  # Smallest fraction of samples at times of both records
MAX_GAP = 0.1  # Largest time to the nearest sample at which a body counts as visible [s]

# Standard error of a vertex that is interpolated across a window, added to its standard deviation
# [m]
INTERPOLATION_ERROR = 1e-2
CORRELATION_TIME = 0.1  # Time between samples with independent errors [s]


def interpolated(times: Array, t: Array, values: Array) -> Array:
    """Return values (times, k) between rows of values (m, k) at times t (m,)."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


@dataclass(frozen=True, eq=False)
class Signal(OneLine):
    """Samples of one of QUANTITIES.

    Attributes
    ----------
    t: (m,) [s], ascending.
    values: (m, k), finite, in the unit of the quantity.
    """

    t: Array
    values: Array

    def __post_init__(self) -> None:
        _check_samples(self, "values", None)

    def at(self, t: Array) -> Array:
        """Return interpolated values (times, k); quaternions are interpolated linearly."""
        return interpolated(t, self.t, self.values)


@dataclass(frozen=True, eq=False)
class Track(OneLine):
    """Positions of a body, or of all markers, while they are visible.

    Attributes
    ----------
    t: (m,) [s], ascending; times of markers repeat.
    positions: (m, 3) [m], finite.
    """

    t: Array
    positions: Array

    def __post_init__(self) -> None:
        _check_samples(self, "positions", 3)

    def at(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return interpolated positions (times, 3) [m], and visibility of the body (times,)."""
        x = interpolated(t, self.t, self.positions)
        i = np.searchsorted(self.t, t)
        gaps = np.abs(self.t[np.clip([i - 1, i], 0, len(self.t) - 1)] - t).min(axis=0)
        step = np.median(np.diff(self.t)) if len(self.t) > 1 else 0.0
        return x, gaps < max(MAX_GAP, step)


def _check_samples(record: Signal | Track, name: str, width: int | None) -> None:
    """Check times (m,) and the rows (m, width) of a field, and make them read-only."""
    values = getattr(record, name)
    t = as_array("t", record.t)
    x = as_array(name, values)
    if t.ndim != 1 or t.size == 0 < np.size(record.t):
        raise InputError("t", record.t, "times (m,) [s]", "specify one per sample")
    columns = x.shape[1] if width is None and x.ndim == 2 else width
    if x.shape != (len(t), columns) or not np.isfinite(np.column_stack([t, x])).all():
        shape = "m, 3" if width else "m, k"
        bound = f"of shape ({shape}) and finite, as are its times, of shape {t.shape}"
        raise InputError(name, values, bound, "specify one row per sample")
    if np.any(np.diff(t) < 0.0):
        raise InputError("t", t, "ascending", "sort the samples")
    for field_name, array in (("t", t), (name, x)):
        array.setflags(write=False)
        object.__setattr__(record, field_name, array)


NO_MARKERS = Track(np.zeros(0), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class RecordedFlight(OneLine):
    """Content of a recording, with the names, the frame and the clock of its file.

    Attributes
    ----------
    source: the file's format, such as ``Motive CSV 1.23``.
    tracks: bodies by their names in the file: drones, and vertices if the file has them.
    markers: unlabeled points, on the clock of ``tracks``.
    setpoints: commanded positions by name, on the clock of the track of that name.
    signals: other quantities by body or load, then by name, see QUANTITIES, on the same clock.
    loads: bodies that are not drones, on the clock of ``tracks``.
    sources: topics by body, then by quantity, ``position`` being that of tracks and loads.
    clock_shifts: time of this flight minus that of the body's own clock [s], of bodies whose
        samples were recorded on separate clocks, and are on one here.
    as_sent: whether setpoints were recorded where they were sent, not logged by the drones.
    epoch: time of the recording's clock at which ``t`` is 0 [s]; 0 if times are as recorded.
    one_clock: whether all tracks share one clock; otherwise each track has its own origin.
    notes: corrections and omissions, a sentence each.
    simulated: of a simulated flight, the cables' ``density`` [kg/m] and whether the controllers
        had ``feed_forward`` and ``integral`` (2n,); empty for a real flight.
    """

    source: str
    tracks: Mapping[str, Track]
    markers: Track = NO_MARKERS
    setpoints: Mapping[str, Track] = field(default_factory=dict)
    signals: Mapping[str, Mapping[str, Signal]] = field(default_factory=dict)
    loads: Mapping[str, Track] = field(default_factory=dict)
    sources: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    clock_shifts: Mapping[str, float] = field(default_factory=dict)
    as_sent: bool = False
    epoch: float = 0.0
    one_clock: bool = True
    notes: tuple[str, ...] = ()
    simulated: Mapping[str, Any] = field(default_factory=dict)

    @property
    def contents(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Topic, number of samples, rate [Hz] and largest gap [s] of each body's quantities."""
        bodies = dict[str, dict[str, dict[str, Any]]]()
        for tracks, quantity in (
            (self.tracks, "position"),
            (self.loads, "position"),
            (self.setpoints, "commanded_position"),
        ):
            for name, track in tracks.items():
                bodies.setdefault(name, {})[quantity] = self._samples(name, quantity, track.t)
        for name, signals in self.signals.items():
            for quantity, signal in signals.items():
                bodies.setdefault(name, {})[quantity] = self._samples(name, quantity, signal.t)
        return bodies

    def _samples(self, body: str, quantity: str, t: Array) -> dict[str, Any]:
        steps = np.diff(t)
        step = float(np.median(steps)) if len(steps) else 0.0
        return {
            "topic": self.sources.get(body, {}).get(quantity, self.source),
            "unit": QUANTITIES[quantity][0] if quantity in QUANTITIES else "m",
            "samples": len(t),
            "rate": 1.0 / step if step > 0.0 else 0.0,
            "largest_gap": float(steps.max()) if len(steps) else 0.0,
            "start": float(t[0]),
            "end": float(t[-1]),
        }


def drones_by_name(names: Mapping[str, str] | str | None) -> Mapping[str, str] | None:
    """Return drones by recorded names, which may be a text such as ``cf231=q0,cf7=r0``."""
    if not isinstance(names, str):
        return names
    pairs = (pair.partition("=") for pair in names.replace(" ", "").split(","))
    return {name: drone for name, _, drone in pairs}


def scale_of(unit: str) -> float:
    """Return a unit of length [m]; FileError if it is unknown."""
    word = unit.strip().casefold()
    scale = UNITS.get(NAMES.get(word, word), 0.0)
    if not scale:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state unit='m', 'cm' or 'mm'")
    return scale


def fitted_shift(
    own: Array, reference: Array, span: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the shift of a record's clock [s], and the remaining distance [m].

    ``own`` and ``reference`` are rows (m, 4) of time [s] and position [m] of one body; own times
    plus the shift, within ``span``, are reference times. None if the records differ, or the body
    moves too little.
    """
    own, reference = (x[np.isfinite(x).all(axis=1)] for x in (own, reference))
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    if len(own) < 2 or len(reference) < 2:
        return None
    own = own[:: max(len(own) // MAX_SAMPLES, 1)]

    def distance(shift: float) -> float:
        t = own[:, 0] + shift
        inside = (t >= reference[0, 0]) & (t <= reference[-1, 0])
        if np.mean(inside) < MIN_OVERLAP:
            return np.inf
        at = interpolated(t[inside], reference[:, 0], reference[:, 1:])
        squares = np.sum((own[inside, 1:] - at) ** 2, axis=1)
        return float(np.sqrt(np.mean(np.minimum(squares, np.quantile(squares, 0.95)))))

    shifts = np.arange(span[0], span[1] + SHIFT_STEP, SHIFT_STEP)
    distances = np.array([distance(shift) for shift in shifts.tolist()])
    best = float(shifts[np.argmin(distances)])
    step = SHIFT_STEP
    while step > 1e-4:
        step *= 0.5
        best = min((best - step, best, best + step), key=distance)
    residual = distance(best)
    nearby = min(distance(best - GAIN_TIME), distance(best + GAIN_TIME))
    if not residual < MAX_RESIDUAL or not nearby > MIN_GAIN * residual + 1e-6:
        return None
    return best, residual


class Logged(NamedTuple):
    """Rows (m, 1 + k) of time [s] and a quantity, in any order, and their topic."""

    rows: Array
    topic: str = ""


Content = Mapping[str, Mapping[str, Logged]]
"""Quantities by body, then by name: ``position``, or one of QUANTITIES."""


def positions_of(rows: Mapping[str, Array]) -> Content:
    """Return bodies of which only positions are known, from rows (m, 4) by name."""
    return {name: {"position": Logged(samples)} for name, samples in rows.items()}


@dataclass(frozen=True)
class _Units:
    """Conversion of a file's rows to metres and to times from the recording's start.

    Attributes
    ----------
    length: the file's unit of length [m].
    epoch: the file's time at which times are 0 [s].
    """

    length: float
    epoch: float

    def track(self, rows: Array) -> Track:
        """Return positions from rows (m, 4) with distinct ascending times."""
        return Track(rows[:, 0] - self.epoch, self.length * rows[:, 1:])

    def signal(self, quantity: str, rows: Array) -> Signal:
        """Return one of QUANTITIES from rows (m, 1 + k) with distinct ascending times."""
        _, has_length = QUANTITIES[quantity]
        unit = self.length if has_length else 1.0
        return Signal(rows[:, 0] - self.epoch, unit * rows[:, 1:])


def flight_of(
    source: str,
    bodies: Content,
    unit: str = "m",
    *,
    loads: Content | None = None,
    notes: Sequence[str] = (),
    **fields: Any,
) -> RecordedFlight:
    """Return a flight of bodies, of points named MARKER, and of loads, with lengths in a unit.

    Positions of bodies are in order of time. ``fields`` are others of ``RecordedFlight``. Rows
    without a value, before a clock begins, of lost bodies, and that repeat a time are omitted.
    Times of late samples are evened out where a rate fits (``stamps``). Raises FileError for an
    unknown unit or descending times.
    """
    notes = list(notes)
    bodies, loads, clock_notes = _on_a_clock(bodies, loads or {})
    notes += clock_notes
    drones = {name: own for name, own in bodies.items() if name != MARKER}
    length_unit = scale_of(unit)
    lost = 0
    recorded = dict[str, Array]()
    for name, own in drones.items():
        rows = own["position"].rows
        is_lost = _is_lost(rows, length_unit)
        lost += int(np.sum(is_lost))
        if not np.all(is_lost):
            recorded[name] = rows[~is_lost]
    if lost:
        notes.append(
            f"{counted(lost, 'sample')} omitted: x = y = z = 0, as drivers publish lost bodies"
        )
    recorded, late_times, late_notes = _evened_out(recorded)
    notes += late_notes
    units = _Units(length_unit, _epoch(recorded) if fields.get("one_clock", True) else 0.0)
    if units.epoch:
        clock = f"at {units.epoch:.3f} s of the recording's clock"
        notes.append(f"times start at the first position, {clock}")
    tracks = {name: units.track(_in_recorded_order(rows)) for name, rows in recorded.items()}
    count = sum(map(len, recorded.values()))
    if omitted := count - sum(len(track.t) for track in tracks.values()):
        notes.append(f"{omitted} of {count} rows omitted: no position, or a repeated time")
    cloud = bodies[MARKER]["position"].rows if MARKER in bodies else np.zeros((0, 4))
    cloud = cloud[~np.isin(cloud[:, 0], late_times)]  # these may be of several frames
    signals = _signals(drones, units, apart=("position", "commanded_position"))
    sources = {
        name: topics for name, own in {**drones, **loads}.items() if (topics := _topics(own))
    }
    return RecordedFlight(
        source,
        {name: track for name, track in tracks.items() if len(track.t)},
        units.track(_sorted(cloud)),
        _tracks(drones, "commanded_position", units),
        signals | _signals(loads, units, apart=("position",)),
        _tracks(loads, "position", units),
        sources,
        epoch=units.epoch,
        notes=tuple(notes),
        **fields,
    )


def _on_a_clock(bodies: Content, loads: Content) -> tuple[Content, Content, list[str]]:
    """Return bodies and loads without rows that precede their clocks, and notes."""
    counts = list[int]()

    def begun(logged: Logged, *, repeats: bool) -> Logged:
        early = before_the_clock(logged.rows[:, 0], repeats=repeats)
        counts.append(early)
        return logged._replace(rows=logged.rows[early:])

    def all_begun(content: Content) -> Content:
        return {
            name: {each: begun(logged, repeats=name == MARKER) for each, logged in own.items()}
            for name, own in content.items()
        }

    begun_bodies, begun_loads = all_begun(bodies), all_begun(loads)
    early = f"{counted(sum(counts), 'row')} omitted: their time is 0, before a clock began"
    return begun_bodies, begun_loads, [early] * any(counts)


def _evened_out(recorded: Mapping[str, Array]) -> tuple[dict[str, Array], Array, list[str]]:
    """Return rows (m, 4) of bodies with late times evened out where a rate fits.

    Then follow the times at which rows were late, and notes.
    """
    rows_by_name = dict(recorded)
    late_times = [np.zeros(0)]
    irregular = list[str]()
    by_note = defaultdict[str, list[str]](list)
    for name, rows in recorded.items():
        seen = rows[np.isfinite(rows).all(axis=1)]
        seen = seen[np.any(np.diff(seen, axis=0, prepend=np.nan) != 0.0, axis=1)]
        if np.any(np.diff(seen[:, 0]) < 0.0):
            continue  # refused where rows are put in order
        stamps = evened(seen[:, 0])
        if stamps.irregular:
            irregular.append(f"{name} ({stamps.irregular:.0%})")
        if np.any(stamps.late):
            rows_by_name[name] = np.column_stack([stamps.t, seen[:, 1:]])
            late_times.append(seen[stamps.late, 0])
            delay = float(np.max(seen[:, 0] - stamps.t))
            late = f"{np.mean(stamps.late):.1%} of its samples are stamped up to {delay:.2g} s late"
            by_note[f"{late}, as at receipt: evened out to {stamps.rate:.4g} Hz"].append(name)
    notes = [f"{', '.join(names)}: {note}" for note, names in by_note.items()]
    if irregular:
        words = "intervals are irregular and no rate fits; times are as stamped"
        notes.append(f"{', '.join(irregular)}: {words}")
    return rows_by_name, np.concatenate(late_times), notes


def _is_lost(rows: Array, unit: float) -> NDArray[np.bool_]:
    """Return whether positions of a body (m, 4), of lengths in a unit [m], are those of a lost one.

    These are exactly zero. A body that was near the origin before or after may really be there.
    """
    is_zero: NDArray[np.bool_] = np.all(rows[:, 1:] == 0.0, axis=1)
    seen = np.flatnonzero(~is_zero & np.isfinite(rows).all(axis=1))
    if not len(seen):
        return is_zero
    after = np.searchsorted(seen, np.arange(len(rows)))
    neighbours = np.stack([np.maximum(after - 1, 0), np.minimum(after, len(seen) - 1)])
    distances = unit * np.linalg.norm(rows[seen[neighbours], 1:], axis=-1)
    is_far: NDArray[np.bool_] = np.all(distances > NEAR_ORIGIN, axis=0)
    return is_zero & is_far


def _epoch(recorded: Mapping[str, Array]) -> float:
    """Return the first time [s] if times count from a date or from a computer's start, else 0."""
    start = min((float(rows[0, 0]) for rows in recorded.values()), default=0.0)
    return start if abs(start) >= MIN_EPOCH else 0.0


def _tracks(content: Content, quantity: str, units: _Units) -> dict[str, Track]:
    """Return tracks by body from positions in any order."""
    rows = {name: _ordered(own[quantity].rows) for name, own in content.items() if quantity in own}
    return {name: units.track(own) for name, own in rows.items() if len(own)}


def _signals(
    content: Content, units: _Units, apart: Collection[str]
) -> dict[str, dict[str, Signal]]:
    """Return signals by body and quantity, except for quantities that are ``apart``."""
    signals = defaultdict[str, dict[str, Signal]](dict)
    for name, own in content.items():
        for quantity, logged in own.items():
            rows = _ordered(logged.rows)
            if quantity.endswith("attitude"):  # Lost bodies have quaternions of zeros
                rows = rows[np.any(rows[:, 1:] != 0.0, axis=1)]
            if quantity not in apart and len(rows):
                signals[name][quantity] = units.signal(quantity, rows)
    return dict(signals)


def _topics(own: Mapping[str, Logged]) -> dict[str, str]:
    """Return the topics of a body's quantities that have one."""
    return {quantity: logged.topic for quantity, logged in own.items() if logged.topic}


def _in_recorded_order(rows: Array) -> Array:
    """Return rows with a value and a new time; FileError for times that descend."""
    if not np.isfinite(rows[:, 0]).all():
        raise FileError("a time is not finite; omit rows without a time")
    rows = rows[np.isfinite(rows).all(axis=1)]
    steps = np.diff(rows[:, 0], prepend=-np.inf)
    if np.any(steps < 0.0):
        descent = int(np.argmax(steps < 0.0))
        earlier = rows[descent - 1, 0]
        later = rows[descent, 0]
        digits = next((n for n in range(9, 17) if f"{earlier:.{n}g}" != f"{later:.{n}g}"), 17)
        times = f"{earlier:.{digits}g} s is followed by {later:.{digits}g} s"
        remedy = "specify one flight, in the order in which it was recorded"
        raise FileError(f"times do not increase: {times}; {remedy}")
    return rows[steps > 0.0]


def _sorted(rows: Array) -> Array:
    """Return finite rows in order of time."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows[np.argsort(rows[:, 0], kind="stable")]


def _ordered(rows: Array) -> Array:
    """Return finite rows in order of time, the first of each time."""
    rows = _sorted(rows)
    return rows[np.diff(rows[:, 0], prepend=-np.inf) > 0.0]


@dataclass(frozen=True, eq=False)
class Recording(OneLine):
    """Measured positions over time.

    Attributes
    ----------
    t: (samples,) [s], ascending, from the plan's start.
    drones: (samples, 2n, 3) [m], in the order q0, r0, q1, …; nan if not visible.
    vertices: (samples, points, 3) [m]; nan if not visible. A chain's ends are its drones.
    density: of the cables [kg/m], if the flight is simulated.
    feed_forward, integral: whether the drones' controllers had these (2n,), if it is simulated.
    standard_errors: of the vertices (samples, points) [m]; None if unknown.
    notes: corrections of the reader.
    """

    t: Array
    drones: Array
    vertices: Array
    density: float | None = None
    feed_forward: NDArray[np.bool_] | None = None
    integral: NDArray[np.bool_] | None = None
    standard_errors: Array | None = None
    notes: tuple[str, ...] = ()


def plan_at(task: TeamTask, t: ArrayLike, values: Array) -> Array:
    """Return a plan's values (samples, …) at times [s] from its start, constant beyond its ends."""
    times = task.states.t[0] + np.clip(t, 0.0, task.duration)
    curve: Array = make_interp_spline(task.states.t, values, k=1)(times)
    return curve


def taut_at(task: TeamTask, t: Array) -> NDArray[np.bool_]:
    """Return whether the plan's hitch is taut at times (…) [s] from its start."""
    taut = task.states.taut(task.team.tension)
    return plan_at(task, t, taut.astype(np.float64)) > 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows (W,) in which the plan's hitch is taut and all drones are visible."""

    t: Array  # (W,) [s], mean time of the samples
    drones: Array  # (W, 2n, 3) [m]
    # (W, points, 3) [m]; displacements of vertices that are not visible are interpolated over time
    vertices: Array
    visible: NDArray[np.bool_]  # (W, points), vertices that are visible in half of a window
    errors: Array  # (W, points) [m], standard errors of the vertices
    positions: Array  # (W, 2n, 3) [m], planned setpoints
    planned: Array  # (W, points, 3) [m], planned vertices
    cable_forces: Array  # planned forces on drones (W, 2n, 3) [N]
    tensions: Array  # planned (W, n) [N]


def windows_of(recording: Recording, task: TeamTask, size: float) -> Windows:
    """Return means over windows of a size [s].

    A window is used if every drone, and half of the vertices, are visible in half of it. Deviations
    from the plan are averaged and added to the plan's means, so that gaps do not bias a movement.
    """
    t, standard_errors = recording.t, recording.standard_errors
    window = np.floor(t / size)
    windows, sizes = np.unique(window, return_counts=True)
    needed = max(0.5 * float(np.median(sizes)), 1.0) if len(t) else 1.0
    usable = taut_at(task, t) & (t >= 0.0)
    member = ((windows[:, None] == window) & usable).astype(np.float64)  # (windows, samples)
    count = np.sum(member, axis=1)

    def mean(values: Array) -> Array:
        return np.tensordot(member / np.maximum(count, 1.0)[:, None], values, 1)

    def deviations(positions: Array, plan: Array) -> tuple[Array, Array]:
        """Return mean deviations (windows, items, 3), and numbers of samples (windows, items)."""
        finite = np.all(np.isfinite(positions), axis=2)
        off = np.where(finite[..., None], positions - plan_at(task, t, plan), 0.0)
        counts = member @ finite
        return np.tensordot(member, off, 1) / np.maximum(counts, 1.0)[..., None], counts

    drones, drone_counts = deviations(recording.drones, task.states.positions)
    off, counts = deviations(recording.vertices, task.states.vertices)
    visible = counts >= needed
    chosen = np.all(drone_counts >= needed, axis=1) & (count >= needed)
    chosen &= 2 * np.sum(visible, axis=1) >= visible.shape[1]
    middle = mean(t)
    squares = np.zeros(recording.vertices.shape[:2])
    if standard_errors is not None:
        squares = np.nan_to_num(standard_errors) ** 2
    independent = np.maximum(counts / (2.0 * needed) * size / CORRELATION_TIME, 1.0)
    errors = np.sqrt(member @ squares / np.maximum(counts, 1.0) / independent)
    for k in range(visible.shape[1]):
        known = visible[:, k] & chosen
        missing = ~visible[:, k]
        spread = 0.0
        interpolated = np.zeros(3)
        if np.any(known):
            interpolated = Track(middle[known], off[known, k]).at(middle[missing])[0]
            spread = float(np.linalg.norm(np.std(off[known, k], axis=0)))
        off[missing, k] = interpolated
        errors[missing, k] = np.hypot(INTERPOLATION_ERROR, spread)
    names = ("positions", "vertices", "cable_forces", "tensions")
    plan = [mean(plan_at(task, t, getattr(task.states, name))) for name in names]
    values: Any = (middle, plan[0] + drones, plan[1] + off, visible, errors, *plan)
    return Windows(*(each[chosen] for each in values))
