"""Plans and certificates of all problems as data, compared between versions of the package.

Usage: python -m benchmarks corpus --output DIR [--package CHECKOUT] [--only NAME ...] [--workers N]
       python -m benchmarks corpus --compare A B [--only NAME ...] [--tolerance T]

Every problem file is planned by the command line of a package: this one, or that of another
checkout (``--package``). DIR then has ``NAME.json``, with exit code, messages, certificate, and
groups with their phases, and ``NAME.npz``, with the breaks and the Bernstein coefficients of every
group. Nothing is sampled. Neither file depends on the format of plan files. Bits are comparable
between runs on one machine.

``--compare`` prints what differs, and ends with 1 if anything differs by more than the tolerance:
coefficients in their units [m], [N]; figures of certificates in theirs, or relative if larger than
1. A curve that one of the plans leaves out equals its default. Limits that hold with equality at
several places may change their place.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Curves = dict[str, Array]

ROOT = Path(__file__).resolve().parents[1]
PROBLEMS = ROOT / "problems"

FIELDS = ("name", "step", "start", "end", "remark", "tension")
"""Fields of a phase that are stored as they are."""

CURVES = {
    "drones": ("drones",),
    "vertices": ("vertices",),
    "legs": ("legs",),
    "tensions": ("tensions",),
    "leg_tensions": ("leg_tensions",),
    "poses": ("poses",),
    "load_share": ("load_share", "borne"),
    "contacts": ("contacts",),
}
"""Curves of a motion, each with its names in this and other versions."""

OPTIONAL = [*CURVES][4:]
"""Curves that motions may leave out."""

MAX_LISTED = 10
"""Maximum number of differences that are printed for a problem."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan or compare; return the exit code. Arguments are those of the process by default."""
    cli = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    task = cli.add_mutually_exclusive_group(required=True)
    task.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of the corpus")
    task.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="two such folders")
    cli.add_argument("--package", type=Path, default=ROOT, help="checkout that plans")
    cli.add_argument("--only", nargs="*", default=["*"], help="names such as triangle, 'swarms/*'")
    cli.add_argument("--workers", type=int, default=1, help="problems planned at once")
    cli.add_argument("--tolerance", type=float, default=1e-6, help="largest difference [m], [N]")
    options = cli.parse_args(arguments)
    if options.compare is not None:
        a, b = options.compare
        return compare(a, b, options.only, options.tolerance)
    files = (path.relative_to(PROBLEMS) for path in PROBLEMS.rglob("*.yaml"))
    names = [str(file.with_suffix("")) for file in files]
    if not (options.package / "hitchopt").is_dir():
        cli.error(f"{options.package} is no checkout")
    work = partial(plan, folder=options.output.resolve(), package=options.package.resolve())
    with ThreadPoolExecutor(options.workers) as pool:
        for line in pool.map(work, selected(names, options.only)):
            print(line, flush=True)
    return 0


def selected(names: Iterable[str], patterns: list[str]) -> list[str]:
    """Return the names that match any of the patterns, sorted."""
    return sorted(name for name in names if any(fnmatch(name, each) for each in patterns))


def plan(name: str, folder: Path, package: Path) -> str:
    """Plan a problem, write what its command says and its motion, and return a line on it."""
    start_time = time.monotonic()
    environment = os.environ | {"PYTHONPATH": str(package), "OPENBLAS_NUM_THREADS": "1"}
    run = partial(subprocess.run, cwd=PROBLEMS, env=environment, capture_output=True, text=True)
    with tempfile.TemporaryDirectory() as scratch:
        command = ["-m", "hitchopt", "solve", f"{name}.yaml", "-o", scratch, "--no-repair"]
        done = run([sys.executable, "-P", *command, "--rate", "10"])
        message = done.stderr.replace(scratch, "DIR").replace(str(package), "PACKAGE")
        data: dict[str, Any] = {"exit": done.returncode, "message": message.splitlines()}
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        arrays = folder / f"{name}.npz"
        arrays.unlink(missing_ok=True)
        if done.returncode == 0:
            certificate = json.loads((Path(scratch) / "certificate.json").read_text("utf-8"))
            data |= {key: certificate[key] for key in ("certified", "duration", "checks")}
            read = run([sys.executable, "-P", __file__, scratch, str(arrays), str(package)])
            if read.returncode:
                data["unreadable"] = read.stderr.splitlines()
            else:
                data["groups"] = json.loads(read.stdout)
    text = json.dumps(data, indent=1, ensure_ascii=False)
    (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    words = ", its plan cannot be read" if "unreadable" in data else ""
    return f"{name}: exit code {done.returncode}, {time.monotonic() - start_time:.1f} s{words}"


def read_plan(directory: str, file: str, package: str) -> None:
    """Write the curves of a plan to a file and print its groups, by the package on the path."""
    import hitchopt as ho

    if not Path(ho.__file__).resolve().is_relative_to(package):
        raise SystemExit(f"{ho.__file__} is not in {package}")
    plan = ho.load(directory)
    groups, curves = contents(getattr(plan, "flight", None) or plan.motion)
    np.savez(file, allow_pickle=False, **curves)
    print(json.dumps(groups))


def contents(flight: Any) -> tuple[dict[str, Any], Curves]:
    """Return the phases of every team and external plan of a flight, and its curves."""
    groups, curves = dict[str, Any](), Curves()
    teams = getattr(flight, "teams", None) or flight.groups  # as versions name them
    for prefix, members in (("", teams), ("others/", flight.others)):
        for each in members:
            own, label = each.motion, f"{prefix}{each.name or 'team'}"
            groups[label] = [phase_data(phase, own.team.robots) for phase in own.phases]
            curves[f"{label}/breaks"] = own.drones.breaks
            for name, names in CURVES.items():
                found = (getattr(own, known, None) for known in names)
                curve = next((one for one in found if one is not None), None)
                if curve is not None and curve.coefficients.size:
                    c = curve.coefficients
                    curves[f"{label}/{name}"] = c.reshape(len(c), -1, c.shape[-1])
    return groups, curves


def phase_data(phase: Any, robots: int) -> dict[str, Any]:
    """Return a phase as JSON values, with the state of every robot's cable."""
    hold = phase.hold and [phase.hold.object, str(phase.hold.by), *phase.hold.cables]
    return {name: getattr(phase, name) for name in FIELDS} | {
        "states": [str(phase.state)] * robots,
        "hold": hold,
    }


def compare(a: Path, b: Path, patterns: list[str], tolerance: float) -> int:
    """Print what differs between two folders by problem; return 1 if anything does."""
    files = {str(p.relative_to(x).with_suffix("")) for x in (a, b) for p in x.rglob("*.json")}
    counts = {"equal": 0, "within": 0, "differs": 0}
    for name in selected(files, patterns):
        missing = [str(folder) for folder in (a, b) if not (folder / f"{name}.json").exists()]
        if missing:
            outcome, lines = "differs", [f"not in {missing[0]}"]
        else:
            outcome, lines = compared(a / name, b / name, tolerance)
        counts[outcome] += 1
        more = [f"and {len(lines) - MAX_LISTED} more"] if len(lines) > MAX_LISTED else []
        print("\n    ".join([f"{name}: {outcome}", *lines[:MAX_LISTED], *more]), flush=True)
    print(", ".join(f"{outcome}: {count}" for outcome, count in counts.items()))
    return 1 if counts["differs"] or not sum(counts.values()) else 0


def compared(a: Path, b: Path, tolerance: float) -> tuple[str, list[str]]:
    """Return whether two plans are equal, within the tolerance, or differ, and where."""
    data = [json.loads(Path(f"{path}.json").read_text("utf-8")) for path in (a, b)]
    files = [Path(f"{path}.npz") for path in (a, b)]
    curves = [dict(np.load(file)) if file.exists() else {} for file in files]
    found = [*data_differences("", *data), *curve_differences(*curves)]
    if not found:
        return "equal", []
    largest = max(found, key=lambda each: each[1])
    worse = [each for each in found if not each[1] <= tolerance]
    return "differs" if worse else "within", [words for words, _ in worse or [largest]]


Difference = tuple[str, float]
"""Differences in words, with their sizes: inf where they cannot be measured."""


def data_differences(key: str, a: Any, b: Any) -> Iterator[Difference]:
    """Yield the differences of JSON values by keys; those of checks by their names."""
    if key == "checks" and a and b:
        key, a, b = "check", *({check["name"]: check for check in each} for each in (a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        for name in a | b:
            yield from data_differences(f"{key}.{name}".lstrip("."), a.get(name), b.get(name))
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from data_differences(f"{key}[{i}]", x, y)
    elif a != b:
        size = np.inf
        if re.fullmatch(r"check\.\w+\.(time|where.*)", key):
            size = 0.0  # a limit may be met with equality at several places
        elif isinstance(a, float) and isinstance(b, float):
            size = abs(a - b) / max(1.0, abs(a))
        yield f"{key}: {a!r}, {b!r}", size


def curve_differences(a: Curves, b: Curves) -> Iterator[Difference]:
    """Yield the differences of curves by names; one that is left out equals its default."""
    if bool(a) != bool(b):
        yield "curves: of one plan alone", np.inf
        return
    for name in sorted(a | b):
        x = a[name] if name in a else default(name, a, b[name])
        y = b[name] if name in b else default(name, b, a[name])
        if x is not None and y is not None and x.ndim == y.ndim == 3:
            x, y = elevated(x, y.shape[-1]), elevated(y, x.shape[-1])
        if x is None or y is None or x.shape != y.shape:
            shapes = ("none" if curve is None else curve.shape for curve in (x, y))
            yield f"{name}: shapes {', '.join(map(str, shapes))}", np.inf
        elif not np.array_equal(x, y):
            differences = np.abs(x - y)
            piece, *_ = np.unravel_index(np.argmax(differences), x.shape)
            size = float(np.max(differences))
            yield f"{name}: {size:.3g} at piece {piece}", size


def default(key: str, curves: Curves, other: Array) -> Array | None:
    """Return what a curve is if it is left out, given that of the other plan; None if unknown.

    Zeros stand for the default too, and objects that do not move stand where they stand first.
    """
    label, _, name = key.rpartition("/")
    if name == "load_share" or (name in OPTIONAL and not np.any(other)):
        return np.zeros_like(other)
    if name == "poses":
        return np.broadcast_to(other[:1, :, :1], other.shape)
    if name == "leg_tensions":
        return np.repeat(curves[f"{label}/tensions"], 2, axis=1)
    if name == "contacts":  # twice the midpoint of every edge
        c = curves[f"{label}/vertices"]
        points, edges = c.shape[1] // 3, other.shape[1] // 6
        c = c.reshape(len(c), points, 3, -1)
        middles = 0.5 * (c[:, :edges] + np.roll(c, -1, axis=1)[:, :edges])
        return np.stack([middles, middles], axis=2).reshape(len(c), 6 * edges, -1)
    return None


def elevated(c: Array, count: int) -> Array:
    """Return Bernstein coefficients, their degree elevated to at least ``count`` coefficients."""
    while c.shape[-1] < count:
        share = np.arange(1, n := c.shape[-1]) / n
        inner = share * c[..., :-1] + (1.0 - share) * c[..., 1:]
        c = np.concatenate([c[..., :1], inner, c[..., -1:]], axis=-1)
    return c


if __name__ == "__main__":  # in a process of its own, with the package that planned
    read_plan(*sys.argv[1:])
