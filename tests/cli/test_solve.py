"""The problems of this repository, through solve and check."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from hitchopt.errors import FileError
from hitchopt.storage.yaml_file import read_yaml
from tests.helpers.baseline import SWARMS, differences
from tests.helpers.clocks import Clock
from tests.helpers.commands import TRIANGLE, refused, run
from tests.helpers.plans import GOOD, INFEASIBLE, ROOT, header, planned

pytestmark = pytest.mark.usefixtures("place")

CLOSE = ROOT / "problems" / "infeasible" / "drones_too_close.yaml"


def diagnosis() -> Any:
    assert [file.name for file in Path("out").iterdir()] == ["diagnosis.json"]
    return json.loads(Path("out/diagnosis.json").read_text())


# Problems that take longest
LONG = {
    "carry_box", "carry_tray", "crazyflie_triangle", "form_hexagon", "form_thirty_gon",
    "form_with_friction", "grip_drum", "octagon_turned", "paper_experiment_1",
    "past_a_star_tip",
    "roll_32_gon", "tie_carry_untie", "weight_form_and_carry",
}  # fmt: skip


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.slow if path.stem in LONG else (), id=path.stem)
        for path in GOOD
    ],
)
def test_good_problems_are_certified(path: Path) -> None:
    certificate = planned(path.stem).certificate
    assert certificate.certified
    assert not differences(certificate.to_dict(), path)


@pytest.mark.slow
@pytest.mark.parametrize("path", SWARMS, ids=lambda path: path.stem)
def test_swarms_are_planned_as_before(path: Path) -> None:
    assert not differences(planned(f"swarms/{path.stem}").certificate.to_dict(), path)


LONG_REFUSALS = {
    "form_cable_too_short", "form_ceiling_too_low", "same_goal",
}  # fmt: skip


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.slow if path.stem in LONG_REFUSALS else ())
        for path in INFEASIBLE
    ],
    ids=lambda path: path.stem,
)
def test_infeasible_problems_end_with_3_and_name_the_limits(path: Path) -> None:
    result = run("solve", path, "-o", "out", "--no-repair", code=3)
    binds = header(path, "Binds")
    told = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert any(line.startswith(f"error: {binds}") for line in told)
    assert all("; " in line for line in told)
    notes = [line for line in result.stderr.splitlines() if line.startswith("note: ")]
    assert result.stderr.splitlines()[-1] == "no plan; the diagnosis is in out/diagnosis.json"
    found = diagnosis()
    assert found["message"] == "\n".join(line.split(": ", 1)[1] for line in told + notes)
    assert binds in {violation["constraint"] for violation in found["violations"]}


def test_a_swarm_is_solved_and_looked_at_closely(place: Path) -> None:
    result = run("solve", SWARMS[0].with_name("head_on.yaml"), "--rate", "10", code=0)
    assert "give way to the right" in " ".join(result.stdout.split())
    names = {path.name for path in (place / "head_on").iterdir()}
    assert names == {"plan.npz", "setpoints.csv", "certificate.json", "summary.png"}
    shown = run("check", "head_on", "--closest", "--picture", "closest.png", code=0).stdout
    assert "Closest neighbours" in shown
    assert "d0, d1" in shown
    assert (place / "closest.png").read_bytes()[:4] == b"\x89PNG"


def test_check_repeats_the_certificate_from_the_plan_alone(place: Path) -> None:
    text = TRIANGLE.read_text(encoding="utf-8")
    weightless = re.sub(r"\n +cable_density:.*", "", text)
    fast = "--rate", "5", "--no-picture"
    for i, weight in enumerate(["0.0", "0.003"]):  # a choice
        stated = weightless.replace("team:\n", f"team:\n  cable_density: {weight}\n", 1)
        said = run("solve", "-", "-o", f"stated{i}", *fast, given=stated, code=0).stdout
        assert said.splitlines()[-1] == f"certified; the plan is in stated{i}"
    solved = run("solve", "-", "-o", "out", *fast, given=weightless, code=0)
    first = solved.stdout
    Path("mine.npz").write_bytes(Path("out/plan.npz").read_bytes())
    for name in ("setpoints.csv", "certificate.json", "vertices.csv"):
        Path("out", name).unlink()
    checked = run("check", "out", code=0).stdout
    *_, last, note = checked.splitlines()
    assert last == "certified; recomputed from out/plan.npz"
    assert note == first.splitlines()[-1]
    assert re.fullmatch(
        r"note: cables are assumed weightless; at 10 g/m vertices would hang [\d.]+ cm lower: "
        r"state team\.cable_density",
        note,
    )
    assert first[first.index("Phases") : first.index("certified;")] in checked
    wider = run("check", "mine.npz", "--gamma", "2.5", code=0).stdout
    for said, gamma in ((checked, "1"), (wider, "2.5")):
        assert re.search(rf"tracking_radius +[0-9.e-]+ +γ = {gamma} ", said)
    assert "gamma = -1" in run("check", "mine.npz", "--gamma", "-1", code=2).stderr
    assert note in run("export", "out/plan.npz", "--format", "csv", code=0).stdout.splitlines()
    assert (place / "out-csv").is_dir()


def test_a_limit_ends_solve_and_search_with_a_diagnosis(clock: Clock) -> None:
    told = run("solve", TRIANGLE, "-o", "out", "--limit", "1e-9", code=3).stderr
    assert "s is above the limit of 1e-09 s (last: " in told
    (violation,) = diagnosis()["violations"]
    assert (violation["constraint"], violation["limit"]) == ("time limit", 1e-9)
    clock.tick = 1.0
    told = run("solve", CLOSE, "-o", "out", "--limit", "60", code=3).stderr
    note = "the search for changes ended at the time limit (--limit)"
    assert note in told.splitlines()
    assert note in diagnosis()["message"]


def test_a_refusal_suggests_changes(place: Path) -> None:
    result = run("solve", CLOSE, "-o", "out", "--repair-to", "own", code=3)
    told = [line for line in result.stderr.splitlines() if line.startswith("suggested change: ")]
    found = diagnosis()
    assert [entry["message"] for entry in found["suggestions"]] == told
    best = found["suggestions"][0]
    assert (best["key"], best["old"], best["unit"]) == ("team.cable_length", 1.2, "m")
    assert best["edits"] == [{"key": "team.cable_length", "value": best["new"]}]
    assert best["relative"] == pytest.approx(best["new"] / 1.2 - 1.0)
    assert "0.141 m apart, 0.0986 m too close: " in result.stderr  # 0.1 m times the root of 2
    text = CLOSE.read_text().replace("cable_length: 1.2", f"cable_length: {best['new']}")
    (place / "mended.yaml").write_text(text)
    run("solve", "mended.yaml", "--rate", "5", "--no-picture", code=0)
    assert "wrote own.yaml" in result.stderr
    assert (place / "own.yaml").read_text() == text
    stderr = run("solve", CLOSE, "--repair-to", "two.yaml", "--take", "2", code=3).stderr
    assert "wrote two.yaml, with the second change" in stderr
    (edit,) = found["suggestions"][1]["edits"]
    second: Any = read_yaml(place / "two.yaml")
    assert second["start"]["hitch"]["polygon"] == edit["value"]
    stderr = run("solve", CLOSE, "--repair-to", "three.yaml", "--take", "3", code=3).stderr
    assert "three.yaml is not written: there is no suggestion 3 (--take)" in stderr
    assert not (place / "three.yaml").exists()
    path = CLOSE.with_name("points_begin_elsewhere.yaml")  # nothing mends it
    told = run("solve", path, "-o", "out", code=3).stderr.splitlines()
    assert "no change was found that makes it feasible" in told
    assert diagnosis()["suggestions"] == []


def test_interrupts_are_quiet_and_leave_the_diagnosis(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hitchopt.cli.planning.hooks", lambda _: (interrupted,))
    run("solve", CLOSE, "-o", "out", code=130)
    found = diagnosis()
    assert (found["violations"][0]["constraint"], found["suggestions"]) == ("separation", [])
    monkeypatch.setattr("hitchopt.solve", interrupted)
    assert run("solve", TRIANGLE, "-o", "other", code=130).output == ""
    assert not Path("other").exists()


DRAW = "hitchopt.view.of_plans.draw_summary"


@pytest.mark.filterwarnings("always::hitchopt.errors.FaultWarning")
def test_a_plan_is_printed_and_stored_before_it_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    def solved(
        *options: str, drawing: type[BaseException] | None = None, code: int = 0
    ) -> tuple[set[str], str]:
        """Return the files that are left and the output; drawing may end with an exception."""

        def draw(*_: object) -> None:
            assert Path("out/certificate.json").is_file()
            assert not Path("out/summary.png").exists()  # the previous plan's picture
            raise drawing or AssertionError

        with monkeypatch.context() as patch:
            if drawing is not None:
                patch.setattr(DRAW, draw)
            result = run("solve", TRIANGLE, "-o", "out", "--rate", "5", *options, code=code)
        return {path.name for path in Path("out").iterdir()}, result.output

    plan = {"plan.npz", "setpoints.csv", "vertices.csv", "certificate.json"}
    names, told = solved()
    assert names == {*plan, "summary.png"}
    assert solved(drawing=KeyboardInterrupt, code=130) == (plan, told)
    run("check", "out", code=0)
    assert solved() == ({*plan, "summary.png"}, told)
    remedy = "cannot be written: ; free space there, or name another directory"
    warning = f"warning: summary.png failed: out: {remedy}\n"
    assert solved(drawing=OSError) == (plan, told + warning)
    assert solved("--no-picture", drawing=AssertionError) == (plan, told)
    assert solved("-q", drawing=AssertionError) == (plan, "")


def test_a_picture_goes_to_its_own_plan_only(place: Path) -> None:
    first, second = planned("triangle"), planned("pentagon")
    first.save("out", rate=5.0)
    second.save("out", rate=5.0, picture=True)
    with pytest.raises(
        FileError, match=r"summary\.png: is not written: the directory has another plan"
    ):
        first.draw("out")
    picture = (place / "out" / "summary.png").read_bytes()
    assert second.draw("out").read_bytes() == picture
    with pytest.raises(FileError, match="is not written"):
        first.draw("nowhere")
    assert {path.name for path in place.iterdir()} == {"out"}


@pytest.mark.slow
def test_the_directory_has_the_files_of_the_last_solve(place: Path) -> None:
    said = run("solve", TRIANGLE, "-o", "out", "--rate", "5", code=0).stdout
    assert "certified; the plan is in out" in said.splitlines()[-2:]
    certificate = json.loads(Path("out/certificate.json").read_text())
    assert certificate["checks"] == planned("triangle").certificate.to_dict()["checks"]
    assert all(check["name"] in said for check in certificate["checks"])
    (place / "out" / "mine.txt").write_text("precious")
    before = {file.name: file.read_bytes() for file in (place / "out").iterdir()}
    (place / "bad.yaml").write_text("team: 3\n")
    run("solve", "bad.yaml", "-o", "out", code=2)
    assert {file.name: file.read_bytes() for file in (place / "out").iterdir()} == before
    for _ in range(2):
        told = refused("solve", CLOSE, "-o", "out", "--no-repair", code=3)
        assert told.splitlines()[-1].endswith("; the last certified plan is in out/previous")
        left = {file.name for file in (place / "out").iterdir()}
        assert left == {"diagnosis.json", "mine.txt", "previous"}
        run("check", "out/previous", code=0)
    run("solve", TRIANGLE, "-o", "out", "--rate", "5", code=0)
    names = {file.name for file in (place / "out").iterdir()}
    assert names >= {"plan.npz", "setpoints.csv", "mine.txt"}
    assert not names & {"diagnosis.json", "previous"}
