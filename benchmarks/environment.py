"""What every benchmark prints before its numbers."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp")


def print_environment(limitations: str) -> None:
    """Print machine, versions and limitations."""
    print(environment())
    print(f"limitations: {limitations}")


def environment(more: tuple[str, ...] = ()) -> str:
    """Return machine and versions in one line, those of further libraries too."""
    versions = ", ".join(f"{name} {_version(name)}" for name in LIBRARIES + more)
    return (
        f"{platform.machine()}, {os.cpu_count()} cores{_processor()}, {platform.system()}; "
        f"Python {platform.python_version()}, {versions}"
    )


def busy() -> float:
    """Return how many processes have wanted a core in the last minute, on average."""
    return os.getloadavg()[0]


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    """Return the processor's name in brackets, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f" ({names[0]})" if names else ""
