"""Text tables of all locales, and messages for invalid ones."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hitchopt.directory import write_rows
from hitchopt.errors import FileError
from hitchopt.storage.tables import Table, labelled_table, numeric_table, text_lines
from hitchopt.values import Array

VALUES = np.array([[0.0, 1.25, -3.5e-3], [0.5, 7.0, 2.0e4], [1.0, -0.125, 0.0]])
LABELS = ("t [s]", "Xß", "y")


def written(separator: str, decimal: str, *, quoted: bool = False) -> list[str]:
    quote = '"' if quoted else ""
    cells = [*([f"{x:.9g}".replace(".", decimal) for x in row] for row in VALUES)]
    return [separator.join(f"{quote}{cell}{quote}" for cell in row) for row in cells]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [*product([";", "\t", "; ", " \t"], ".,"), (",", "."), (", ", ".")]
)
def test_all_dialects_of_a_table_give_the_same_numbers(
    separator: str, decimal: str, encoding: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    rows = [*written(separator, decimal), "", separator * 2]
    text = "\r\n".join([f"# {separator.join(LABELS)}", "# made by hand", "", *rows])
    path.write_bytes(text.encode(encoding))
    table = labelled_table(lambda: text_lines(path), ["XSS", "t [s]"], "a.csv")
    assert table.labels == LABELS
    np.testing.assert_array_equal(table.numbers(LABELS), VALUES)
    np.testing.assert_array_equal(table.numbers(["y"])[:, 0], VALUES[:, 2])
    assert [number for number, _ in table.rows()] == [4, 5, 6]
    bare = numeric_table(lambda: text_lines(path), "a.csv")
    np.testing.assert_array_equal(bare.numbers(range(3)), VALUES)


def of(lines: list[str], *names: str) -> Table:
    return labelled_table(lambda: lines, names, "a") if names else numeric_table(lambda: lines, "a")


def test_quoted_decimal_commas_blanks_and_comments() -> None:
    table = of(['"t","name","x"', *written(",", ",", quoted=True)], "name")
    np.testing.assert_array_equal(table.numbers(["t", 2]), VALUES[:, [0, 2]])
    np.testing.assert_array_equal(of(written(" ", ","), *()).numbers([0, 1, 2]), VALUES)
    table = of(
        ["t,name,x,y", "0,drone #1 ,,2", "1,b, ,3 # late", "#2,c,1,1", ",,,", "2,c,1,1,,"], "t"
    )
    assert table.words("NAME") == ["drone #1", "b", "c"]
    found = table.numbers(["x", "y"], blanks=True)
    np.testing.assert_array_equal(found, [[np.nan, 2.0], [np.nan, 3.0], [1.0, 1.0]])
    np.testing.assert_array_equal(
        of(["x1,y1", "0, 0;", "0.4, 0;"]).numbers([0, 1]), [[0, 0], [0.4, 0]]
    )


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["t,x", "0,5,0,3"], r"line 2 has 4 cells, not 2; .*semicolons"),
        (["t;x", "0,5;1", "1.5;2"], r"line 3: t is '1\.5', not a number among decimal commas"),
        (
            ["t;x", "0.5;1", "1,5;2"],
            r"line 2: t is '0\.5', not a number among decimal commas; .*no points",
        ),
        (["t;x", "0;1.234,5"], r"x is '1\.234,5', not a number among.*no points"),
        (["t,x", "0,1", "1"], r"line 3 has 1 cells, not 2; is it cut off"),
        (["t,x", "0,", "1,2"], "line 2: x is '', not a number$"),
        (["t,x", "0,2026-11-25 10:00"], "x is '2026-11-25 10:00', not a number$"),
        (["t,y", "0,1"], "line 1, the column names, has no 'x', but t, y"),
        (["a|b", "0|1"], r"no line of column names with t; it begins 'a\|b'"),
        (["t,x", '0,"1' + "1" * 200_000], "check its quotation marks"),
    ],
)
def test_invalid_tables_are_refused(lines: list[str], words: str) -> None:
    with pytest.raises(FileError, match=words) as error:
        of(lines, "t").numbers(["t", "x"])
    assert "damaged" not in str(error.value)
    with pytest.raises(FileError, match="no line of numbers"):
        of(["x,y", "a,b"])


@pytest.mark.parametrize("digits", [9, 12])
def test_numbers_are_written_with_their_digits(tmp_path: Path, digits: int) -> None:
    random = np.random.default_rng(3)
    times: Array = np.linspace(0.0, 0.39, 40)
    names = ["a.q0", "nan", "r0"]
    values = random.normal(size=(40, 3, 5)) * 10.0 ** random.uniform(-9.0, 4.0, (40, 3, 5))
    values[:20, :, :2] = 0.0
    values[:, 1, 4] = np.nan
    path = tmp_path / "table.csv"
    write_rows(
        path,
        "t,name,a,b,c,d,e",
        (names, [(times[:7], values[:7]), (times[7:], values[7:])]),
        digits=digits,
    )
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    assert [row[1] for row in rows] == names * 40
    expected = [[f"{x:.{digits}g}" for x in row] for row in values.reshape(-1, 5).tolist()]
    written = [["nan" if cell == "" else cell for cell in row[2:]] for row in rows]
    assert written[3:] == expected[3:]
    assert [[float(x) for x in row] for row in written[:3]] == pytest.approx(
        np.array(expected[:3], float), nan_ok=True, rel=0.0
    )
    # Readers such as polars take a column that begins with 0 for integers
    assert all("." in cell for row in rows[:3] for cell in (row[0], *row[2:]) if cell)
