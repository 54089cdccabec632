"""What holds for all tests: no memory of plans, and property tests that depend on no clock."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# No test gets what another one has planned.
os.environ["HITCHOPT_MEMORY"] = "off"

# A busy machine is no failure, and every run tries the same examples.
settings.register_profile("hitchopt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("hitchopt")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
