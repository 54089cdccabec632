"""What holds for all tests: no memory of plans, and property tests that depend on no clock."""

import gc
import os
import shutil
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from tests.helpers.clocks import Clock
from tests.helpers.plans import FOLDER, digest

# A busy machine is no failure, and every run tries the same examples.
settings.register_profile("hitchopt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("hitchopt")


def pytest_configure(config: pytest.Config) -> None:
    """Name the folder of shared plans; those of another package go.

    Tests and the processes that they start rely on the usual SIGINT, which jobs in the background
    ignore.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if FOLDER in os.environ:  # a worker's, from its controller
        return
    if os.environ.get("CI"):
        os.environ[FOLDER] = tempfile.mkdtemp()
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop(FOLDER)))
        return
    kept = config.rootpath / ".pytest_cache" / "plans"
    here = kept / digest()
    for other in kept.glob("*"):
        if other != here:
            shutil.rmtree(other, ignore_errors=True)
    os.environ[FOLDER] = str(here)


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of garbage collections from here on."""
    gc.freeze()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The machine's clock, which goes on by a second whenever it is read."""
    clock = Clock()
    monkeypatch.setattr("time.monotonic", clock.monotonic)
    return clock


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
