from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from handmade import made_certificate, made_motion

from hitchopt.checks.certificate import Certificate, CertificateError, Check
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, Violation
from hitchopt.exports.directory import refuse_mixture, save_diagnosis, save_plan
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan, read_title
from hitchopt.simulation.task import read_task


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


@pytest.fixture
def certificate() -> Certificate:
    return made_certificate()


SAVED = ("plan.npz", "setpoints.csv", "vertices.csv", "certificate.json", "summary.png")


def draw(path: Path) -> None:
    path.write_bytes(b"PNG")


PICTURES = {"summary.png": draw}


def strict_json(path: Path) -> Any:
    def refuse(word: str) -> NoReturn:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def names(directory: Path) -> set[str]:
    return {p.name for p in directory.iterdir()}


def failing(certificate: Certificate) -> Certificate:
    bad = Check("thrust", False, float("nan"), 2.6, "max", "N", 0.5, ("q0", "r1"))
    low = Check.of("legs", 0.1, 0.15, "min", "m", 1.25, ("q2",))
    return dataclasses.replace(certificate, checks=(*certificate.checks, low, bad))


def test_a_certified_plan_leaves_its_files(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done: list[float] = []
    assert save_plan(out, motion, certificate, "Vier", 20.0, PICTURES, done.append) == out
    assert names(out) == set(SAVED)
    assert done[-1] == 1.0
    assert read_title(out / "plan.npz") == "Vier"
    coefficients = read_plan(out / "plan.npz").drones.coefficients
    assert np.array_equal(coefficients, motion.drones.coefficients)
    assert len((out / "setpoints.csv").read_text().splitlines()) == 1 + 8 * 52  # 0 … 2.5 and 2.53
    assert len((out / "vertices.csv").read_text().splitlines()) == 1 + 4 * 52
    assert names(tmp_path) == {"out"}


def test_a_plan_that_is_not_certified_is_refused(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    with pytest.raises(CertificateError, match="legs"):
        save_plan(tmp_path / "out", motion, failing(certificate))
    assert not (tmp_path / "out").exists()


def test_others_files_in_previous_stay(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    save_plan(tmp_path, motion, certificate, rate=5.0)
    save_diagnosis(tmp_path, HitchoptError("not found"))
    kept = tmp_path / "previous"
    (kept / "notes.txt").write_text("mine")
    save_diagnosis(tmp_path, HitchoptError("not found again"))
    assert names(kept) == {"notes.txt", *SAVED} - {"summary.png"}
    save_plan(tmp_path, motion, certificate, "again", rate=5.0)
    assert names(kept) == {"notes.txt"}
    save_diagnosis(tmp_path, HitchoptError("not found"))
    assert names(kept) == {"notes.txt", *SAVED} - {"summary.png"}
    assert read_title(kept / "plan.npz") == "again"
    assert (kept / "notes.txt").read_text() == "mine"
    assert names(tmp_path) == {"diagnosis.json", "previous"}
    assert [path.name for path in tmp_path.parent.glob(f".{tmp_path.name}*")] == []


def test_files_of_different_plans_are_refused(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    one, other = (
        save_plan(tmp_path / title, motion, certificate, title, 5.0) for title in ("one", "other")
    )
    refuse_mixture(one)
    plan = (one / "plan.npz").read_bytes()
    assert strict_json(one / "certificate.json")["plan"] == hashlib.sha256(plan).hexdigest()
    (other / "plan.npz").write_bytes(plan)
    with pytest.raises(FileError, match=r"certificate\.json: is of another plan\.npz"):
        refuse_mixture(other)
    with pytest.raises(FileError, match="is of another"):
        read_task(other)
    (one / "certificate.json").unlink()
    with pytest.raises(FileError, match="was a save killed"):
        read_task(one)


def test_a_diagnosis_of_what_cannot_be_met(tmp_path: Path) -> None:
    where = ("q0", "r2")
    first = Violation("legs", -0.1, 0.15, "min", "m", where, "at the start", "lengthen cable 0")
    second = Violation("duration", float("inf"), 3.0, "max", "s", (), "", "allow more – länger")
    save_diagnosis(tmp_path, InfeasibleError([first, second]))
    data = strict_json(tmp_path / "diagnosis.json")
    assert (data["format"], data["feasible"]) == ("hitchopt-diagnosis/1", False)
    assert data["violations"][0] == {
        "constraint": "legs",
        "value": -0.1,
        "limit": 0.15,
        "sense": "min",
        "unit": "m",
        "where": ["q0", "r2"],
        "when": "at the start",
        "remedy": "lengthen cable 0",
        "message": str(first),
    }
    assert data["violations"][1]["value"] is None
    assert data["violations"][1]["remedy"] == "allow more – länger"
