"""Tables and progress, as a terminal and a pipe see them."""

from __future__ import annotations

import io
import re
import time

import pytest

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.cli.output import (
    LateProgress,
    certificate_table,
    done_of,
    phase_table,
)
from hitchopt.motion.motion import Phase

pytestmark = pytest.mark.usefixtures("place")

CERTIFICATE = Certificate(
    12.5,
    (
        Check.of("speed", 0.95, 1.0, "max", "m/s", 1.0, ("q0",)),
        Check.of("thrust", 1.3, 2.6, "max", "N", 1.0, ("q0",)),
        Check.of("separation", 1.0625, 1.0, "min", "ratio", 3.25, ("q11", "r3")),
        Check.of("cable_clearance", 0.0875, 0.1, "min", "m", 4.5, ("q11", "cable 10")),
        Check.of("crossing", float("inf"), 0.05, "min", "m", 0.0, ()),
        Check.of("tracking_radius", 0.0125, None, "min", "m", 3.5, ("q0", "r1"), gamma=1.5),
        Check.of("span", 0.9, 1.0, "max", "ratio", 1.5, tuple(f"cable {k}" for k in range(99))),
        Check.of("interlacing", 0, 0, "max", "1", 1.5, ()),
        Check.of("convexity", 3.0, 0.0, "min", "deg", 1.5, ("p0",)),
        Check.of("wobble", 1.0, 9.0, "max", "1", 1.5, ()),
    ),
)


CHECKS = {check.name for check in CERTIFICATE.checks}


def cells(text: str) -> list[list[str]]:
    return [re.split(r"  +", line.strip()) for line in text.splitlines()]


def test_phases_are_shown_with_their_times() -> None:
    rows = cells(phase_table((Phase("morph", 0, 0.0, 1.25), Phase("hold [b]", 1, 1.25, 12.5))))
    assert rows[-2:] == [
        ["morph", "0", "0.000 s", "1.250 s", "1.250 s"],
        ["hold [b]", "1", "1.250 s", "12.500 s", "11.250 s"],
    ]


def test_checks_stand_under_headings_and_the_closest_three_are_marked() -> None:
    shown = certificate_table(CERTIFICATE)
    rows = cells(shown)
    for row in (
        "check|worst|limit|unit|where|when|holds",
        "separation|1.0625|≥ 1|ratio|q11, r3|3.250 s|yes|◂",
        "cable_clearance|0.0875|≥ 0.1|m|q11, cable 10|4.500 s|NO|◂",
        "crossing|–|≥ 0.05|m|yes",
        "tracking_radius|0.0125|γ = 1.5|m|q0, r1|3.500 s|yes",
    ):
        assert row.split("|") in rows
    assert "and 95 more" in shown
    named = [row[0] for row in rows[4:] if row[0].endswith(":") or row[0] in CHECKS]
    assert " ".join(named) == (
        "distances: separation cable_clearance crossing tracking_radius motion: speed "
        "forces: thrust cables: span interlacing convexity other: wobble"
    )
    closest = [row[0] for row in rows if row[-1] == "◂"]
    assert closest == ["separation", "cable_clearance", "speed"]  # 6 %, broken, 5 % of the limit
    assert [c.name for c in CERTIFICATE.closest] == ["cable_clearance", "speed", "separation"]
    # A pipe gets neither colours nor cuts.
    assert not {"\x1b", "…"} & set(shown)
    assert all(len(line) <= 100 and line == line.rstrip() for line in shown.splitlines())


def test_every_check_has_a_heading() -> None:
    from hitchopt.checks.certificate import GROUPS
    from hitchopt.checks.registry import REPORTS, RULES

    grouped = [name for names in GROUPS.values() for name in names]
    named = {rule.name for rule in (*RULES, *REPORTS)} | {"survivable"}
    assert set(grouped) == named
    assert len(grouped) == len(named)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown_by(stream: io.StringIO, delay: float, words: str) -> str:
    with LateProgress("planning", 600.0, stream=stream, delay=delay) as progress:
        progress("timing [step 1]")
        deadline = time.monotonic() + (10.0 if words else 0.1)
        while time.monotonic() < deadline and not (words and words in stream.getvalue()):
            time.sleep(0.01)
    return stream.getvalue()


def test_a_terminal_sees_a_bar_once_it_takes_long() -> None:
    assert "timing [step 1]" in shown_by(Terminal(), 0.01, "timing [step 1]")
    assert "of at most 600 s" in shown_by(Terminal(), 0.01, "of at most 600 s")
    assert shown_by(Terminal(), 60.0, "") == ""
    assert shown_by(io.StringIO(), 0.0, "") == ""  # a file sees none


@pytest.mark.parametrize(
    ("message", "done"),
    [
        ("speed, 3 of 22", (3.0, 22.0)),
        ("flying, 1.5 of 12.0 s", (1.5, 12.0)),
        ("writing setpoints, 40%", (40.0, 100.0)),
        ("splitting the slack", (None, None)),
        ("0 of 0 done", (None, None)),
    ],
)
def test_counts_fill_the_bar(message: str, done: tuple[float | None, float | None]) -> None:
    assert done_of(message) == done
