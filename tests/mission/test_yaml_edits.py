"""Changes of the text of a YAML file: the values change, all else stays."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.errors import FileError, InputError
from hitchopt.storage.yaml_file import (
    parse_yaml,
    split_key,
    value_at,
    with_entry,
    with_entry_moved,
    with_value,
    without_entry,
)

TEXT = """\
# A head.
title: 'It''s one'   # quoted
team: {robots: 3,  cable_length: 2.40}
limits:
  speed: 0.50  # slow

start:
  hitch:
    polygon:
    - [0, -1]   # the first
    - [-0.4, 5.0e-1]
    - [0.4, 0.5]
mission:
  # go
  - morph: {polygon: [[0, -0.5], [-0.4, 0.5],
                      [0.4, 0.5]]}  # in two lines
  # stay
  - hold: {seconds: 1.0}
  - morph:
      blend: false

# The end.
"""

MISSION = ("mission",)


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("start.hitch.polygon", [[0, -1], [-0.4, 0.7], [0.4, 0.5]], "    - [-0.4, 0.7]"),
        ("limits.jerk", 4.0, "  jerk: 4.0"),
        ("limits.speed", 0.25, "  speed: 0.25  # slow"),
        ("team.load", [0.1, 0], "team: {robots: 3,  cable_length: 2.40, load: [0.1, 0]}"),
        ("mission[1].hold.seconds", 2, "  - hold: {seconds: 2}"),
        ("mission[2].morph.optimize", True, "      optimize: true"),
        ("arena.lower", [0, 0, 0], "arena: {lower: [0, 0, 0]}"),
        ("title", "yes: no", 'title: "yes: no"   # quoted'),
        ("title", "true", 'title: "true"   # quoted'),
        ("limits", {"speed": 1, "jerk": 2}, "  {speed: 1, jerk: 2}  # slow"),
    ],
)
def test_a_value_is_written_where_it_belongs(key: str, value: object, line: str) -> None:
    after = with_value(TEXT, split_key(key), value)  # type: ignore[arg-type]
    assert line in after.splitlines()
    assert value_at(parse_yaml(after), split_key(key)) == value
    assert len({*TEXT.splitlines()} - {*after.splitlines()}) <= 1


def test_the_same_value_leaves_the_text_and_what_is_not_there_is_refused() -> None:
    data = parse_yaml(TEXT)
    assert isinstance(data, dict)
    for key, value in data.items():
        assert with_value(TEXT, (key,), value) == TEXT
    with pytest.raises(InputError, match="an entry of the file"):
        with_value(TEXT, ("mission", 7, "hold"), {})
    with pytest.raises(FileError, match="not YAML"):
        with_value("a: [", ("a",), 1)


def test_steps_go_with_the_comments_above_them() -> None:
    moved = with_entry_moved(TEXT, MISSION, 1, 0)
    assert "mission:\n  # stay\n  - hold: {seconds: 1.0}\n  # go\n  - morph: {pol" in moved
    assert with_entry_moved(moved, MISSION, 0, 1) == TEXT
    removed = without_entry(TEXT, MISSION, 1)
    assert "stay" not in removed
    assert removed.endswith("      blend: false\n\n# The end.\n")
    added = with_entry(TEXT, MISSION, 3, {"hold": {"seconds": 0.5}})
    assert "      blend: false\n  - hold: {seconds: 0.5}\n\n# The end." in added
    assert without_entry(added, MISSION, 3) == TEXT


@given(st.permutations(range(3)), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_the_file_holds_what_was_done(order: list[int], line: str, brackets: bool) -> None:
    text = "a: [{b: 1}, {c: 2}, {d: 3}]" if brackets else TEXT.replace("\n", line).rstrip()
    path = ("a",) if brackets else MISSION
    steps = value_at(parse_yaml(text), path)
    i, to, _ = order
    moved = with_entry_moved(text, path, i, to)
    expected = [*steps[:i], *steps[i + 1 :]]
    assert value_at(parse_yaml(without_entry(text, path, i)), path) == expected
    expected.insert(to, steps[i])
    assert value_at(parse_yaml(moved), path) == expected
    assert with_entry_moved(moved, path, to, i) == text
    added = with_entry(text, path, to, {"land": {}})
    assert value_at(parse_yaml(added), path) == [*steps[:to], {"land": {}}, *steps[to:]]
    assert brackets or ("\r\n" in added) is (line == "\r\n")
