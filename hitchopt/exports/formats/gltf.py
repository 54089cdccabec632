"""Format gltf: ``plan.glb``, the plan as an animation for Blender, three.js and model viewers.

There is a node for each drone (``q0``, ``r0``), cable (``cable 0``, with its spans as children) and
object. One animation has the positions and attitudes of drones and objects, and the midpoint,
direction and length of every span of a cable, a unit cylinder along y. glTF is right-handed, y up,
in metres: a point (x, y, z) of the plan is (x, z, -y), and Blender shows it at (x, y, z). Viewers
interpolate linearly between samples; these lines are read back and certified.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError
from hitchopt.exports.contents import FileContents
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.geometry.vectors import unit
from hitchopt.motion.states import sample_times
from hitchopt.objects import Section, Slab
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_bytes, parsed_json
from hitchopt.values import Array
from hitchopt.view.scene import RigidSurface, mesh, scene_at, slab_faces
from hitchopt.view.style import rgb

FLOAT = 5126  # Type of 32-bit floating-point numbers in accessors
UNSIGNED = 5125  # Type of unsigned 32-bit integers in accessors
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}  # Types of rows in accessors
MAX_BYTES = 2_000_000_000  # Size limit of a file [B]
SPANS = [0, 3, 6, 10, 14, 17, 21, 24, 28, 32, 35, 38]  # Indices of points between spans of a cable


class Gltf(Format):
    """A scene with one animation, for Blender and viewers."""

    name = "gltf"
    file = "plan.glb"
    endings = (".glb",)
    frames = ("enu",)
    rate = 30.0
    accuracy = 2e-3
    reach = math.inf
    feed_forward = "not in this file: an animation for viewers"
    flown_by = ""
    needs_stiffness = False

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the plan's drones, cables and objects at the task's rate."""
        flight = task.flight
        frame = task.frame
        document = _Document()
        t = sample_times(flight.duration, task.rate)
        scene = scene_at(flight.without_others, t)
        single = t.astype(np.float32)
        if single[-1] < t[-1]:  # rounded up, so that the whole plan is included
            single[-1] = np.nextafter(single[-1], np.float32(np.inf))
        times = document.numbers(single)
        appearance = scene.appearance
        bodies = list[tuple[str, Array, Array]]()
        looks = document.meshes("drones", appearance.drone_parts())
        meshes = [looks[i] for i in task.order]
        for i, name in zip(task.order.tolist(), task.names, strict=True):
            bodies.append((name, scene.drones[:, i], scene.quaternions[:, i]))
        for i, solid in enumerate(appearance.objects):
            meshes += document.meshes("objects", [solid])
            bodies.append((solid.name, scene.objects[:, i, :3], scene.objects[:, i, 3:]))
        roots = []
        turn = Rotation.from_euler("z", frame.yaw)
        for mesh_, (name, positions, quaternions) in zip(meshes, bodies, strict=True):
            rotation = (turn * Rotation.from_quat(quaternions, scalar_first=True)).as_quat()
            rotation = np.column_stack([y_up(rotation[:, :3]), rotation[:, 3]])
            paths = {"translation": y_up(frame.points(positions)), "rotation": rotation}
            roots.append(document.animate(name, mesh_, times, paths))
        span = slab_faces(Slab(Section(radius=1.0), -0.5, 0.5))
        cables = RigidSurface("cables", span, appearance.cable_colours)
        shapes = document.meshes("cables", [cables] if scene.cables.size else [])
        labels = [
            each.label(cable).replace(".", "_")
            for each in flight.teams
            for cable in each.motion.team.cable_names
        ]
        for k, (name, shape) in enumerate(zip(labels, shapes, strict=True)):
            points = y_up(frame.points(scene.cables[:, k, SPANS]))
            vectors = np.diff(points, axis=1)
            midpoints = 0.5 * (points[:, 1:] + points[:, :-1])
            scales = np.full_like(vectors, scene.radius)
            scales[..., 1] = np.linalg.norm(vectors, axis=-1)
            paths = {"translation": midpoints, "rotation": _along(vectors), "scale": scales}
            spans = []
            for i in range(len(SPANS) - 1):
                span_paths = {path: values[:, i] for path, values in paths.items()}
                spans.append(document.animate(f"{name} span {i}", shape, times, span_paths))
            roots.append(document.add("nodes", name=name, children=spans))
        extras = {"drones": list(task.names), **frame.to_dict()}
        (folder / self.file).write_bytes(document.to_bytes(roots, task.title or "plan", extras))
        return FormatOutput((self.file,))

    def load(self, files: Sequence[Path]) -> FileContents:
        """Return the lines between the positions of a scene's drones."""
        with reading(files[0], "glTF scene of drones"):
            return FileContents.of_samples(*read_drones(files[0]), "enu", 0)


class _Document:
    """A glTF document under construction, with its binary chunk."""

    def __init__(self) -> None:
        self.data = bytearray()
        kinds = ("accessors", "bufferViews", "meshes", "materials", "nodes")
        self.lists: dict[str, list[Any]] = {kind: [] for kind in kinds}
        self.animation: dict[str, list[Any]] = {"channels": [], "samplers": []}
        self._materials: dict[str, int] = {}

    def add(self, kind: str, **entry: Any) -> int:
        """Append an entry to a list of the document; return its index."""
        self.lists[kind].append(entry)
        return len(self.lists[kind]) - 1

    def numbers(self, values: NDArray[Any]) -> int:
        """Add numbers (count,) or (count, 3 or 4); return the index of their accessor."""
        unsigned = values.dtype.kind == "u"
        array = values.astype("<u4" if unsigned else "<f4").reshape(len(values), -1)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.data += array.tobytes()
        return self.add(
            "accessors",
            bufferView=self.add("bufferViews", **view),
            componentType=UNSIGNED if unsigned else FLOAT,
            count=len(values),
            type=KINDS[array.shape[1]],
            min=array.min(axis=0).tolist(),
            max=array.max(axis=0).tolist(),
        )

    def meshes(self, name: str, parts: Sequence[RigidSurface]) -> list[int]:
        """Add a body of solids with z up; return the index of a mesh for each set of colours."""
        surfaces = []
        for part in parts:
            vertices, triangles = mesh(y_up(part.faces))
            attributes = {"POSITION": self.numbers(vertices)}
            indices = triangles.ravel()
            surfaces.append({"attributes": attributes, "indices": self.numbers(indices)})
        meshes: dict[tuple[str, ...], int] = {}
        for colours in zip(*(part.colours for part in parts), strict=True):
            if colours not in meshes:
                primitives = [
                    {**surface, "material": self.material(colour)}
                    for surface, colour in zip(surfaces, colours, strict=True)
                ]
                meshes[colours] = self.add("meshes", name=name, primitives=primitives)
        return [meshes[colours] for colours in zip(*(part.colours for part in parts), strict=True)]

    def material(self, colour: str) -> int:
        """Return the index of the material of a colour such as #0b3c5d."""
        if colour not in self._materials:
            factor = [*rgb((colour,), linear=True)[0], 1.0]
            base = {"baseColorFactor": factor, "metallicFactor": 0.0}
            material = self.add("materials", pbrMetallicRoughness=base, doubleSided=True)
            self._materials[colour] = material
        return self._materials[colour]

    def animate(self, name: str, mesh: int, times: int, paths: Mapping[str, Array]) -> int:
        """Add a node that moves along paths at an accessor's times; return its index."""
        first = {path: values[0].tolist() for path, values in paths.items()}
        node = self.add("nodes", name=name, mesh=mesh, **first)
        samplers, channels = self.animation["samplers"], self.animation["channels"]
        for path, values in paths.items():
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            output = self.numbers(values)
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        return node

    def to_bytes(self, roots: Sequence[int], title: str, extras: dict[str, Any]) -> bytes:
        """Return the bytes of the .glb file."""
        head = {
            "asset": {"version": "2.0", "generator": "hitchopt", "extras": extras},
            "scene": 0,
            "scenes": [{"name": title, "nodes": list(roots)}],
            **self.lists,
            "animations": [{"name": title, **self.animation}],
            "buffers": [{"byteLength": len(self.data)}],
        }
        text = json.dumps(head, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 28 + len(text) + len(self.data)
        start = struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
        return start + text + struct.pack("<I4s", len(self.data), b"BIN\0") + self.data


def y_up(vectors: Array) -> Array:
    """Return vectors (…, 3) of a frame with z up in glTF's axes."""
    rotated: Array = vectors[..., [0, 2, 1]] * [1.0, 1.0, -1.0]
    return rotated


def _along(vectors: Array) -> Array:
    """Return quaternions (S, m, 4), x, y, z, w, from y to vectors (S, m, 3), continuous in time."""
    x, y, z = np.moveaxis(unit(vectors + [0.0, 1e-12, 0.0]), -1, 0)
    down = np.array([1.0, 0.0, 0.0, 0.0])  # from y to -y, about x
    half = np.stack([z, 0.0 * x, -x, 1.0 + y], axis=-1)
    quaternions = unit(np.where(half[..., 3:] > 1e-9, half, down))
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0.0
    quaternions[1:] *= np.cumprod(np.where(flips, -1.0, 1.0), axis=0)
    return quaternions


def read_drones(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, times (S,) [s] and positions (S, D, 3) [m], z up, of a scene's drones."""
    if path.stat().st_size > MAX_BYTES:
        raise FileError(f"is larger than {MAX_BYTES} bytes")
    data = file_bytes(path)
    magic, _, _, size, kind = struct.unpack_from("<4sIII4s", data)
    if (magic, kind) != (b"glTF", b"JSON"):
        raise FileError("does not begin with the header of a .glb file")
    content = parsed_json(data[20 : 20 + size])
    nodes = [node["name"] for node in content["nodes"]]
    names = tuple(map(str, content["asset"]["extras"]["drones"]))
    (animation,) = content["animations"]

    def numbers(index: float, columns: int) -> Array:
        accessor = content["accessors"][int(index)]
        view = content["bufferViews"][int(accessor["bufferView"])]
        offset = 28 + size + int(view["byteOffset"])
        count = int(accessor["count"])
        array = np.frombuffer(data, "<f4", columns * count, offset)
        return array.astype(np.float64).reshape(-1, columns)

    samplers = {
        nodes[int(each["target"]["node"])]: animation["samplers"][int(each["sampler"])]
        for each in animation["channels"]
        if each["target"]["path"] == "translation"
    }
    (times,) = {samplers[name]["input"] for name in names}  # shared by all drones
    t = numbers(times, 1)[:, 0]
    positions = np.stack([numbers(samplers[name]["output"], 3) for name in names], axis=1)
    if len(positions) != len(t) or not np.all(np.isfinite(positions)):
        raise FileError("its drones do not have one position per time")
    return names, t, positions[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
