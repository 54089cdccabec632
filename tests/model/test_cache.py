"""Models on disk: found again, and never trusted where they are not what was written."""

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import pytest

from hitchopt.model import cache
from hitchopt.model.cache import stored

BUILT: list[bool] = []


def doubled(choice: bool) -> ca.Function:
    """Twice or thrice a number; tells how often it is built."""
    BUILT.append(choice)
    x = ca.SX.sym("x")
    return ca.Function("doubled", [x], [(2.0 if choice else 3.0) * x])


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    BUILT.clear()
    place = tmp_path / "models"
    monkeypatch.setenv("HITCHOPT_CACHE", str(place))
    return place


def test_a_model_is_built_once_for_all_processes(directory: Path) -> None:
    one = stored(doubled)
    assert float(one(True)(4.0)) == 8.0
    assert one(True) is one(True)
    another = stored(doubled)  # as in a process that starts later: it has nothing in memory
    assert float(another(True)(4.0)) == 8.0
    assert BUILT == [True]
    assert float(another(False)(4.0)) == 12.0
    assert BUILT == [True, False]
    assert len(list(directory.iterdir())) == 2


def truncated(whole: bytes) -> bytes:
    return whole[: len(whole) // 2]


def altered(whole: bytes) -> bytes:
    return whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:]


def empty(_: bytes) -> bytes:
    return b""


def foreign(_: bytes) -> bytes:
    return b"\x89PNG\r\n" + bytes(range(256))


def signed_nonsense(_: bytes) -> bytes:
    text = "no model of casadi's"
    return f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}".encode()


@pytest.mark.parametrize("damage", [truncated, altered, empty, foreign, signed_nonsense])
def test_a_damaged_file_is_built_anew_and_replaced(
    directory: Path, damage: Callable[[bytes], bytes]
) -> None:
    stored(doubled)(True)
    (file,) = directory.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert float(stored(doubled)(True)(4.0)) == 8.0
    assert len(BUILT) == 2
    assert file.read_bytes() == whole
    assert [entry.name for entry in directory.iterdir()] == [file.name]


def test_the_versions_and_the_source_are_part_of_the_name(
    directory: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stored(doubled)(True)
    monkeypatch.setattr(cache, "_version", lambda: "0.0.0")
    stored(doubled)(True)
    assert len(list(directory.iterdir())) == 2
    source = tmp_path / "changed.py"
    source.write_text(Path(__file__).read_text(encoding="utf-8") + "\n# changed\n")
    names: dict[str, Callable[[bool], ca.Function]] = {}
    exec(compile(source.read_text(), str(source), "exec"), names)  # the same function, elsewhere
    stored(names["doubled"])(True)
    assert len(list(directory.iterdir())) == 3


def test_a_place_that_cannot_be_written_does_no_harm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("here first")
    monkeypatch.setenv("HITCHOPT_CACHE", str(file))
    assert float(stored(doubled)(True)(4.0)) == 8.0
    monkeypatch.setenv("HITCHOPT_CACHE", str(file / "below"))
    assert float(stored(doubled)(True)(4.0)) == 8.0
    assert file.read_text() == "here first"


def test_off_keeps_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HITCHOPT_CACHE", "off")
    assert cache.cache_directory() is None
    assert float(stored(doubled)(True)(4.0)) == 8.0
    assert list(tmp_path.iterdir()) == []


def test_the_platforms_own_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HITCHOPT_CACHE", raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    for platform, expected in (
        ("linux", tmp_path / ".cache" / "hitchopt"),
        ("darwin", tmp_path / "Library" / "Caches" / "hitchopt"),
        ("win32", tmp_path / "AppData" / "Local" / "hitchopt"),
    ):
        monkeypatch.setattr(sys, "platform", platform)
        for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
            monkeypatch.delenv(name, raising=False)
        assert cache.cache_directory() == expected
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    assert cache.cache_directory() == tmp_path / "other" / "hitchopt"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says: ignore it
    assert cache.cache_directory() == tmp_path / ".cache" / "hitchopt"
