"""Readers of every format that are independent of hitchopt."""

from __future__ import annotations

import csv
import json
import math
import struct
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Read:
    """What files say of D drones, in their own frame."""

    t: Array  # (S,) [s]
    places: Array  # (S, D, 3) [m]
    velocities: Array | None = None  # [m/s]
    forward: Array | None = None  # acceleration for controllers that add gravity [m/s²]
    quaternions: Array | None = None  # (S, D, 4) w, x, y, z, from the body's axes
    rates: Array | None = None  # (S, D, 3) about the body's axes [rad/s]


Reader = Callable[[Path, Sequence[str], Array], Read]
"""Reads a folder, given the names in it and times at which curves are to be evaluated."""


def polynomials(path: Path, t: Array, order: int = 0) -> Array:
    """Crazyswarm2's reader: pieces one after the other, powers of seconds."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)
    ends = np.cumsum(rows[:, 0])
    piece = np.minimum(np.searchsorted(ends, t, side="right"), len(rows) - 1)
    tau = t - (ends[piece] - rows[piece, 0])
    powers = rows[piece, 1:25].reshape(-1, 3, 8)
    for _ in range(order):
        powers = powers[..., 1:] * np.arange(1, powers.shape[-1])
    return np.asarray(np.sum(powers * tau[:, None, None] ** np.arange(powers.shape[-1]), axis=-1))


def segments(data: bytes) -> tuple[list[int], list[tuple[int, list[list[int]]]], bytes]:
    """Start, segments (duration in ms, given points of x, y, z, yaw) and what follows the end."""
    start, at = list(struct.unpack_from("<4h", data)), 8
    found: list[tuple[int, list[list[int]]]] = []
    while True:
        kind, duration = struct.unpack_from("<BH", data, at)
        at += 3
        if duration == 0:
            return start, found, data[at:]
        axes = []
        for i in range(4):
            count = (0, 1, 3, 7)[(kind >> (2 * i)) & 3]
            axes.append(list(struct.unpack_from(f"<{count}h", data, at)))
            at += 2 * count
        found.append((duration, axes))


def de_casteljau(points: Iterable[Any], x: float) -> Array:
    row = np.array(list(points), dtype=np.float64)
    while len(row) > 1:
        row = (1.0 - x) * row[:-1] + x * row[1:]
    return np.asarray(row[0])


def compressed_place(data: bytes, t: float) -> Array:
    start, found, _ = segments(data)
    last = start[:3]
    for number, (duration, axes) in enumerate(found):
        if 1000.0 * t > duration and number < len(found) - 1:
            last = [axis[-1] if axis else old for axis, old in zip(axes[:3], last, strict=True)]
            t -= duration / 1000.0
            continue
        x = min(1000.0 * t / duration, 1.0)
        each = zip(axes[:3], last, strict=True)
        return np.array([de_casteljau([old, *axis], x) for axis, old in each]) / 1000.0
    raise AssertionError("no segment")


def as_stored(points: Any) -> tuple[Array, Array]:
    """What Skybrush's server keeps of a trajectory: whole milliseconds (pieces,), and control
    points (pieces, 4, 3) of whole multiples of a millimetre, digits beyond cut off."""
    reach = [x for _, place, inner in points for x in np.ravel([place, *inner]).tolist()]
    scale = math.ceil((math.ceil(1000 * max(map(abs, reach))) + 1) / 32768)
    lasting, pieces = [], []
    for before, here in pairwise(points):
        lasting.append(math.floor(round(here[0] - before[0], 3) * 1000))
        pieces.append(
            [[int(x * (1000 / scale)) for x in p] for p in (before[1], *here[2], here[1])]
        )
    assert np.max(np.abs(pieces)) < 32768
    return np.array(lasting), scale * 1e-3 * np.array(pieces)


def _crazyswarm2(folder: Path, names: Sequence[str], t: Array) -> Read:
    found = [
        np.stack([polynomials(folder / f"{name}.csv", t, k) for name in names], axis=1)
        for k in (0, 1)
    ]
    return Read(t, *found)


def _compressed(folder: Path, names: Sequence[str], t: Array) -> Read:
    data = [next(folder.glob(f"{name}_*.bin")).read_bytes() for name in names]
    assert max(map(len, data)) <= 4096
    return Read(t, np.array([[compressed_place(each, at) for each in data] for at in t.tolist()]))


def _skybrush(folder: Path, names: Sequence[str], t: Array) -> Read:
    places = []
    with zipfile.ZipFile(folder / "show.skyc") as archive:
        show = json.loads(archive.read("show.json"))
        assert (show["version"], show["meta"]["frame"]) == (1, "nwu")
        assert [drone["settings"]["name"] for drone in show["swarm"]["drones"]] == list(names)
        for drone in show["swarm"]["drones"]:
            file = drone["settings"]["trajectory"]["$ref"].removeprefix("./").removesuffix("#")
            points = json.loads(archive.read(file))["points"]
            assert drone["settings"]["home"] == points[0][1]
            assert drone["settings"]["landAt"] == points[-1][1]
            lasting, pieces = as_stored(points)
            ends = np.cumsum(lasting) * 1e-3
            piece = np.minimum(np.searchsorted(ends, t), len(ends) - 1)
            local = (t - ends[piece]) / (1e-3 * lasting[piece]) + 1.0
            each = zip(pieces[piece], local.tolist(), strict=True)
            places.append([de_casteljau(points, min(x, 1.0)) for points, x in each])
    return Read(t, np.stack(places, axis=1))


def _mavsdk(folder: Path, names: Sequence[str], _: Array) -> Read:
    told = json.loads((folder / "export.json").read_text())
    begin, heading, tables = (
        told["receiver"]["plan_begins_s"],
        math.degrees(told["heading_rad"]),
        [],
    )
    for i in range(len(names)):
        with (folder / f"Drone {i + 1}.csv").open() as file:
            rows = list(csv.reader(file))[1:]
        assert {row[12] for row in rows} == {"70"}
        assert all(abs(float(row[11]) - heading) < 1e-4 for row in rows)
        assert all("." in number for row in rows for number in row[1:12])
        tables.append([list(map(float, row[1:12])) for row in rows])
    table = np.swapaxes(np.array(tables), 0, 1)
    np.testing.assert_allclose(table[:, 0, 0], np.arange(len(table)) / 20.0, atol=1e-9)
    plan = table[table[:, 0, 0] > begin - 1e-9]
    return Read(plan[:, 0, 0] - begin, *(plan[..., i : i + 3] for i in (1, 4, 7)))


def bag_messages(path: Path) -> dict[str, list[tuple[float, Any]]]:
    found: dict[str, list[tuple[float, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((1e-9 * message.log_time, decoded))
    return found


def vector(message: Any) -> list[float]:
    return [message.x, message.y, message.z]


def _ros2bag(folder: Path, names: Sequence[str], _: Array) -> Read:
    found = bag_messages(folder / "setpoints.mcap")
    kinds = ("trajectory", "path", "cmd_full_state")
    assert set(found) == {f"/{name}/{kind}" for name in names for kind in kinds}
    streams, each = [found[f"/{name}/cmd_full_state"] for name in names], list[list[float]]()
    for stream in streams:
        for _sent, m in stream:
            turned = [m.pose.orientation.w, *vector(m.pose.orientation)]
            row = [*vector(m.pose.position), *vector(m.twist.linear), *vector(m.acc), *turned]
            each.append([*row, *vector(m.twist.angular)])
    table = np.swapaxes(np.array(each).reshape(len(names), -1, 16), 0, 1)
    return Read(np.array([at for at, _ in streams[0]]), *np.split(table, [3, 6, 9, 13], axis=-1))


GROUPS = ("x y z", "vx vy vz", "ff_x ff_y ff_z", "qw qx qy qz", "rate_x rate_y rate_z")


def _table(folder: Path, names: Sequence[str], _: Array) -> Read:
    """One of csv and parquet."""
    if (path := folder / "setpoints.parquet").exists():
        rows = pq.read_table(path).to_pylist()
    else:
        with next(folder.glob("setpoints_*.csv")).open() as file:
            rows = list(csv.DictReader(file))
    assert [row["drone"] for row in rows[: len(names)]] == list(names)
    groups = [[[float(row[c]) for c in group.split()] for row in rows] for group in GROUPS]
    t = np.array([float(row["t"]) for row in rows[:: len(names)]])
    return Read(t, *(np.array(g).reshape(len(t), len(names), -1) for g in groups))


def glb_animation(path: Path) -> dict[str, dict[str, tuple[Array, Array]]]:
    """Times and values of every channel of a .glb, by node and path."""
    data = path.read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    content = json.loads(data[20 : 20 + length])
    chunk = data[28 + length :]
    assert len(chunk) == content["buffers"][0]["byteLength"]

    def numbers(index: int) -> Array:
        accessor = content["accessors"][index]
        view = content["bufferViews"][accessor["bufferView"]]
        assert accessor["componentType"] == 5126
        flat = np.frombuffer(chunk, "<f4", view["byteLength"] // 4, view["byteOffset"])
        assert not {"min", "max"} - set(accessor) or accessor["type"] != "SCALAR"
        return flat.astype(float).reshape(accessor["count"], -1)

    (animation,) = content["animations"]
    found: dict[str, dict[str, tuple[Array, Array]]] = {}
    for channel in animation["channels"]:
        target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "LINEAR"
        values = numbers(sampler["input"])[:, 0], numbers(sampler["output"])
        found.setdefault(content["nodes"][target["node"]]["name"], {})[target["path"]] = values
    return found


def _gltf(folder: Path, names: Sequence[str], _: Array) -> Read:
    found = glb_animation(folder / "plan.glb")
    places = np.stack([found[name]["translation"][1] for name in names], axis=1)
    t = found[names[0]]["translation"][0]
    return Read(t, places[..., [0, 2, 1]] * [1.0, -1.0, 1.0])


def _mjcf(folder: Path, names: Sequence[str], _: Array) -> Read:
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    columns = [[model.actuator(f"{name} {axis}").id for axis in "xyz"] for name in names]
    return Read(model.key_time, model.key_ctrl[:, columns])


READERS: dict[str, Reader] = {
    "mjcf": _mjcf,
    "gltf": _gltf,
    "crazyswarm2": _crazyswarm2,
    "compressed": _compressed,
    "skybrush": _skybrush,
    "mavsdk_drone_show": _mavsdk,
    "ros2bag": _ros2bag,
    **dict.fromkeys(("csv", "parquet"), _table),
}
