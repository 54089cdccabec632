"""Run commands in tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from hitchopt.cli import main
from tests.helpers.plans import PROBLEMS

TRIANGLE = PROBLEMS / "triangle.yaml"


def run(*arguments: str | Path, code: int | None = None, given: str | None = None) -> Result:
    """Run a command in this process; it ends with ``code``, if one is given."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments], input=given)
    assert code in (None, result.exit_code), result.output
    return result


def refused(*arguments: str | Path, code: int = 2) -> str:
    """What a command that prints no result writes to stderr."""
    result = run(*arguments, code=code)
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return result.stderr


def strict(*arguments: str | Path) -> Any:
    """What a command prints with ``--json``; not a number is no JSON."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(run(*arguments, "--json").stdout, parse_constant=refuse)


def started(*arguments: str, **options: str) -> subprocess.CompletedProcess[str]:
    """What Python says in a process of its own, with variables of the environment."""
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **options},
        timeout=60,
        check=False,
    )
