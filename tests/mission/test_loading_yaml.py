"""YAML that is read with bounds, and changes of its text that leave all else as it is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.errors import FileError, HitchoptError, InputError
from hitchopt.mission.loading import load_problem
from hitchopt.storage.yaml_file import (
    Node,
    parse_yaml,
    read_node,
    read_yaml,
    split_key,
    value_at,
    with_value,
)
from tests.helpers.plans import PROBLEMS

# fmt: off
SCALARS: list[tuple[str, object]] = [
    ("1e-3", 0.001), ("-1.5E+2", -150.0), (".5", 0.5), ("007", 7), ("0o17", 15), ("0xff", 255),
    ("1_000", "1_000"), ("2026-01-01", "2026-01-01"), ("yes", "yes"), ("true", True), ("~", None),
    ("", None), ("'1'", "1"), ('"true"', "true"), ('"\\ud83d\\ude81"', "\U0001f681"),
    ('"\\ud83d"', "\ufffd"), ("-.INF", -math.inf), ("1e999", math.inf), ("|\n  1\n", "1\n"),
]
# fmt: on


@pytest.mark.parametrize("text", ["3 \u2013 5 robots", "5\u00a0m", "A \u2212 B", "\u00e9\u2009t"])
def test_text_may_have_what_resembles_a_minus_or_a_blank(text: str) -> None:
    assert parse_yaml(f"title: {text}") == {"title": text}


@pytest.mark.parametrize(("text", "value"), SCALARS, ids=[repr(text) for text, _ in SCALARS])
def test_scalars_follow_the_core_schema_of_yaml_1_2(text: str, value: object) -> None:
    data = parse_yaml(f"key: {text}\nnext: 1\n")
    assert data == {"key": value, "next": 1}
    assert isinstance(data, dict)
    assert type(data["key"]) is type(value)


# fmt: off
REFUSED: list[tuple[str, type[HitchoptError], str]] = [
    ("a: 1\nb: [1,\n", FileError, "text:3:1: is not YAML"),
    ("a: b: c", FileError, "text:1:5: is not YAML"),
    ("a:\n\tb: 1", FileError, "; indent with spaces"),
    ("a: {b: 1\nc: {d: 2}", FileError, "; correct this line, or close the bracket of line 1"),
    ("a:\n  b: 1\n  - c: 2", FileError, "text:3:3: is not YAML"),
    ("a:\n  b: 1\n  - c: 2", FileError, "those of a list begin with `- `"),
    ("a 1\nb: 2", FileError, "; correct this line or the one above: entries"),
    ("a: 'x\nb: 2", FileError, "; correct this line, or close the quote of line 1"),
    ("a: {b: 2,4}", InputError, "a name, and decimals with a point"),
    ('x: "\\U99999999"', FileError, "is not YAML"),
    ("x: \x07", FileError, "is not YAML"),
    ("x: [0, \u22120.6]", FileError, "text:1:8: '\u22120.6' has the character U+2212"),
    ("x: \u22121", FileError, "(minus sign); write '-'"),
    ("x: \u20132", FileError, "U+2013 (en dash); write '-'"),
    ("x: 2\u202f", FileError, "U+202F (narrow no-break space); write a blank"),
    ("x:\n-\u00a0hold: 1", FileError, "U+00A0 (no-break space); write a blank"),
    ("- a\n-\u00a0hold: 1", FileError, "line 2 has the character U+00A0"),
    ("a:\n\u00a0\u00a0b: 1", FileError, "U+00A0"),
    ("a:\u00a01", FileError, "U+00A0"),
    ("x: !!python/none", FileError, "text:1:4: tags (!) are not allowed; remove it"),
    ("x: *a", FileError, "aliases (*) are not allowed; write the value out"),
    ("? [1, 2]\n: 3", FileError, "text:1:3: a key must be a word"),
    ("", FileError, "text: is empty; `hitchopt init` writes"),
    (f"? {'x' * 10_001}\n: 1", FileError, "a key must have at most 10000 characters"),
    ("a:\n  - b: 1\n  - c: {d: 1, d: 2}\n", InputError, ":15: a[1].c.d: given twice; remove"),
    ("a: {b: {1.5: 2}}", InputError, "a.b = 1.5: must be a mapping whose keys are text"),
    ("? \n: 1", InputError, "problem = null"),
    ("[" * 21 + "1" + "]" * 21, InputError, "nested at most 20 levels deep"),
    ("[" * 100_000, InputError, "nested at most 20 levels deep"),
    (f"a: {{b: {'x' * 10_001}}}", InputError, "at most 10000 characters"),
]
# fmt: on


@pytest.mark.parametrize(("text", "kind", "words"), REFUSED, ids=range(len(REFUSED)))
def test_other_yaml_is_refused_by_place(text: str, kind: type[HitchoptError], words: str) -> None:
    with pytest.raises(kind) as caught:
        parse_yaml(text)
    assert words in str(caught.value)


def test_depth_is_bounded_and_long_numbers_are_infinite() -> None:
    assert parse_yaml("[" * 20 + "1" + "]" * 20) is not None
    assert parse_yaml("n: " + "9" * 400_000) == {"n": math.inf}


def test_files_that_are_no_utf_8_text_are_refused(tmp_path: Path) -> None:
    text, path = "team: {robots: 3}\n", tmp_path / "x.yaml"
    for data, words in (
        *((text.encode(f"utf-{kind}"), "UTF-(16|8)|not YAML") for kind in ("16-le", "16-be", "32")),
        (text.encode("utf-16"), r"not UTF-8 text \(byte 0\)"),
        (b"title: \xfcber", r"not UTF-8 text \(byte 7\)"),
        *((binary, "x.yaml") for binary in (b"\x00" * 50, b"PK\x03\x04\x14", bytes(range(256)))),
    ):
        path.write_bytes(data)
        with pytest.raises(FileError, match=words):
            read_yaml(path)
    path.write_bytes("a: 1\r\nb:\r\n  - ü\r\n".encode("utf-8-sig"))
    assert read_yaml(path) == {"a": 1, "b": ["ü"]}


def test_large_files_and_paths_that_are_no_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(50 * 2**30)  # sparse
    for wrong, words in (
        (path, r"larger than the \d+ bytes"),
        (tmp_path / "missing.yaml", "no such file; check the path"),
        (tmp_path, r"is a directory; name the YAML file"),
        ("a\0b", r"cannot be read \(.*embedded null \w+.*\)"),
    ):
        with pytest.raises(FileError, match=words):
            load_problem(wrong)


@given(st.text(max_size=60) | st.text("-:{}[],&*!|>'\"#?%@ \n\tab1.~<\\", max_size=60))
@settings(max_examples=200)
def test_no_text_makes_anything_but_plain_data_or_a_told_error(text: str) -> None:
    try:
        data = parse_yaml(text)
    except HitchoptError as error:
        data = str(error)
    assert isinstance(data, dict | list | str | int | float)


def test_outlines_of_objects_are_read_beside_the_problem(tmp_path: Path) -> None:
    corners, path = [[-0.1, -0.2], [-0.1, 0.2], [0.1, 0.2], [0.1, -0.2]], tmp_path / "problem.yaml"
    (tmp_path / "box.csv").write_text("\n".join(f"{x},{y}" for x, y in corners))
    body = "objects: {box: {file: box.csv, to: 0.3, mass: 0.1, at: [5, 5, 0]}}\n"
    path.write_text((PROBLEMS / "triangle.yaml").read_text("utf-8") + body, "utf-8")
    section = load_problem(path).objects["box"].section
    assert sorted(section.core.round(9).tolist()) == sorted(corners)
    (tmp_path / "box.csv").unlink()
    with pytest.raises(InputError, match=r":18:17: objects\.box\.file .* no such file"):
        load_problem(path)


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


def overhanging(text: str) -> list[int]:
    """Return the lines within brackets that are not indented more than the key above them.

    YAML 1.2 refuses them, and editors mark them; many parsers accept them. Only the last bracket
    may be below its key.
    """
    starts, found = [0, *(i + 1 for i, each in enumerate(text) if each == "\n")], list[int]()

    def visit(node: Node) -> None:
        for child in node.children.values():
            if not child.flow:
                visit(child)
                continue
            for number, start in enumerate(starts, 1):
                indent = len(text[start:]) - len(text[start:].lstrip(" "))
                is_last = start + indent == child.end - 1 and indent == node.column
                if child.start < start < child.end and indent <= node.column and not is_last:
                    found.append(number)

    visit(read_node(text))
    return found


@pytest.mark.parametrize("path", sorted(PROBLEMS.rglob("*.yaml")), ids=lambda path: path.stem)
def test_examples_are_yaml_to_editors(path: Path) -> None:
    if "bad" not in path.parts:
        assert overhanging(path.read_text(encoding="utf-8")) == []


def test_brackets_that_close_too_early_are_found() -> None:
    assert overhanging("a:\n  - b: {c: [\n      1\n    ], d: 2}\n") == [4]
    assert overhanging("a: [\n  1,\n  2\n  ]\n") == []
    assert overhanging("a: [\n  1,\n2\n]\n") == [3]
