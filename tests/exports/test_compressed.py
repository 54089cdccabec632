"""Compressed bytes, packed by cflib too and flown by a reader of this file's own."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cflib.crazyflie.mem.trajectory_memory import CompressedSegment, CompressedStart
from exported_plans import exported, hitch_plan, swarm_of, swarm_plan, task_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.checks import certify
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.formats.compressed import compressed, read_compressed
from hitchopt.exports.formats.compressed_bytes import decoded, encoded
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan

Array = NDArray[np.float64]

COUNTS = (0, 1, 3, 7)


def segments(data: bytes) -> tuple[list[int], list[tuple[int, list[list[int]]]], bytes]:
    """Start, segments (duration in ms, given points of x, y, z, yaw) and what follows the end."""
    start = list(struct.unpack_from("<4h", data))
    at = 8
    found: list[tuple[int, list[list[int]]]] = []
    while True:
        kind, duration = struct.unpack_from("<BH", data, at)
        at += 3
        if duration == 0:
            return start, found, data[at:]
        axes = []
        for i in range(4):
            count = COUNTS[(kind >> (2 * i)) & 3]
            axes.append(list(struct.unpack_from(f"<{count}h", data, at)))
            at += 2 * count
        found.append((duration, axes))


def de_casteljau(points: list[float], x: float) -> float:
    while len(points) > 1:
        points = [(1 - x) * a + x * b for a, b in pairwise(points)]
    return points[0]


def flown(data: bytes, t: float) -> Array:
    start, found, _ = segments(data)
    last = start[:3]
    for number, (duration, axes) in enumerate(found):
        if 1000.0 * t > duration and number < len(found) - 1:
            last = [axis[-1] if axis else old for axis, old in zip(axes[:3], last, strict=True)]
            t -= duration / 1000.0
            continue
        x = min(1000.0 * t / duration, 1.0)
        each = zip(axes[:3], last, strict=True)
        return np.array([de_casteljau([float(old), *axis], x) for axis, old in each]) / 1000.0
    raise AssertionError("no segment")


@pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])
def test_the_bytes_fly_the_plan(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "compressed", tmp_path, origin=[0.5, -0.2, 0.1])
    assert part.verdict.lost == ()
    assert part.verdict.position.worst <= 2e-3
    t = np.linspace(0.0, motion.duration, 90)
    places = states_at(motion, t).positions + np.array([0.5, -0.2, 0.1])
    for i, name in enumerate(motion.team.drone_names):
        data = (tmp_path / f"{name}_enu.bin").read_bytes()
        assert len(data) <= 4096
        found = np.array([flown(data, float(at)) for at in t])
        assert np.max(np.linalg.norm(found - places[:, i], axis=-1)) <= part.verdict.position.worst


def test_cflib_packs_the_same_bytes(tmp_path: Path) -> None:
    exported(hitch_plan(), "compressed", tmp_path, yaw=0.25)
    for path in sorted(tmp_path.glob("*.bin")):
        data = path.read_bytes()
        start, found, rest = segments(data)
        assert rest == b""
        # cflib truncates: half a unit more, away from zero, lands on the integers.
        nudged = [[(v + 0.5 * np.sign(v)) / 1000.0 for v in start[:3]]]
        yaw = np.radians((start[3] + 0.5) / 10.0)
        packed = bytes(CompressedStart(*nudged[0], yaw).pack())
        for duration, axes in found:
            near = [[(v + 0.5 * np.sign(v)) / 1000.0 for v in axis] for axis in axes[:3]]
            segment = CompressedSegment((duration + 0.5) / 1000.0, *near, axes[3])
            packed += bytes(segment.pack())
        assert packed + bytes(CompressedSegment(0.0, [], [], [], []).pack()) == data
        assert start[3] == round(np.degrees(0.25) * 10)


def test_yaw_is_constant_and_what_rests_takes_no_bytes() -> None:
    still = swarm_of(np.array([[[0.0, 0.0, 1.0]], [[0.4, 0.0, 1.0]]]), np.array([0.0, 3.0]))
    (data,) = compressed(task_of(still, "compressed"), 1.0, 2e-3).values()
    _, found, _ = segments(data)
    assert all(axes[1] == axes[2] == axes[3] == [] for _, axes in found)
    assert len(data) == 8 + len(found) * (3 + 14) + 3


@given(st.integers(0, 1000))
def test_encoded_and_decoded_are_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.integers(-32767, 32768, size=(3, 3, 8))
    points[:, 1] = points[:1, 1, :1]  # one axis rests
    points[1:, :, 0] = points[:-1, :, -1]
    durations = rng.integers(1, 65536, size=3)
    found = decoded(encoded(durations, points, 0.5))
    assert found.ended
    np.testing.assert_allclose(found.curve.coefficients, points * 1e-3, atol=1e-12)
    np.testing.assert_allclose(found.curve.durations, durations * 1e-3)
    assert np.degrees(found.yaws).tolist() == pytest.approx([28.6])
    assert found.size == 8 + 3 * (3 + 28) + 3


def test_lines_and_cubics_of_others_are_read() -> None:
    data = struct.pack("<4h", 100, -200, 300, 0)
    data += struct.pack("<BH", 0b00_00_01_10, 500) + struct.pack("<3h", 110, 130, 160)
    data += struct.pack("<h", -100) + b"\x00\x00\x00" + b"old memory"
    curve = decoded(data).curve
    for t in (0.0, 0.2, 0.5):
        x = t / 0.5
        expected = [de_casteljau([100, 110, 130, 160], x), -200 + 100 * x, 300]
        np.testing.assert_allclose(curve.at(t) * 1000.0, expected, atol=1e-9)


def test_beyond_the_range_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InfeasibleError, match=r"range: 3.* m is above the limit of 32\.767 m"):
        exported(swarm_plan(), "compressed", tmp_path / "out", origin=[31.0, 0.0, 0.0])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("data", "reported"),
    [
        (b"", "has 0 bytes"),
        (bytes(8), "no segment that lasts"),
        (bytes(8) + b"\x00\x00\x00", "no segment that lasts"),
        (bytes(8) + b"\x03\x10", "stops within a segment's header, at byte 8"),
        (bytes(8) + b"\x03\x10\x00" + bytes(13), "stops within segment 0"),
        (bytes(8) + b"\x03\x10\x00" + bytes(14), "truncated"),
        (bytes(70_000), "far larger"),
    ],
)
def test_damaged_bytes_are_reported(data: bytes, reported: str, tmp_path: Path) -> None:
    path = tmp_path / "d0.bin"
    path.write_bytes(data)
    with pytest.raises(FileError, match=reported):
        read_compressed(path)


def test_bytes_from_python(tmp_path: Path) -> None:
    motion = hitch_plan()
    plan = Plan(motion, certify(motion), "A plan")
    (files,) = plan.compressed(frame="nwu")
    plan.export("compressed", tmp_path, frame="nwu")
    assert set(files) == set(motion.team.drone_names)
    assert files["q0"] == (tmp_path / "q0_nwu.bin").read_bytes()
