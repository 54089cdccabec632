"""What every benchmark prints before its numbers."""

from __future__ import annotations

import os
import platform
from importlib import metadata

LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra")


def print_environment(limitations: str) -> None:
    """Print machine, versions and limitations."""
    print(f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}", end="; ")
    print(f"Python {platform.python_version()}", end=", ")
    print(", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES))
    print(f"limitations: {limitations}")
