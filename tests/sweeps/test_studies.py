"""Studies: their parameters, their cases, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hitchopt.errors import FileError, HitchoptError, InputError
from hitchopt.sweeps.study import ParameterKeys, points, study_from_dict, with_values

PROBLEM: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}],
}
LOG = {"from": 0, "to": 2, "count": 3, "log": True}


def test_every_combination_occurs_once() -> None:
    grids = {"b": {"from": 1.0, "to": 4.0, "count": 3, "log": True}}
    grids["c"] = {"from": -1.0, "to": 1.0, "count": 5}
    spans = {key: ParameterKeys.model_validate({"grid": each}) for key, each in grids.items()}
    found = points({"a": [1, 2], **spans})
    even = [-1.0, -0.5, 0.0, 0.5, 1.0]
    wanted = [{"a": a, "b": b, "c": c} for a in (1, 2) for b in (1.0, 2.0, 4.0) for c in even]
    assert [list(point) for point in found] == [["a", "b", "c"]] * 30
    rows = [[float(str(x)) for x in point.values()] for point in found]
    np.testing.assert_allclose(rows, [list(point.values()) for point in wanted])


def test_values_are_set_in_a_copy() -> None:
    made: Any = with_values(PROBLEM, {"team.tension": 0.3, "mission[0].morph.duration": 9.0})
    assert made["team"] == {"robots": 3, "cable_length": 2.4, "tension": 0.3}
    assert made["mission"][0]["morph"]["duration"] == 9.0
    assert "tension" not in PROBLEM["team"]
    assert "duration" not in PROBLEM["mission"][0]["morph"]
    assert with_values(PROBLEM, {"limits.speed": 2})["limits"] == {"speed": 2}
    for key in (
        "mission[1].hold",
        "mission.morph",
        "team.robots.x",
        "team[0]",
        "team..x",
        "mission[0]x",
    ):
        with pytest.raises(InputError, match="parameters"):
            with_values(PROBLEM, {key: 1})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": {"team.tensoin": [0.3]}}, "did you mean tension"),
        ({"parameters": {"team.tension": [0.3, -1.0]}}, "team.tension"),
        ({"parameters": {"team.tension": {"grid": {"from": 1, "to": 0, "count": 3}}}}, "below"),
        ({"parameters": {"team.tension": {"grid": LOG}}}, "log"),
        ({"parameters": {"team.tension": {"list": [1]}}}, "team.tension"),
        ({"parameters": {"team.tension": []}}, "team.tension"),
        ({"parameters": {"simulate.wind": [0.1]}}, "add simulate"),
        ({"simulate": {"wind": -1}}, "simulate.wind"),
        ({"simulate": {}, "parameters": {"simulate.wnd": [0.1]}}, "simulate.wnd"),
        ({"paramters": {}}, "did you mean parameters"),
        ({"limit": 0}, "limit"),
        ({"problem": []}, "write triangle.yaml"),
        ({"problem": [3]}, "problem = "),
        ({"problem": "no_such_file.yaml"}, "no such file"),
    ],
)
def test_studies_that_are_wrong_say_where(change: dict[str, Any], words: str) -> None:
    with pytest.raises(HitchoptError, match=words):
        study_from_dict({"problem": PROBLEM, **change})


def test_cases_are_told_apart_by_all_that_counts() -> None:
    parameters = {"team.tension": [0.3, 0.4], "simulate.wind": [0.0, 0.1]}
    given = {"problem": PROBLEM, "parameters": parameters, "simulate": {"seeds": 3, "seed": 5}}
    cases = list(study_from_dict(given).cases())
    assert len({case.digest for case in cases}) == len(cases) == 12
    assert [case.seed for case in cases[:4]] == [5, 6, 7, 5]
    assert cases[0].simulate is not None
    assert cases[0].simulate["wind"] == 0.0
    assert "seeds" not in cases[0].simulate  # more seeds leave the rows of the first ones
    assert "simulate" not in cases[0].problem
    sections = [{**PROBLEM["team"], "tension": value} for value in (0.3, 0.4)]
    whole = study_from_dict({"problem": PROBLEM, "parameters": {"team": sections}})
    assert [case.problem["team"] for case in whole.cases()] == sections


def test_drawings_can_be_a_parameter(tmp_path: Path) -> None:
    """Cases hold their outlines, and digests depend on these."""
    for name, width in (("a", 0.4), ("b", 0.6)):
        shape = f'<rect x="0" y="0" width="{width}" height="0.3"/>'
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1">{shape}</svg>'
        (tmp_path / f"{name}.svg").write_text(svg)
    box = {"file": "a.svg", "at": [3.0, 0.0, 0.0], "fixed": True}
    study = {
        "problem": PROBLEM | {"objects": {"box": box}},
        "parameters": {"objects.box.file": ["a.svg", "b.svg"]},
    }
    first, second = study_from_dict(study, tmp_path).cases()
    assert [first.point, second.point] == [{"objects.box.file": f} for f in ("a.svg", "b.svg")]
    for case, width in ((first, 0.4), (second, 0.6)):
        made: Any = case.problem["objects"]
        assert "file" not in made["box"]
        outline = np.array(made["box"]["outline"], dtype=np.float64)
        np.testing.assert_allclose(np.ptp(outline, axis=0), [width, 0.3], atol=1e-9)
    (tmp_path / "b.svg").write_text((tmp_path / "a.svg").read_text())
    again = list(study_from_dict(study, tmp_path).cases())
    assert (again[0].digest, again[1].digest != second.digest) == (first.digest, True)
    with pytest.raises(FileError, match=r"c\.svg"):
        study_from_dict({**study, "parameters": {"objects.box.file": ["c.svg"]}}, tmp_path)
