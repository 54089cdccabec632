from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from handmade import made_certificate, made_motion

from hitchopt.checks.certificate import Certificate, CertificateError, Check
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, Violation
from hitchopt.exports.directory import OWNED, save_diagnosis, save_plan
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan, read_title


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


def test_the_certificate_is_strict_json(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    save_plan(tmp_path, motion, certificate, rate=5.0)
    data = strict_json(tmp_path / "certificate.json")
    assert data["format"] == "hitchopt-certificate/1"
    assert data["certified"] is True
    assert data["duration"] == 2.53
    assert [check["worst"] for check in data["checks"]] == [1.3, None, 0.5]
    keys = ["name", "holds", "worst", "limit", "sense", "unit", "time", "where", "method"]
    assert list(data["checks"][0]) == keys
    assert data["checks"][0]["where"] == ["q0", "r3"]


def test_a_plan_that_is_not_certified_is_refused(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    with pytest.raises(CertificateError, match="legs"):
        save_plan(tmp_path / "out", motion, failing(certificate))
    assert not (tmp_path / "out").exists()


def test_a_failing_picture_leaves_nothing(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    def broken(path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError(5, "Input/output error", str(path))

    with pytest.raises(FileError, match=r"Input/output error \(summary\.png\)"):
        save_plan(tmp_path / "out", motion, certificate, rate=5.0, pictures={"summary.png": broken})
    with pytest.raises(InputError, match="rate"):
        save_plan(tmp_path / "out", motion, certificate, rate=-5.0)
    assert names(tmp_path) == set()


def test_the_directory_tells_the_last_solve(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    violation = Violation("legs", 0.1, 0.15, "min", "m", ("q0",), "at t = 0 s", "longer cable")
    save_plan(tmp_path, motion, certificate, rate=5.0, pictures=PICTURES)
    save_diagnosis(tmp_path, InfeasibleError([violation]))
    assert names(tmp_path) == {"notes.txt", "diagnosis.json", "previous"}
    assert names(tmp_path / "previous") == set(SAVED)
    save_plan(tmp_path, motion, certificate, rate=5.0)  # no picture this time
    assert names(tmp_path) == {"notes.txt", *SAVED} - {"summary.png"}
    for _ in range(3):
        save_diagnosis(tmp_path, HitchoptError("not found"))
        assert names(tmp_path) == {"notes.txt", "diagnosis.json", "previous"}
        assert names(tmp_path / "previous") == {*SAVED} - {"summary.png"}
        assert read_title(tmp_path / "previous" / "plan.npz") == ""
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert set(OWNED) == {
        *SAVED,
        "diagnosis.json",
        "report.html",
        "statics.json",
        "statics.png",
    } | {
        "aborts.json",
        "aborts.zip",
    }


@pytest.mark.parametrize("exchanging", [True, False])
def test_others_files_in_previous_stay(
    motion: Motion,
    certificate: Certificate,
    tmp_path: Path,
    exchanging: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(38, "no such call")

    if not exchanging:
        monkeypatch.setattr("hitchopt.storage.directory_swap.exchange", refuse)
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


def test_what_else_is_called_previous_is_not_touched(
    motion: Motion, certificate: Certificate, tmp_path: Path
) -> None:
    (tmp_path / "previous").write_text("mine")
    words = "is where hitchopt keeps the last plan; move it away"
    with pytest.raises(FileError, match=words):
        save_plan(tmp_path, motion, certificate, rate=5.0)
    with pytest.raises(FileError, match=words):
        save_diagnosis(tmp_path, HitchoptError("not found"))
    assert names(tmp_path) == {"previous"}
    assert (tmp_path / "previous").read_text() == "mine"


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


def test_a_diagnosis_of_a_planner_that_failed_has_its_words(tmp_path: Path) -> None:
    save_diagnosis(tmp_path, HitchoptError("no profile was found"))
    data = strict_json(tmp_path / "diagnosis.json")
    assert (data["feasible"], data["violations"]) == (False, [])
    assert data["message"] == "no profile was found"
