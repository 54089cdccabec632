"""Compiled code on disk is that of the sources there are, of all kernels that call each other."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from hitchopt.compiled import kernel_switch
from hitchopt.compiled.kernel_switch import kernel, sources_digest

SOURCES = Path(kernel_switch.__file__).parent

CALLED = (
    "from hitchopt.compiled.kernel_switch import kernel\n@kernel\ndef f(x):\n    return {} * x\n"
)
CALLING = (
    "from called import f\n"
    "from hitchopt.compiled.kernel_switch import kernel\n"
    "@kernel\ndef g(x):\n    return f(x) + 1.0\n"
)
PROBE = "from calling import g; print(g(10.0)); print(sum(g.stats.cache_hits.values()))"


@pytest.fixture(autouse=True)
def _needs_numba() -> None:
    pytest.importorskip("numba")


def printed(folder: Path) -> list[str]:
    """Return what a new process prints that calls a kernel of a folder: value, cache hits."""
    done = subprocess.run(
        [sys.executable, "-B", "-c", PROBE], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_a_changed_kernel_reaches_those_that_call_it(tmp_path: Path) -> None:
    (tmp_path / "called.py").write_text(CALLED.format(2.0))
    (tmp_path / "calling.py").write_text(CALLING)
    assert printed(tmp_path) == ["21.0", "0"]
    assert printed(tmp_path) == ["21.0", "1"]
    (tmp_path / "called.py").write_text(CALLED.format(3.0))
    assert printed(tmp_path) == ["31.0", "0"]


@pytest.mark.parametrize("name", [path.name for path in SOURCES.glob("*.py")])
def test_the_digest_changes_with_every_file(name: str, tmp_path: Path) -> None:
    for path in SOURCES.glob("*.py"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    before = sources_digest(tmp_path)
    assert before == sources_digest(SOURCES)
    sources_digest.cache_clear()
    (tmp_path / name).write_text((tmp_path / name).read_text() + "\n")
    assert sources_digest(tmp_path) != before


def test_kernels_depend_on_no_other_folder() -> None:
    """Else the digest would miss changes; ``hitchopt.values`` names types only."""
    for path in SOURCES.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hitchopt"):
                allowed = ("hitchopt.compiled.", "hitchopt.values")
                assert str(node.module).startswith(allowed), path.name


@pytest.mark.parametrize("missing", ["places", "sources"])
def test_kernels_compile_where_nothing_can_be_kept(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from numba.core.caching import CacheImpl

    def refuse(_: Path) -> str:
        raise OSError("no such folder")

    if missing == "places":
        monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    else:
        monkeypatch.setattr(kernel_switch, "sources_digest", refuse)

    def doubled(x: float) -> float:
        return 2.0 * x

    compiled = kernel(doubled)
    assert compiled is not doubled
    assert compiled(3.0) == 6.0
