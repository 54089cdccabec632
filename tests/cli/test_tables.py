from __future__ import annotations

import io
import re
import time

import pytest

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.cli.console_tables import certificate_table, new_table, number, phase_table, rendered
from hitchopt.cli.progress import LateProgress
from hitchopt.motion.motion import Phase

CERTIFICATE = Certificate(
    12.5,
    (
        Check.of("separation", 1.0625, 1.0, "min", "ratio", 3.25, ("q11", "r3")),
        Check.of("cable_clearance", 0.0875, 0.1, "min", "m", 4.5, ("q11", "cable 10")),
        Check.of("crossing", float("inf"), 0.05, "min", "m", 0.0, ()),
        Check.of("tracking_radius", 0.0125, None, "min", "m", 3.5, ("q0", "r1"), gamma=1.5),
        Check.of("interlacing", 2, 0, "max", "1", 1.5, tuple(f"cable {k}" for k in range(99))),
    ),
)


def cells(table: str) -> list[list[str]]:
    return [re.split(r"  +", line.strip()) for line in table.splitlines()]


def test_phases_are_shown_with_their_times() -> None:
    phases = (Phase("morph", 0, 0.0, 1.25), Phase("hold [b]", 1, 1.25, 12.5))
    rows = cells(phase_table(phases))
    assert ["phase", "step", "start", "end", "duration"] in rows
    assert ["morph", "0", "0.000 s", "1.250 s", "1.250 s"] in rows
    assert ["hold [b]", "1", "1.250 s", "12.500 s", "11.250 s"] in rows


def test_brackets_are_text_in_every_part_of_a_table() -> None:
    table = new_table("Errors [cm]", ["vertex [p]"], ["error [cm]", "pull [N]"])
    table.add_row("all [m]", "1.5 [/b]", ":cat: [red]2[/red]")
    shown = rendered(table)
    for text in ("Errors [cm]", "vertex [p]", "error [cm]", "pull [N]", "all [m]", "1.5 [/b]"):
        assert text in shown
    assert ":cat: [red]2[/red]" in shown


def test_checks_are_shown_with_value_limit_place_and_verdict() -> None:
    table = certificate_table(CERTIFICATE)
    rows = cells(table)
    assert ["check", "worst", "limit", "unit", "where", "when", "holds"] in rows
    assert ["separation", "1.0625", "≥ 1", "ratio", "q11, r3", "3.250 s", "yes"] in rows
    assert ["cable_clearance", "0.0875", "≥ 0.1", "m", "q11, cable 10", "4.500 s", "NO"] in rows
    assert ["crossing", "–", "≥ 0.05", "m", "yes"] in rows
    assert ["tracking_radius", "0.0125", "γ = 1.5", "m", "q0, r1", "3.500 s", "yes"] in rows
    assert "and 95 more" in table


def test_a_pipe_gets_neither_colours_nor_cuts() -> None:
    table = certificate_table(CERTIFICATE)
    assert "\x1b" not in table
    assert "…" not in table
    assert max(len(line) for line in table.splitlines()) <= 100
    assert not any(line.endswith(" ") for line in table.splitlines())


def test_numbers_have_six_digits() -> None:
    assert [number(x) for x in (1 / 3, 1e-7, 123456.7)] == ["0.333333", "1e-07", "123457"]
    assert [number(x) for x in (float("inf"), -1.7976931348623157e308)] == ["inf", "-inf"]
    assert number(None) == "–"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_a_bar_once_it_takes_long() -> None:
    terminal = Terminal()
    with LateProgress(terminal, "planning", delay=0.01) as progress:
        progress("timing [step 1]")
        deadline = time.monotonic() + 10.0
        while "timing" not in terminal.getvalue() and time.monotonic() < deadline:
            time.sleep(0.01)
        progress("certifying")
    assert "timing [step 1]" in terminal.getvalue()


def test_a_terminal_sees_how_long_it_takes_at_most() -> None:
    terminal = Terminal()
    with LateProgress(terminal, "planning", 600.0, delay=0.01):
        deadline = time.monotonic() + 10.0
        while "of at most 600 s" not in terminal.getvalue() and time.monotonic() < deadline:
            time.sleep(0.01)
    assert "of at most 600 s" in terminal.getvalue()


def test_what_is_quick_stays_silent() -> None:
    terminal = Terminal()
    with LateProgress(terminal, "planning", delay=60.0) as progress:
        progress("timing")
    assert terminal.getvalue() == ""


def test_a_file_sees_no_bar() -> None:
    file = io.StringIO()
    with LateProgress(file, "planning", delay=0.0) as progress:
        progress("timing")
        time.sleep(0.1)
    assert file.getvalue() == ""


def test_an_error_passes_through_the_bar() -> None:
    def fail() -> None:
        with LateProgress(Terminal(), "planning", delay=0.0):
            time.sleep(0.05)
            raise ValueError("inside")

    with pytest.raises(ValueError, match="inside"):
        fail()
