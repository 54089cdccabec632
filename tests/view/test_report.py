"""The report is one file without addresses; its samples are the plan's, its numbers the checks'."""

from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from pictured import made_certificate, make_motion

from hitchopt.cli import main
from hitchopt.exports.directory import OWNED
from hitchopt.plan import Plan, load
from hitchopt.values import Array
from hitchopt.view.report import write_report
from hitchopt.view.scene import scene_of


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
    page = path.read_text("utf-8")
    found = [
        re.search(rf'<script id="{name}"[^>]*>(.*?)</script>', page, re.DOTALL)
        for name in ("data", "samples")
    ]
    data, samples = (each[1] for each in found if each)
    return json.loads(data), samples


@pytest.mark.parametrize("n", [3, 12])
def test_samples_are_the_plan_s_and_numbers_the_certificate_s(tmp_path: Path, n: int) -> None:
    motion, certificate = make_motion(n), made_certificate()
    write_report(tmp_path / "r.html", motion, certificate, "Three")
    data, text = parts(tmp_path / "r.html")
    scene = scene_of(motion)
    np.testing.assert_allclose(data["t"], scene.t, atol=1e-6)
    found = unpacked(data["arrays"], text, len(scene.t))
    drones = motion.drones.at(scene.t).reshape(len(scene.t), -1)
    np.testing.assert_allclose(found["drones"], drones, atol=1e-4)
    np.testing.assert_allclose(found["cables"], scene.cables.reshape(len(scene.t), -1), atol=1e-4)
    for shown, check in zip(data["checks"], certificate.checks, strict=True):
        for name in ("name", "holds", "worst", "limit", "sense", "unit", "time"):
            assert shown[name] == getattr(check, name)
    assert data["checks"][0]["concerned"]["drones"] == [0, 3]
    for plot, name in zip(data["plots"], ("separation", "speed", "thrust"), strict=False):
        assert plot["worst"] == {"time": certificate[name].time, "value": certificate[name].worst}


def test_no_text_ends_its_script_and_nothing_is_fetched(tmp_path: Path) -> None:
    evil = '</script><script>alert("x")</script><!-- %DATA% & "'
    write_report(tmp_path / "r.html", make_motion(3), made_certificate(), evil, evil)
    data, _ = parts(tmp_path / "r.html")
    assert data["title"] == data["problem"] == evil
    page = (tmp_path / "r.html").read_text("utf-8")
    assert page.count("<script") == 4
    assert "alert(" not in re.sub(r"\\u003c/script>\\u003cscript>alert", "", page).split("&lt;")[0]
    assert "default-src 'none'" in page
    assert not re.search(r"<(link|img|iframe)\b|\b(src|href)=[\"']", page.split("<script>")[0])


@pytest.mark.slow
def test_report_of_a_directory_has_problem_and_digests(tmp_path: Path) -> None:
    problem = Path(__file__).parents[2] / "problems" / "triangle.yaml"
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["solve", str(problem), "-o", str(out), "--report"])
    assert done.exit_code == 0, done.output
    data, _ = parts(out / "report.html")
    assert data["problem"] == problem.read_text("utf-8") == load(out).problem
    rows = dict(data["origin"])
    assert {"hitchopt", "numpy", "plan.npz, SHA-256", "problem file, SHA-256"} <= set(rows)
    first = (out / "report.html").read_bytes()
    (out / "report.html").unlink()
    assert CliRunner().invoke(main, ["report", str(out)]).exit_code == 0
    assert (out / "report.html").read_bytes() == first  # the same plan, the same bytes
    assert "report.html" in OWNED
    again = CliRunner().invoke(main, ["solve", str(problem), "-o", str(out)])
    assert again.exit_code == 0
    assert not (out / "report.html").exists()  # it would tell of another solve


@pytest.mark.slow
def test_thirty_seconds_of_24_drones_take_3_megabytes_at_most(tmp_path: Path) -> None:
    motion = make_motion(12).slowed(30.0 / 3.1)
    path = Plan(motion, made_certificate()).report(tmp_path)
    assert motion.duration == pytest.approx(30.0)
    assert path.stat().st_size < 3e6
