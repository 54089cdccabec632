"""The command ``sweep``: many plans or simulated flights, on one machine or a cluster."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import click

from hitchopt.cli.commands import main
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath
from hitchopt.errors import InputError

PATH = GivenPath()


@main.command()
@click.argument("study", metavar="STUDY", type=PATH)
@click.option("-o", "--output", metavar="DIR", type=PATH, help="Results; else ./ and the stem.")
@click.option("--workers", metavar="N", type=int, help="Processes; by default all processors.")
@click.option("--scheduler", metavar="ADDRESS", help="A dask scheduler, such as tcp://host:8786.")
@click.option(
    "--plot",
    metavar="X Y",
    nargs=2,
    help="Draw column Y over column X, such as team.tension duration, of a sweep's DIR.",
)
def sweep(
    study: Path,
    output: Path | None,
    workers: int | None,
    scheduler: str | None,
    plot: tuple[str, str] | None,
) -> None:
    """Plan, simulate, settle or export every case of STUDY.yaml (needs dask.distributed).

    Every result is a row of a Parquet dataset in DIR, written as it arrives. The same command goes
    on where an earlier one has ended: only what is missing is computed. With --plot, STUDY is the
    DIR of a sweep, and nothing is computed.
    """
    from hitchopt.cli.progress import LateProgress
    from hitchopt.cli.sweep_tables import sweep_tables
    from hitchopt.sweeps.dataset import load_sweep, read_study
    from hitchopt.sweeps.running import run_sweep
    from hitchopt.sweeps.sweep_summary import summary

    if plot is not None:
        _draw(study, *plot)
        return
    place = Path(study.stem) if output is None else output
    if study.is_dir():
        place = study
    else:
        with LateProgress(sys.stderr, "starting workers") as progress:
            run_sweep(
                study,
                place,
                workers=workers,
                scheduler=scheduler,
                progress=lambda count: progress(str(count)),
            )
    rows = load_sweep(place)
    found = summary(rows, len(read_study(place)["cases"]))
    record(directory=str(place), summary=asdict(found))
    say(sweep_tables(found))
    say(f"rows are in {place}; draw them: hitchopt sweep {place} --plot X Y")


def _draw(place: Path, x: str, y: str) -> None:
    """Draw one column of a sweep over another."""
    from hitchopt.sweeps.dataset import load_sweep, read_study
    from hitchopt.sweeps.sweep_picture import save_sweep_picture
    from hitchopt.sweeps.sweep_summary import column_of

    if not place.is_dir():
        raise InputError("STUDY", str(place), "the directory of a sweep with --plot", "name it")
    rows = load_sweep(place)
    columns = column_of(rows, x), column_of(rows, y)
    path = place / f"{y.rsplit('.', 1)[-1]}_over_{x.rsplit('.', 1)[-1]}.png"
    save_sweep_picture(path, rows, *columns, read_study(place)["title"])
    record(file=str(path))
    say(f"the picture is {path}")
