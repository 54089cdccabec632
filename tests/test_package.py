"""The package as a whole: its public names, and how light it is to import."""

import subprocess
import sys

import pytest

import hitchopt


@pytest.mark.parametrize("name", hitchopt.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(hitchopt, name).__doc__


def test_public_names_are_listed_and_others_refused() -> None:
    assert set(hitchopt.__all__) <= set(dir(hitchopt))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = hitchopt.nonsense


HEAVY = ("casadi", "matplotlib", "toppra", "scipy", "pydantic", "ruamel.yaml")


@pytest.mark.parametrize(
    "code",
    [
        "import hitchopt",
        "import sys; sys.argv[1:] = ['--help']\n"
        "from hitchopt.cli import main\n"
        "try: main()\nexcept SystemExit: pass",
    ],
    ids=["import hitchopt", "hitchopt --help"],
)
def test_light_things_load_nothing_heavy(code: str) -> None:
    probe = (
        f"{code}\nimport sys\nloaded = [m for m in {HEAVY!r} if m in sys.modules]\n"
        "sys.exit(str(loaded) if loaded else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", probe], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
