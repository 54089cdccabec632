"""Libraries that only some formats need, imported when these are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from hitchopt.errors import UnsupportedError


def needed(module: str) -> Any:
    """Return the module.

    Raises
    ------
    UnsupportedError: it is not installed; the message says what to install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UnsupportedError(
            f"this format needs the package {package} ({error}); pip install 'hitchopt[export]'"
        ) from error
