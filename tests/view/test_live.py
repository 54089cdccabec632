"""The live view, without a browser, and the report: what is sent and written.

The report is one file without addresses; its samples are the plan's, its numbers the checks'.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
import websockets
from click.testing import CliRunner
from websockets.sync.client import connect

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.values import Array
from hitchopt.view.live import ASPECT, LiveView, open_server
from hitchopt.view.live_scene import TRAIL_DURATION
from hitchopt.view.own_pages import is_own_page
from hitchopt.view.report import plots_of, write_report
from hitchopt.view.scene import scene_of
from tests.helpers.pictured import made_certificate, make_motion
from tests.helpers.plans import PROBLEMS


@pytest.fixture(scope="module")
def live() -> Iterator[LiveView]:
    view = LiveView(open_server(), ho.Flight.of(make_motion(4)), made_certificate(), "A picture")
    yield view
    view.close()


@pytest.mark.parametrize("time", [0.0, 0.9, 3.1])
def test_drones_and_cables_are_sent_where_the_plan_has_them(live: LiveView, time: float) -> None:
    assert live.url.startswith("http://127.0.0.1:")  # this machine alone
    live.seek(time)
    drones, sent = live.flight.drones.at(time), live.server.scene._handle_from_node_name
    for part in ("frame", "rotors", "rims"):
        positions = sent[f"/plan/drones/{part}"].batched_positions
        np.testing.assert_allclose(positions, drones, atol=2e-3)
    trails = sent["/plan/trails"].points.reshape(8, -1, 2, 3)
    begin = live.flight.drones.at(max(0.0, time - TRAIL_DURATION))
    np.testing.assert_allclose(trails[:, 0, 0], begin, atol=0.05)
    np.testing.assert_allclose(trails[:, -1, 1], drones, atol=2e-3)
    np.testing.assert_array_equal(trails[:, 1:, 0], trails[:, :-1, 1])
    now = [button.color == "blue" for button in live.phases]
    assert now == [
        phase.start <= time < phase.end or phase.end == time for phase in live.flight.phases
    ]
    ends = sent["/plan/cables"].points.reshape(4, -1, 2, 3)
    np.testing.assert_allclose(ends[:, 0, 0], drones[0::2], atol=2e-3)
    np.testing.assert_allclose(ends[:, -1, 1], drones[1::2], atol=2e-3)


@pytest.mark.parametrize(
    ("origin", "is_own"),
    [
        ("http://127.0.0.1:{port}", True),
        ("http://evil.example", False),
        ("http://127.0.0.1", False),
        ("http://localhost:{port}", False),  # another origin than the address that it calls
        ("null", False),
        (None, False),
    ],
)
def test_only_pages_of_the_view_itself_may_connect(
    live: LiveView, origin: str | None, *, is_own: bool
) -> None:
    port = live.server.get_port()
    where = None if origin is None else websockets.Origin(origin.format(port=port))
    version = websockets.Subprotocol(f"viser-v{viser.__version__}")
    address = f"ws://127.0.0.1:{port}"
    if is_own:
        with connect(address, origin=where, subprotocols=[version]) as page:
            assert page.recv(timeout=60.0)
    else:
        with pytest.raises(websockets.InvalidStatus, match="403"):
            connect(address, origin=where, subprotocols=[version])


@pytest.mark.parametrize(
    ("host", "is_own"),
    [
        ("127.0.0.1:8080", True),
        ("[::1]:8080", True),
        ("192.168.0.7:8080", True),
        ("localhost", True),
        ("Lab.Example:8080", True),
        ("evil.example:8080", False),
        ("127.0.0.1.evil.example:8080", False),
        ("[::1:8080", False),
        ("", False),
    ],
)
def test_names_of_others_that_lead_here_are_not_the_view(host: str, *, is_own: bool) -> None:
    headers = {"Host": host, "Origin": f"http://{host}"}
    assert is_own_page(headers, "lab.example") == is_own


def test_the_camera_sees_all_paths_from_near() -> None:
    live = LiveView(open_server(), ho.Flight.of(make_motion(5)), None)
    camera, drones = live.server.initial_camera, live.live.scene.drones.reshape(-1, 3)
    live.close()
    away, forward = drones - camera.position, np.subtract(camera.look_at, camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    depth = away @ forward
    slopes = np.abs(away @ np.stack([right, np.cross(right, forward)], axis=1)) / depth[:, None]
    shares = np.max(slopes, axis=0) / np.tan(0.5 * camera.fov) / [ASPECT, 1.0]
    assert np.all(depth > 0.0)
    assert 0.8 < np.max(shares) < 0.9


def test_a_certificate_that_is_late_is_shown_with_its_plots() -> None:
    view = LiveView(open_server(), ho.Flight.of(make_motion(3)), None)
    assert "being certified" in view.head.content
    view.show_certificate(made_certificate())
    assert "certified for all t" in view.head.content
    assert len(view.checks) == len(made_certificate().checks)
    assert [button.label.split(":")[0] for button in view.phases] == ["morph", "hold"]
    assert view.scrub.max >= view.flight.duration
    plots = list(plots_of(view.flight, made_certificate()))
    elements = [each for each, _ in view._plots]
    assert [each.title for each in elements] == [p["label"].replace("\n", " ") for p in plots]
    np.testing.assert_allclose(elements[1].data[1], plots[1]["curves"][0])
    time = 0.4 * view.flight.duration
    view.seek(time)
    view._move_cursor()
    speed = np.interp(time, elements[1].data[0], elements[1].data[1])
    assert f"at {time:.2f} s" in view.values.content
    assert f"**{speed:.3g}**" in view.values.content
    for each in elements:
        before, after = each.data[0][np.isfinite(each.data[-1])]
        assert before <= time <= after
    view.play(on=True)
    assert view.player.label == "Pause"
    view.close()


def test_a_problem_file_is_planned_and_shown_or_refused(tmp_path: Path) -> None:
    text = (PROBLEMS / "move_vertex.yaml").read_text()
    file, page = tmp_path / "problem.yaml", tmp_path / "plan.html"
    command = ["view", str(file), "--save", str(page)]
    file.write_text(f"{text}\nlimits: {{tension: 0.1}}\n")
    result = CliRunner().invoke(main, command)
    assert (result.exit_code, page.exists()) == (2, False)
    file.write_text(text)
    assert CliRunner().invoke(main, command).exit_code == 0
    assert text.splitlines()[0] in page.read_text()


def unpacked(entries: list[dict[str, Any]], text: str, times: int) -> dict[str, Array]:
    """Return the arrays (times, columns) as the page decodes them."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).astype(np.int64)
    arrays, at = {}, 0
    for entry in entries:
        count = entry["columns"] * times
        words = data[at : at + count] + 256 * data[at + count : at + 2 * count]
        at += 2 * count
        twice = words.reshape(-1, times)
        levels = np.cumsum(np.cumsum(twice, axis=1) & 65535, axis=1) & 65535
        axes = len(entry["lower"])
        lower, step = (np.tile(entry[key], entry["columns"] // axes) for key in ("lower", "step"))
        arrays[entry["name"]] = levels.T * step + lower
    assert at == len(data)
    return arrays


def parts(path: Path) -> tuple[dict[str, Any], str]:
    """Return data and samples of a report."""
    scripts = re.findall(r'<script id="[^>]*>(.*?)</script>', path.read_text("utf-8"), re.DOTALL)
    return json.loads(scripts[0]), scripts[1]


@pytest.mark.parametrize("n", [3, 12])
def test_samples_are_the_plan_s_and_numbers_the_certificate_s(tmp_path: Path, n: int) -> None:
    motion, certificate = make_motion(n), made_certificate()
    write_report(tmp_path / "r.html", ho.Flight.of(motion), certificate, "Three")
    data, text = parts(tmp_path / "r.html")
    scene = scene_of(ho.Flight.of(motion))
    np.testing.assert_allclose(data["t"], scene.t, atol=1e-6)
    arrays = unpacked(data["arrays"], text, len(scene.t))
    drones = motion.drones.at(scene.t).reshape(len(scene.t), -1)
    np.testing.assert_allclose(arrays["drones"], drones, atol=1e-4)
    np.testing.assert_allclose(arrays["cables"], scene.cables.reshape(len(scene.t), -1), atol=1e-4)
    parts_sent, colours = {len(each["corners"]) for each in data["drone_parts"]}, data["colours"]
    assert min(parts_sent) > 0
    frame, rotors, rims = (each["colours"] for each in data["drone_parts"])
    assert (len(set(frame)), rims) == (1, colours)
    assert rotors[0::2] == colours[0::2] == colours[1::2] == data["cable_colours"]
    assert set(rotors[1::2]) == {"#ffffff"}  # those of drones r are open
    assert data["checks"][0]["concerned"]["drones"] == [0, 3]
    checks = [{k: v for k, v in each.items() if k != "concerned"} for each in data["checks"]]
    assert checks == certificate.to_dict()["checks"]
    listed = [name for group in data["groups"].values() for name, _ in group]
    assert sorted(listed) == sorted(check["name"] for check in checks)
    assert data["opens"] == 0.0  # the hitch stands from the beginning
    for plot, name in zip(data["plots"], ("separation", "speed", "thrust"), strict=False):
        assert plot["worst"] == {"time": certificate[name].time, "value": certificate[name].worst}


def test_no_text_ends_its_script_and_nothing_is_fetched(tmp_path: Path) -> None:
    evil = '</script><script>alert("x")</script><!-- %DATA% & "'
    write_report(tmp_path / "r.html", ho.Flight.of(make_motion(3)), made_certificate(), evil, evil)
    data, _ = parts(tmp_path / "r.html")
    assert data["title"] == data["problem"] == evil
    page = (tmp_path / "r.html").read_text("utf-8")
    assert page.count("<script") == 4
    assert "<script>alert" not in page
    assert "default-src 'none'" in page
    assert not re.search(r"<(link|img|iframe)\b|\b(src|href)=[\"']", page.split("<script>")[0])


@pytest.mark.slow
def test_report_of_a_directory_has_problem_and_digests(tmp_path: Path) -> None:
    problem = Path(__file__).parents[2] / "problems" / "triangle.yaml"
    out = tmp_path / "out"
    result = CliRunner().invoke(main, ["solve", str(problem), "-o", str(out), "--report"])
    assert result.exit_code == 0, result.output
    data, _ = parts(out / "report.html")
    assert data["problem"] == problem.read_text("utf-8") == ho.load(out).problem
    rows = dict(data["origin"])
    assert {"hitchopt", "numpy", "plan.npz, SHA-256", "problem file, SHA-256"} <= set(rows)
    first = (out / "report.html").read_bytes()
    (out / "report.html").unlink()
    assert CliRunner().invoke(main, ["report", str(out)]).exit_code == 0
    assert (out / "report.html").read_bytes() == first  # the same plan, the same bytes
    assert CliRunner().invoke(main, ["solve", str(problem), "-o", str(out)]).exit_code == 0
    assert not (out / "report.html").exists()  # it would tell of another solve
