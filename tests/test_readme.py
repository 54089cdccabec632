"""What the README shows is what happens."""

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


BLOCKS = re.findall(r"```(python|)\n(.*?)```", README, flags=re.DOTALL)
EXAMPLES = [
    (code, shown) for (language, code), (_, shown) in pairwise(BLOCKS) if language == "python"
]


@pytest.mark.parametrize(("code", "shown"), EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_examples_print_what_is_shown(code: str, shown: str, tmp_path: Path) -> None:
    assert len(code.strip().splitlines()) <= 15
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert done.stdout == shown


def test_links_lead_to_files() -> None:
    root = Path(__file__).parents[1]
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if "://" not in link]
    assert links
    assert [link for link in links if not (root / link).exists()] == []


def test_the_certificates_table_names_every_check() -> None:
    from hitchopt.checks.registry import REPORTS, RULES

    rows = [line.split("|")[1] for line in README.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)}
    assert {rule.name for rule in (*RULES, *REPORTS)} <= named
