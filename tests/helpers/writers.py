"""Writers of recordings in the formats of motion capture systems and flight logs."""

from __future__ import annotations

import csv
import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
from rosbags import rosbag1, rosbag2, typesys
from scipy.spatial.transform import Rotation

from hitchopt.lab.flights.bags import CRAZYFLIES, MESSAGES, POSE
from hitchopt.lab.flights.recordings import RecordedFlight, Signal, Track
from hitchopt.values import Array, Indices

EPOCH = 1_762_186_375  # start of bags [s]


def frames_of(flight: RecordedFlight) -> Array:
    """Return the times at which anything is recorded."""
    return np.unique(np.concatenate([flight.markers.t, *(x.t for x in flight.tracks.values())]))


def dense(t: Array, track: Track) -> Array:
    """Return positions (frames, 3) [m] at times; nan where not visible."""
    places = np.full((len(t), 3), np.nan)
    places[np.searchsorted(t, track.t)] = track.positions
    return places


def columns_of(t: Array, cloud: Track, lifetime: int = 20) -> dict[str, Array]:
    """Return columns of unlabeled markers, whose names change after ``lifetime`` frames."""
    columns: dict[str, Array] = {}
    for frame, time in enumerate(np.unique(cloud.t)):
        for k, place in enumerate(cloud.positions[cloud.t == time]):
            name = f"{1000 + 100 * (frame // lifetime) + k}"
            columns.setdefault(name, np.full((len(t), 3), np.nan))[np.searchsorted(t, time)] = place
    return columns


def texts(values: Array, blank: str = "") -> list[str]:
    return [blank if np.isnan(x) else f"{x:.6f}" for x in values]


def write_motive(
    path: Path,
    flight: RecordedFlight,
    version: str = "1.23",
    rate: float = 100.0,
    unit: tuple[str, float] = ("Millimeters", 1e-3),
    space: str = "Global",
    separator: str = ",",
) -> Path:
    """Write a table of Motive: bodies with their markers, and columns of unlabeled markers."""
    t, columns = frames_of(flight), list[tuple[str, str, str, str, Array]]()

    def add(
        kind: str, name: str, values: Array, quantity: str = "Position", axes: str = "XYZ"
    ) -> None:
        columns.extend((kind, name, quantity, *each) for each in zip(axes, values.T, strict=True))

    for name, track in flight.tracks.items():
        places = dense(t, track)
        add("Rigid Body", name, np.tile(0.0 * places[:, :1], 4), "Rotation", "XYZW")
        add("Rigid Body", name, places / unit[1])
        add("Rigid Body", name, 0.0 * places[:, :1], "Mean Marker Error", " ")
        add("Rigid Body Marker", f"{name}:Marker1", (places + 0.03) / unit[1])
        add("Marker", f"{name}:Marker1", (places + 0.031) / unit[1])
    for name, places in columns_of(t, flight.markers).items():
        add("Marker", f"Unlabeled {name}", places / unit[1])
    *titles, values = zip(*columns, strict=True)
    kinds, names, quantities, axes = map(list, titles)
    timecode = ["TimeCode"] if version >= "1.24" else []
    heads = {"Type": kinds, "Name": names, "ID": names}
    heads |= {"Parent": names} if version >= "1.25" else {}
    number = version if separator == "," else version.replace(".", ",")
    rows = [
        ["Format Version", number, "Take Name", "Take, 1", "Export Frame Rate", f"{rate:.6f}"]
        + ["Length Units", unit[0], "Coordinate Space", space],
        [],
        *(["", "" if version == "1.21" else x, *timecode, *own] for x, own in heads.items()),
        ["", "", *timecode, *quantities],
        ["Frame", "Time (Seconds)", *timecode, *(axis.strip() for axis in axes)],
    ]
    for time, row in zip(t, np.stack(values, axis=1), strict=True):
        first_cells = [str(round((time - t[0]) * rate)), f"{int(1000 * time + 1e-6) / 1000:.6f}"]
        cells = [*first_cells, *(["15:26:46:12.02"] * len(timecode)), *texts(row)]
        rows.append(cells if separator == "," else [cell.replace(".", ",") for cell in cells])
    text = io.StringIO()
    csv.writer(text, delimiter=separator, lineterminator="\r\n").writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8-sig", newline="")
    return path


def write_vicon(path: Path, flight: RecordedFlight, rate: float = 100.0) -> Path:
    """Write sections of bodies and of markers; missing values are zero."""
    t, sections = frames_of(flight), []
    bodies = {
        name if ":" in name else f"{name}:{name}": dense(t, track)
        for name, track in flight.tracks.items()
    }
    points = {f"*{name}": places for name, places in columns_of(t, flight.markers).items()}
    for title, columns, angles in (("Objects", bodies, 3), ("Trajectories", points, 0)):
        axes = "RX,RY,RZ,TX,TY,TZ" if angles else "X,Y,Z"
        lines = [title, f"{rate:g}", ",," + "".join(f"{x},,,{',' * angles}" for x in columns)]
        lines.append(",".join(["Frame", "Sub Frame", *([axes] * len(columns))]))
        lines.append(",," + ",".join((["rad"] * angles + ["mm"] * 3) * len(columns)))
        for i, time in enumerate(t):
            cells = [["0"] * angles + texts(1e3 * x[i], "0") for x in columns.values()]
            row = [str(round(time * rate)), "0", *(cell for own in cells for cell in own)]
            lines.append(",".join(row))
        sections.append("\n".join(lines))
    path.write_text("\n\n".join(sections) + "\n", encoding="utf-8")
    return path


def write_c3d(
    path: Path, flight: RecordedFlight, units: Sequence[str] = ("mm",), rate: float = 100.0
) -> Path:
    """Write a C3D file in millimetres, with one point for each body."""
    t, file = frames_of(flight), ezc3d.c3d()
    columns = {name: dense(t, track) for name, track in flight.tracks.items()}
    columns |= {f"*{name}": places for name, places in columns_of(t, flight.markers).items()}
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [rate], list(units)
    point["LABELS"]["value"] = list(columns)
    places = np.zeros((3, 0, 1))
    if columns:
        places = 1e3 * np.stack(list(columns.values()), axis=0).transpose(2, 0, 1)
    file["data"]["points"] = np.concatenate([places, np.ones((1, *places.shape[1:]))])
    file.write(str(path))
    return path


def write_qualisys(
    path: Path, flight: RecordedFlight, *, bodies: bool = False, titles: bool = True
) -> Path:
    """Write a TSV table of markers, or of rigid bodies, in millimetres; missing ones are zero."""
    t = frames_of(flight)
    columns = {name: dense(t, track) for name, track in flight.tracks.items()}
    if not bodies:
        columns |= {f"unlabeled {x}": places for x, places in columns_of(t, flight.markers).items()}
    kind = "BODY_NAMES" if bodies else "MARKER_NAMES"
    turns = ["Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))] * bodies
    head = [
        ["NO_OF_FRAMES", str(len(t))], ["NO_OF_CAMERAS", "8"], ["NO_OF_ITEMS", str(len(columns))],
        ["FREQUENCY", "100"], ["NO_OF_ANALOG", "0"], ["ANALOG_FREQUENCY", "0"],
        ["DESCRIPTION", "--"], ["TIME_STAMP", "2026-11-28, 10:31:02.415", "1234.56789012"],
        ["DATA_INCLUDED", "6D" if bodies else "3D"], [kind, *columns],
    ]  # fmt: skip
    if not bodies:
        head.append(["TRAJECTORY_TYPES", *["Measured"] * len(columns)])
    if titles:
        head.append(["Frame", "Time", *(f"{x} {c}" for x in columns for c in [*"XYZ", *turns])])
    lines = ["\t".join(cells) for cells in head]
    for i, time in enumerate(t):
        cells = [str(i + 1), f"{time:.5f}"] if titles else []
        for places in columns.values():
            cells += [*texts(1e3 * places[i], "0.000"), *["0.000"] * len(turns)]
        lines.append("\t".join(cells))
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
    return path


def write_csv(path: Path, flight: RecordedFlight, separator: str = ",") -> Path:
    """Write a plain table, sorted by time; points without a name are called ``marker``."""
    lines = []
    for name, track in [*flight.tracks.items(), ("marker", flight.markers)]:
        for t, place in zip(track.t.tolist(), track.positions.tolist(), strict=True):
            cells = separator.join([repr(t), name, *map(repr, place)])
            lines.append((t, cells if separator == "," else cells.replace(".", ",")))
    rows = [cells for _, cells in sorted(lines, key=lambda line: line[0])]
    path.write_text("\n".join([separator.join(["t", "name", "x", "y", "z"]), *rows, ""]), "utf-8")
    return path


def write_cfclient(folder: Path, flight: RecordedFlight) -> Path:
    """Write a log of cfclient for every drone."""
    folder.mkdir()
    for name, track in flight.tracks.items():
        groups = {"stateEstimate": track}
        groups |= {"ctrltarget": flight.setpoints[name]} if name in flight.setpoints else {}
        lines = [
            ",".join(["Timestamp", *(f"{group}.{axis}" for group in groups for axis in "xyz")])
        ]
        for i, t in enumerate(track.t.tolist()):
            places = np.concatenate([each.positions[i] for each in groups.values()]).tolist()
            lines.append(",".join([repr(1e3 * t), *map(repr, places)]))
        (folder / f"{name}.csv").write_text("\n".join([*lines, ""]), "utf-8")
    return folder


def write_tum(
    folder: Path, flight: RecordedFlight, head: str = "# timestamp tx ty tz qx qy qz qw\n"
) -> Path:
    """Write a trajectory of TUM's benchmark for every body."""
    folder.mkdir()
    for name, track in flight.tracks.items():
        rows = zip(track.t.tolist(), track.positions.tolist(), strict=True)
        lines = [" ".join([*map(repr, (t, *place)), "0 0 0 1"]) for t, place in rows]
        (folder / f"{name}.txt").write_text(head + "\n".join([*lines, ""]), "utf-8")
    return folder


Stream = tuple[str, str, RecordedFlight]
"""Topic with ``*`` in place of bodies' names, type of its messages, and the bodies' positions."""

POSE_ARRAY, TRANSFORMS, ODOMETRY = f"{POSE}Array", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"


def write_bag(
    path: Path,
    flight: RecordedFlight,
    kind: str = "sqlite3",
    bodies: tuple[str, str] = ("/poses", POSE_ARRAY),
    others: Sequence[Stream] = (),
    delay: float = 0.015,
    parents: Mapping[str, str] | None = None,
) -> Path:
    """Write a bag with ``/pointCloud``, a topic and message type of ``bodies``, and others.

    ``kind`` is sqlite3 (without definitions of types, as Humble's), mcap or ros1. Every other cloud
    arrives after ``delay`` [s]; without a delay messages have no stamp. ``parents`` are frames by
    body, else the world. Others are written first.
    """
    ros1 = kind == "ros1"
    store = typesys.get_typestore(typesys.Stores["ROS1_NOETIC" if ros1 else "ROS2_HUMBLE"])
    for name, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, name))

    def ros(name: str, *values: Any) -> Any:
        return store.types[name if "/msg/" in name else f"geometry_msgs/msg/{name}"](*values)

    def header(t: float, frame: str = "world") -> Any:
        nanoseconds = round(1e9 * (EPOCH + t)) if delay else 0
        stamp = ros("builtin_interfaces/msg/Time", *divmod(nanoseconds, 10**9))
        return ros("std_msgs/msg/Header", *[0] * ros1, stamp, frame)

    def pose(place: Sequence[float]) -> Any:
        return ros("Pose", ros("Point", *place), ros("Quaternion", *[np.nan] * 4))

    def stamped(type_: str, t: float, name: str, place: Sequence[float]) -> Any:
        head, uncertain = header(t, (parents or {}).get(name, "world")), np.zeros(36)
        if type_ == "TransformStamped":
            rotation = ros("Quaternion", 0.0, 0.0, 0.0, 1.0)
            return ros(type_, head, name, ros("Transform", ros("Vector3", *place), rotation))
        if type_ == "PoseStamped":
            return ros(type_, head, pose(place))
        with_covariance = ros("PoseWithCovariance", pose(place), uncertain)
        if type_ == "PoseWithCovarianceStamped":
            return ros(type_, head, with_covariance)
        twist = ros("Twist", *[ros("Vector3", 0.0, 0.0, 0.0)] * 2)
        velocity = ros("TwistWithCovariance", twist, uncertain)
        return ros(type_, head, f"{name}/base_link", with_covariance, velocity)

    messages: list[tuple[float, str, Any]] = []
    for topic, type_, source in [*others, (*bodies, flight)]:
        for t in np.unique([t for x in source.tracks.values() for t in x.t.tolist()]).tolist():
            positions = [
                (name, x.positions[x.t == t].tolist()) for name, x in source.tracks.items()
            ]
            visible = [(name, place[0]) for name, place in positions if place]
            if type_ == POSE_ARRAY:
                named = [ros(POSE, name, pose(place)) for name, place in visible]
                messages.append((t, topic, ros(type_, header(t), named)))
            elif type_ == TRANSFORMS:
                each = [stamped("TransformStamped", t, name, place) for name, place in visible]
                messages.append((t, topic, ros(type_, each)))
            else:
                messages += [
                    (t, topic.replace("*", name), stamped(type_, t, name, place))
                    for name, place in visible
                ]
    fields = [ros("sensor_msgs/msg/PointField", x, 4 * i, 7, 1) for i, x in enumerate("xyz")]
    for i, t in enumerate(np.unique(flight.markers.t).tolist()):
        points = flight.markers.positions[flight.markers.t == t].astype("<f4")
        data, count = np.frombuffer(points.tobytes(), np.uint8), len(points)
        arguments = header(t), 1, count, fields, False, 12, 12 * count, data, True
        cloud = ros("sensor_msgs/msg/PointCloud2", *arguments)
        messages.append((t + delay * (i % 2), "/pointCloud", cloud))
    return write_messages(path, messages, kind, store)


def write_messages(
    path: Path, messages: Sequence[tuple[float, str, Any]], kind: str, store: Any
) -> Path:
    """Write messages with their times of arrival [s] from the start and their topics."""
    writer: Any = (
        rosbag1.Writer(path)
        if kind == "ros1"
        else rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin[kind.upper()])
    )
    serialize = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
    with writer as bag:
        streams: dict[str, Any] = {}
        for t, topic, message in sorted(messages, key=lambda each: each[0]):
            name = message.__msgtype__
            if topic not in streams:
                streams[topic] = bag.add_connection(topic, name, typestore=store)
            bag.write(streams[topic], round(1e9 * (EPOCH + t)), bytes(serialize(message, name)))
    return path


def write_usd(
    folder: Path,
    flight: RecordedFlight,
    version: int = 2,
    group: str = "stateEstimateZ.",
    others: Mapping[str, RecordedFlight] | None = None,
    axes: str = "xyz",
) -> Path:
    """Write a log for every drone, with other events between positions.

    Variables are those of ``group`` with ``axes``, of setpoints, and of ``others``, which have the
    same times.
    """
    folder.mkdir()
    head, ticks = ("<HI", 1e3) if version == 1 else ("<HQ", 1e6)
    for name, track in flight.tracks.items():
        groups = {group: track}
        groups |= {"ctrltargetZ.": flight.setpoints[name]} if name in flight.setpoints else {}
        groups |= {prefix: other.tracks[name] for prefix, other in (others or {}).items()}
        kinds = ["h" if "Z." in prefix else "f" for prefix in groups]
        axes_of = [axes if prefix == group else "xyz" for prefix in groups]
        variables = [
            f"{prefix}{axis}({kind})"
            for prefix, kind, own_axes in zip(groups, kinds, axes_of, strict=True)
            for axis in own_axes
        ]
        data = struct.pack("<BHH", 0xBC, version, 2)
        for number, names in ((0xFFFF, variables), (7, ["source(B)", "d(e)"])):
            data += struct.pack("<H", number) + b"event\0" + struct.pack("<H", len(names))
            data += b"".join(x.encode() + b"\0" for x in names)
        types = head + "".join(3 * kind for kind in kinds)
        for i, t in enumerate(track.t):
            values: list[float] = []
            for kind, each in zip(kinds, groups.values(), strict=True):
                place = each.positions[i].tolist()
                values += [round(1e3 * x) for x in place] if kind == "h" else place
            data += struct.pack(types, 0xFFFF, round(t * ticks), *values)
            data += struct.pack(f"{head}Be", 7, round(t * ticks), 3, 0.5) if i % 3 == 0 else b""
        (folder / f"{name}.bin").write_bytes(data + struct.pack("<I", zlib.crc32(data)))
    return folder


def write_ulog(
    folder: Path,
    flight: RecordedFlight,
    topic: str = "vehicle_visual_odometry",
    valid: Mapping[str, Any] | None = None,
    others: Mapping[str, RecordedFlight] | None = None,
) -> Path:
    """Write a ulog for every drone, in axes north, east, down.

    ``valid`` are flags of level position and height by drone (m, 2), ``others`` flights by topic.
    """
    folder.mkdir()
    flags_format = "bool xy_valid;bool z_valid;" if valid else ""
    for name in flight.tracks:
        topics = {topic: flight, **(others or {})}
        heads, samples = [(b"B", bytes(40))], list[tuple[bytes, bytes]]()
        for number, (own_topic, source) in enumerate(topics.items(), 1):
            is_odometry = own_topic.endswith("odometry")
            axes = "float[3] position;" if is_odometry else "float x;float y;float z;"
            fields = f"{own_topic}:uint64_t timestamp;{axes}{flags_format}"
            heads.append((b"F", fields.encode()))
            samples.append((b"A", struct.pack("<BH", 0, number) + own_topic.encode()))
            track = source.tracks[name]
            for i, (t, (x, y, z)) in enumerate(zip(track.t, track.positions, strict=True)):
                flags = bytes(valid[name][i].tolist()) if valid else b""
                place = struct.pack("<HQfff", number, round(1e6 * t), y, x, -z)
                samples.append((b"D", place + flags))
        messages = [*heads, *samples, (b"O", struct.pack("<H", 250))]
        data = b"".join(struct.pack("<Hc", len(x), kind) + x for kind, x in messages)
        header = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        (folder / f"{name}.ulg").write_bytes(header + data)
    return folder


def sample(seed: int = 0, drones: int = 4, frames: int = 60, visible_share: float = 0.9) -> Any:
    """Return a flight at 100 Hz on a millimetre grid, with gaps in bodies, and with markers."""
    rng, t = np.random.default_rng(seed), np.arange(frames) / 100.0
    tracks, waves = {}, 0.3 * np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    for k in range(drones):
        visible = (rng.random(frames) < visible_share) | (np.arange(frames) % (frames - 1) == 0)
        places = np.round([0.7 * k - 1.0, 0.4, 1.2] + waves, 3)
        tracks[f"cf{k + 3}"] = Track(t[visible], places[visible])
    frame: Indices = np.repeat(np.arange(frames), rng.integers(0, 5, frames))
    points = np.round(rng.uniform(-1.0, 1.0, (len(frame), 3)), 3)
    return RecordedFlight("sample", tracks, Track(t[frame], points))


def rich_sample(drones: int = 3, seconds: float = 8.0, rate: float = 100.0) -> RecordedFlight:
    """Return a flight with every quantity that logs and bags hold, and a load that moves."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    rise = np.clip((t - 1.0) / 2.0, 0.0, 1.0)
    wave = np.stack([0.3 * np.sin(t), 0.2 * np.cos(1.3 * t), rise], axis=1)
    tracks, setpoints, signals = {}, {}, {}
    for k in range(drones):
        name, angles = f"cf{k + 3}", np.stack([0.1 * np.sin(t + k), 0.2 * np.cos(t), 0.3 * t], 1)
        attitude = Rotation.from_euler("xyz", angles).as_quat()
        tracks[name] = Track(t, wave + [0.8 * k, 0.1, 0.05])
        setpoints[name] = Track(t, wave + [0.8 * k, 0.0, 0.0])
        values = {
            "attitude": attitude,
            "estimated_position": tracks[name].positions + 0.002,
            "estimated_velocity": np.gradient(wave, t, axis=0),
            "estimated_attitude": Rotation.from_euler("xyz", angles + 0.02).as_quat(),
            "commanded_velocity": np.gradient(wave, t, axis=0),
            "commanded_acceleration": 0.1 * wave,
            "commanded_yaw": angles[:, 2:],
            "rates": np.gradient(angles, t, axis=0),
            "specific_force": wave + [0.0, 0.0, 9.81],
            "motors": np.stack([0.5 + 0.01 * (k + i) + 0.1 * rise for i in range(4)], axis=1),
            "thrust": 0.3 + 0.01 * rise[:, None],
        }
        signals[name] = {quantity: Signal(t, each) for quantity, each in values.items()}
    loads = {"load": Track(t, wave + [0.4, 0.3, 0.0])}
    return RecordedFlight("sample", tracks, setpoints=setpoints, signals=signals, loads=loads)


LOGS: Any = (("pos", "estimated_position", 1.0), ("pwm", "motors", 65535.0))


def write_crazyswarm(
    path: Path,
    flight: RecordedFlight,
    kind: str = "ros1",
    delay: float = 1.65,
    *,
    epoch: float = EPOCH,
    logs: Any = LOGS,
) -> Path:
    """Write a bag of crazyswarm or, for sqlite3, crazyswarm2, with what ``flight`` holds.

    Logs of position and motors are stamped by a clock of each drone and arrive after ``delay`` [s].
    Commands are full states if there are commanded velocities. The bag starts at ``epoch`` [s].
    """
    ros1 = kind == "ros1"
    store = typesys.get_typestore(typesys.Stores["ROS1_NOETIC" if ros1 else "ROS2_HUMBLE"])
    package, log = ("crazyswarm", "GenericLogData") if ros1 else (CRAZYFLIES[-1], "LogDataGeneric")
    texts_of = {name.rpartition("/")[2]: text for name, text in MESSAGES.items()}
    texts_of["GenericLogData"] = "std_msgs/Header header\nfloat64[] values\n"
    types = {f"{package}/msg/{name}": texts_of[name] for name in ("Position", "FullState", log)}
    types[TRANSFORMS] = "geometry_msgs/TransformStamped[] transforms\n"
    for name in types.keys() - store.types.keys():
        store.register(typesys.get_types_from_msg(types[name], name))

    def ros(name: str, *values: Any) -> Any:
        return store.types[name if "/msg/" in name else f"geometry_msgs/msg/{name}"](*values)

    def header(t: float) -> Any:
        stamp = ros("builtin_interfaces/msg/Time", *divmod(round(1e9 * t), 10**9))
        return ros("std_msgs/msg/Header", *[0] * ros1, stamp, "world")

    def commands(name: str, track: Track, own: Mapping[str, Signal]) -> Any:
        yaw = own["commanded_yaw"].at(track.t)[:, 0] if "commanded_yaw" in own else 0.0 * track.t
        for i, (t, place) in enumerate(
            zip(track.t.tolist(), track.positions.tolist(), strict=True)
        ):
            values: Any = (*place, float(yaw[i]))
            topic, type_ = f"/{name}/cmd_position", "Position"
            if "commanded_velocity" in own:
                moving = [own[f"commanded_{x}"].values[i] for x in ("velocity", "acceleration")]
                velocity, acceleration = (ros("Vector3", *x.tolist()) for x in moving)
                pose = ros("Pose", ros("Point", *place), ros("Quaternion", 0.0, 0.0, 0.0, 1.0))
                rest = ros("Vector3", 0.0, 0.0, 0.0)
                values = pose, ros("Twist", velocity, rest), acceleration
                topic, type_ = f"/{name}/cmd_full_state", "FullState"
            yield t, topic, ros(f"{package}/msg/{type_}", header(epoch + t), *values)

    messages = list[tuple[float, str, Any]]()
    for k, (name, track) in enumerate(flight.tracks.items()):
        own, boot = flight.signals.get(name, {}), 100.0 * (k + 1)
        turned = own["attitude"].at(track.t) if "attitude" in own else [(0.0, 0.0, 0.0, 1.0)] * 9999
        for t, place, turn in zip(track.t.tolist(), track.positions.tolist(), turned, strict=False):
            pose = ros("Transform", ros("Vector3", *place), ros("Quaternion", *map(float, turn)))
            stamped = ros("TransformStamped", header(epoch + t), name, pose)
            messages.append((t, "/tf", ros(TRANSFORMS, [stamped])))
        for topic, quantity, scale in logs:
            for t, values in _samples(own.get(quantity)):
                stamp = header(boot + t) if ros1 else header(epoch + t + delay)
                clock = [] if ros1 else [round(1e3 * (boot + t))]
                numbers: Any = np.array(values, np.float64 if ros1 else np.float32) * scale
                message = ros(f"{package}/msg/{log}", stamp, *clock, numbers)
                messages.append((t + delay + 0.02 * np.sin(t) ** 2, f"/{name}/{topic}", message))
        if name in flight.setpoints:
            messages += commands(name, flight.setpoints[name], own)
    for name, track in flight.loads.items():
        for t, place in _samples(Signal(track.t, track.positions)):
            pose = ros("Pose", ros("Point", *place), ros("Quaternion", 0.0, 0.0, 0.0, 1.0))
            messages.append((t, f"/{name}/pose", ros("PoseStamped", header(epoch + t), pose)))
    return write_messages(path, messages, kind, store)


def _samples(signal: Signal | None) -> Any:
    return zip(signal.t.tolist(), signal.values.tolist(), strict=True) if signal else ()


# Variables of uSD logs by quantity, with their unit
USD_VARIABLES = {
    "estimated_velocity": ("stateEstimate.v{}", "xyz", 1.0),
    "estimated_attitude": ("stateEstimate.q{}", "xyzw", 1.0),
    "commanded_velocity": ("ctrltarget.v{}", "xyz", 1.0),
    "commanded_acceleration": ("ctrltarget.a{}", "xyz", 1.0),
    "commanded_yaw": ("ctrltarget.{}", ["yaw"], np.pi / 180.0),
    "rates": ("gyro.{}", "xyz", np.pi / 180.0),
    "specific_force": ("acc.{}", "xyz", 9.81),
    "motors": ("pwm.m{}_pwm", "1234", 1.0 / 65535.0),
    "thrust": ("ctrlLeeP.thrust{}", ["SI"], 1.0),
}


def write_rich_usd(
    folder: Path, flight: RecordedFlight, clocks: Sequence[float] = (), drop: str = ""
) -> Path:
    """Write logs of drones with what ``flight`` holds, on clocks that differ by seconds.

    ``drop`` is a prefix of variables that are not logged.
    """
    folder.mkdir()
    for k, (name, track) in enumerate(flight.tracks.items()):
        columns = {f"stateEstimate.{x}": track.positions[:, i] for i, x in enumerate("xyz")}
        if name in flight.setpoints:
            places = flight.setpoints[name].positions
            columns |= {f"ctrltarget.{x}": places[:, i] for i, x in enumerate("xyz")}
        for quantity, (text, parts, unit) in USD_VARIABLES.items():
            if quantity in flight.signals.get(name, {}):
                values = flight.signals[name][quantity].values / unit
                columns |= {text.format(x): values[:, i] for i, x in enumerate(parts)}
        for load in flight.loads.values():
            places = load.positions / 1e-3
            columns |= {f"stateEstimateZ.p{x}": places[:, i] for i, x in enumerate("xyz")}
        names = [x for x in columns if not drop or not x.startswith(drop)]
        data = struct.pack("<BHHH", 0xBC, 2, 1, 0xFFFF) + b"event\0"
        data += struct.pack("<H", len(names)) + b"".join(f"{x}(f)".encode() + b"\0" for x in names)
        clock = clocks[k] if clocks else 0.0
        for i, t in enumerate(track.t.tolist()):
            row = [float(columns[x][i]) for x in names]
            data += struct.pack(f"<HQ{len(names)}f", 0xFFFF, round(1e6 * (t + clock)), *row)
        (folder / f"{name}.bin").write_bytes(data + struct.pack("<I", zlib.crc32(data)))
    return folder


def write_rich_ulog(folder: Path, flight: RecordedFlight) -> Path:
    """Write ulogs of drones: positions, velocities, attitudes, sensors, commands and motors."""
    folder.mkdir()
    to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    to_frd = np.diag([1.0, -1.0, -1.0])

    def quaternions(signal: Signal) -> Array:
        turned = to_ned @ Rotation.from_quat(signal.values).as_matrix() @ to_frd
        x, y, z, w = Rotation.from_matrix(turned).as_quat().T
        return np.stack([w, x, y, z], axis=1)

    for name, track in flight.tracks.items():
        own = {quantity: each.values for quantity, each in flight.signals[name].items()}
        q = {x: quaternions(flight.signals[name][x]) for x in ("attitude", "estimated_attitude")}
        place = track.positions @ to_ned
        topics: dict[str, tuple[str, Array]] = {
            "vehicle_visual_odometry": (
                "float[3] position;float[4] q;", np.hstack([place, q["attitude"]]),
            ),
            "vehicle_local_position": (
                "float x;float y;float z;float vx;float vy;float vz;",
                np.hstack(
                    [own["estimated_position"] @ to_ned, own["estimated_velocity"] @ to_ned]
                ),
            ),
            "vehicle_attitude": ("float[4] q;", q["estimated_attitude"]),
            "sensor_combined": (
                "float[3] gyro_rad;float[3] accelerometer_m_s2;",
                np.hstack([own["rates"] @ to_frd, own["specific_force"] @ to_frd]),
            ),
            "trajectory_setpoint": (
                "float[3] position;float[3] velocity;float[3] acceleration;",
                np.hstack(
                    [flight.setpoints[name].positions @ to_ned]
                    + [own[f"commanded_{x}"] @ to_ned for x in ("velocity", "acceleration")]
                ),
            ),
            "actuator_motors": ("float[4] control;", own["motors"]),
        }  # fmt: skip
        messages = [(b"B", bytes(40))]
        for topic, (fields, _) in topics.items():
            messages.append((b"F", f"{topic}:uint64_t timestamp;{fields}".encode()))
        for number, topic in enumerate(topics):
            messages.append((b"A", struct.pack("<BH", 0, number) + topic.encode()))
        for i, t in enumerate(track.t.tolist()):
            for number, (_, values) in enumerate(topics.values()):
                row = struct.pack(f"<HQ{values.shape[1]}f", number, round(1e6 * t), *values[i])
                messages.append((b"D", row))
        data = b"".join(struct.pack("<Hc", len(x), kind) + x for kind, x in messages)
        header = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
        (folder / f"{name}.ulg").write_bytes(header + data)
    return folder
