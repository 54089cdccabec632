"""What left: every entry of the table is refused with its sentence, wherever a user writes it."""

from __future__ import annotations

import re
from typing import Any

import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.mission.loading import problem_from_dict
from hitchopt.retired import RETIRED, gone
from tests.helpers.plans import PROBLEMS

STEPS = {"tie", "untie", "open_vertex", "close_vertex"}

KEYS = {"form.by": "laying", "form.order": [2, 0, 1]}
"""Keys of steps with values that they had."""

OTHERS: dict[str, list[str]] = {
    f"--perturb {name}": ["simulate", ".", "--perturb", f"{name}=0.01"]
    for name in ("vertex_noise", "vertex_delay")
} | {kind: ["fit", f"part{kind}", "--robots", "3"] for kind in (".svg", ".dxf")}
"""Command lines that use an entry which is neither a name, a command, an option nor a step."""


def with_step(step: dict[str, Any]) -> dict[str, Any]:
    return {
        "team": {"robots": 3, "cable_length": 2.4},
        "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
        "mission": [{"hold": {"seconds": 1.0}}, step],
    }


def command_of(entry: str) -> list[str]:
    """Return the arguments of a command line with a command or an option that left."""
    return OTHERS.get(entry) or entry.removeprefix("hitchopt ").split()


@pytest.mark.parametrize("entry", RETIRED)
def test_every_entry_is_refused_with_its_sentence(entry: str) -> None:
    assert gone(entry).startswith(f"`{entry}` is gone; ")
    if entry.startswith("ho."):
        with pytest.raises(AttributeError) as missing:
            getattr(ho, entry.removeprefix("ho."))
        assert str(missing.value) == gone(entry)
    elif entry in STEPS:
        with pytest.raises(ho.InputError) as refused:
            problem_from_dict(with_step({entry: {}}))
        assert str(refused.value) == f"mission[1].{entry}: {gone(entry)}"
    elif entry in KEYS:
        step, _, key = entry.partition(".")
        with pytest.raises(ho.InputError) as refused:
            problem_from_dict(with_step({step: {key: KEYS[entry]}}))
        assert f"mission[1].{entry}: {gone(entry)}" in str(refused.value)
        with pytest.raises(TypeError, match=re.escape(gone(entry))):
            getattr(ho, step)(**{key: KEYS[entry]})
    else:
        done = CliRunner().invoke(main, command_of(entry))
        assert done.exit_code == 2, done.output
        assert gone(entry) in done.output


def test_the_command_line_names_the_line_of_a_step_that_left(tmp_path: Any) -> None:
    text = (PROBLEMS / "triangle.yaml").read_text()
    (tmp_path / "problem.yaml").write_text(f"{text.rstrip()}\n  - tie: {{around: drum}}\n")
    done = CliRunner().invoke(main, ["solve", str(tmp_path / "problem.yaml")])
    assert done.exit_code == 2
    assert f"].tie: {gone('tie')}" in done.output


@pytest.mark.parametrize(
    ("options", "entry"),
    [
        ({"feedback": True}, "simulate --feedback"),
        ({"perturbations": {"vertex_noise": 0.01}}, "--perturb vertex_noise"),
    ],
)
def test_scripts_are_told_what_left_simulate(options: dict[str, Any], entry: str) -> None:
    with pytest.raises(ho.InputError) as refused:
        ho.simulate("nowhere", **options)
    assert str(refused.value) == f"{entry}: {gone(entry)}"


@pytest.mark.parametrize("name", ["release", "form.assign", "tied", "retie", "ho.Lift", "tie.at"])
def test_other_names_are_not_refused(name: str) -> None:
    assert gone(name) == ""
