"""Format gltf: ``plan.glb``, the plan as an animation for Blender, three.js and model viewers.

A node for each drone (``q0``, ``r0``), cable (``cable 0``, its spans below it) and object, moved by
one animation: places and attitudes of drones and objects, and of every span of a cable, a cylinder
of unit length along y, its middle, direction and length. glTF is right-handed, y up, in metres: a
point (x, y, z) of the plan is (x, z, -y), and Blender shows it at (x, y, z). Viewers move nodes
along straight lines between samples, which is what is read back and certified.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.recording import Recording
from hitchopt.geometry.vectors import unit
from hitchopt.motion.states import sample_times
from hitchopt.objects import Section, Slab
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array
from hitchopt.view.scene import scene_at
from hitchopt.view.shapes import Solid, mesh, slab_faces
from hitchopt.view.style import rgb

FLOAT, UNSIGNED = 5126, 5125  # Types of numbers in accessors, 32 bits each
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}  # Types of rows in accessors
MAX_BYTES = 2_000_000_000  # Size limit of a file that is read [B]
SPANS = [0, 3, 6, 10, 14, 17, 21, 24, 28, 32, 35, 38]  # Points of a drawn cable that spans join


class Gltf(Format):
    """A scene with one animation, for Blender and viewers."""

    name = "gltf"
    file = "plan.glb"
    endings = (".glb",)
    frames = ("enu",)
    rate = 30.0
    accuracy = 2e-3
    feed_forward = "not in this file: an animation for viewers"
    flown_by = ""  # drones are tilted by it

    def write(self, folder: Path, task: Task) -> Written:
        """Write the plan's drones, cables and objects at the task's rate."""
        motion, frame, document = task.motion, task.frame, _Document()
        t = sample_times(motion.duration, task.rate)
        drawn = scene_at(motion.replaced(others=()), t)
        single = t.astype(np.float32)
        if single[-1] < t[-1]:  # rounded up: the scene holds all of the plan
            single[-1] = np.nextafter(single[-1], np.float32(np.inf))
        times = document.numbers(single)
        look, bodies = drawn.appearance, list[tuple[str, Array, Array]]()
        meshes = document.meshes("drones", look.drone_parts())
        for i, name in enumerate(task.names):
            bodies.append((name, drawn.drones[:, i], drawn.quaternions[:, i]))
        for i, solid in enumerate(look.objects):
            meshes += document.meshes("objects", [solid])
            bodies.append((solid.name, drawn.objects[:, i, :3], drawn.objects[:, i, 3:]))
        roots, turn = [], Rotation.from_euler("z", frame.yaw)
        for mesh_, (name, places, quaternions) in zip(meshes, bodies, strict=True):
            turned = (turn * Rotation.from_quat(quaternions, scalar_first=True)).as_quat()
            turned = np.column_stack([y_up(turned[:, :3]), turned[:, 3]])
            paths = {"translation": y_up(frame.points(places)), "rotation": turned}
            roots.append(document.moved(name, mesh_, times, paths))
        span = slab_faces(Slab(Section(radius=1.0), -0.5, 0.5))
        cables = Solid("cables", span, look.cable_colours)
        shapes = document.meshes("cables", [cables] if drawn.cables.size else [])
        labels = [
            group.label(f"cable {k}").replace(".", "_")
            for group in motion.groups
            for k in range(group.motion.team.robots)
        ]
        for k, (name, shape) in enumerate(zip(labels, shapes, strict=True)):
            points = y_up(frame.points(drawn.cables[:, k, SPANS]))
            apart, middles = np.diff(points, axis=1), 0.5 * (points[:, 1:] + points[:, :-1])
            scales = np.full_like(apart, drawn.radius)
            scales[..., 1] = np.linalg.norm(apart, axis=-1)
            paths = {"translation": middles, "rotation": _along(apart), "scale": scales}
            spans = []
            for i in range(len(SPANS) - 1):
                here = {path: values[:, i] for path, values in paths.items()}
                spans.append(document.moved(f"{name} span {i}", shape, times, here))
            roots.append(document.added("nodes", name=name, children=spans))
        extras = {"drones": list(task.names), **frame.to_dict()}
        (folder / self.file).write_bytes(document.packed(roots, task.title or "plan", extras))
        return Written((self.file,))

    def load(self, files: Sequence[Path]) -> Recording:
        """Return the lines through the places of the drones that a scene names."""
        with reading(files[0], "glTF scene of drones"):
            return Recording.of_samples(*read_drones(files[0]), "enu", 0)


class _Document:
    """A glTF document and its binary chunk while they are written."""

    def __init__(self) -> None:
        self.data = bytearray()
        kinds = ("accessors", "bufferViews", "meshes", "materials", "nodes")
        self.lists: dict[str, list[Any]] = {kind: [] for kind in kinds}
        self.animation: dict[str, list[Any]] = {"channels": [], "samplers": []}
        self._materials: dict[str, int] = {}

    def added(self, kind: str, **entry: Any) -> int:
        """Append an entry to a list of the document; return its index."""
        self.lists[kind].append(entry)
        return len(self.lists[kind]) - 1

    def numbers(self, values: NDArray[Any]) -> int:
        """Store numbers (count,) or (count, 3 or 4) with their extent; return their accessor."""
        whole = values.dtype.kind == "u"
        stored = values.astype("<u4" if whole else "<f4").reshape(len(values), -1)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": stored.nbytes}
        self.data += stored.tobytes()
        return self.added(
            "accessors",
            bufferView=self.added("bufferViews", **view),
            componentType=UNSIGNED if whole else FLOAT,
            count=len(values),
            type=KINDS[stored.shape[1]],
            min=stored.min(axis=0).tolist(),
            max=stored.max(axis=0).tolist(),
        )

    def meshes(self, name: str, parts: Sequence[Solid]) -> list[int]:
        """Store solids with z up that move together; return a mesh for each of their places."""
        surfaces = []
        for part in parts:
            vertices, triangles = mesh(y_up(part.faces))
            places, corners = {"POSITION": self.numbers(vertices)}, self.numbers(triangles.ravel())
            surfaces.append({"attributes": places, "indices": corners})
        stored: dict[tuple[str, ...], int] = {}
        for colours in zip(*(part.colours for part in parts), strict=True):
            if colours not in stored:
                primitives = [
                    {**surface, "material": self.material(colour)}
                    for surface, colour in zip(surfaces, colours, strict=True)
                ]
                stored[colours] = self.added("meshes", name=name, primitives=primitives)
        return [stored[colours] for colours in zip(*(part.colours for part in parts), strict=True)]

    def material(self, colour: str) -> int:
        """Return the material of a colour such as #0b3c5d."""
        if colour not in self._materials:
            base = {
                "baseColorFactor": [*rgb((colour,), linear=True)[0], 1.0],
                "metallicFactor": 0.0,
            }
            self._materials[colour] = self.added(
                "materials", pbrMetallicRoughness=base, doubleSided=True
            )
        return self._materials[colour]

    def moved(self, name: str, mesh: int, times: int, paths: Mapping[str, Array]) -> int:
        """Add a node that is moved at the times of an accessor along its paths; return it."""
        first = {path: values[0].tolist() for path, values in paths.items()}
        node = self.added("nodes", name=name, mesh=mesh, **first)
        samplers, channels = self.animation["samplers"], self.animation["channels"]
        for path, values in paths.items():
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            output = self.numbers(values)
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        return node

    def packed(self, roots: Sequence[int], title: str, extras: dict[str, Any]) -> bytes:
        """Return the file."""
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
    turned: Array = vectors[..., [0, 2, 1]] * [1.0, 1.0, -1.0]
    return turned


def _along(vectors: Array) -> Array:
    """Return quaternions (S, m, 4) x, y, z, w from y to vectors (S, m, 3), of one sign in time."""
    x, y, z = np.moveaxis(unit(vectors + [0.0, 1e-12, 0.0]), -1, 0)
    down = np.array([1.0, 0.0, 0.0, 0.0])  # from y to -y, about x
    half = np.stack([z, 0.0 * x, -x, 1.0 + y], axis=-1)
    quaternions = unit(np.where(half[..., 3:] > 1e-9, half, down))
    turns = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0.0
    quaternions[1:] *= np.cumprod(np.where(turns, -1.0, 1.0), axis=0)
    return quaternions


def read_drones(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, times (S,) [s] and places (S, D, 3) [m], z up, of the drones in a scene."""
    if path.stat().st_size > MAX_BYTES:
        raise FileError(f"is larger than {MAX_BYTES} bytes")
    data = path.read_bytes()
    magic, _, _, size, kind = struct.unpack_from("<4sIII4s", data)
    if (magic, kind) != (b"glTF", b"JSON"):
        raise FileError("does not begin as a .glb does")
    content = parsed_json(data[20 : 20 + size])
    nodes = [node["name"] for node in content["nodes"]]
    names = tuple(map(str, content["asset"]["extras"]["drones"]))
    (animation,) = content["animations"]

    def numbers(index: float, columns: int) -> Array:
        accessor = content["accessors"][int(index)]
        view = content["bufferViews"][int(accessor["bufferView"])]
        offset, count = 28 + size + int(view["byteOffset"]), int(accessor["count"])
        found = np.frombuffer(data, "<f4", columns * count, offset)
        return found.astype(np.float64).reshape(-1, columns)

    samplers = {
        nodes[int(each["target"]["node"])]: animation["samplers"][int(each["sampler"])]
        for each in animation["channels"]
        if each["target"]["path"] == "translation"
    }
    (times,) = {samplers[name]["input"] for name in names}  # all drones share them
    t = numbers(times, 1)[:, 0]
    places = np.stack([numbers(samplers[name]["output"], 3) for name in names], axis=1)
    if len(places) != len(t) or not np.all(np.isfinite(places)):
        raise FileError("its drones have not one place for each time")
    return names, t, places[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
