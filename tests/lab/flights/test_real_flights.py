"""The table of real flights, from simulated recordings in the same formats."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks import real
from tests.helpers import writers as w
from tests.helpers.load_flights import carried


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two flights with a load."""
    root: Path = tmp_path_factory.mktemp("flights")
    for seed in range(2):
        flight = carried(4.0, seed=seed)
        own = {
            name: {x: y for x, y in each.items() if x != "attitude"}
            for name, each in flight.signals.items()
        }
        flight = replace(flight, signals=own)
        w.write_rich_usd(root / f"load-{seed}", flight, (0.0, 30.0 * seed))
    return root


def figures(folder: Path, *options: str) -> dict[str, Any]:
    file = folder.parent / "figures.json"
    arguments = ["--flights", str(folder), "--json", str(file), *options]
    real.main([*arguments, "-o", str(folder.parent / "results")])
    content: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return content


@pytest.mark.slow
@pytest.mark.parametrize("fit", [False, True])
def test_models_predict_simulated_flights(fit: bool, folder: Path) -> None:
    """Flights of a folder are predicted from its others, also if it is named to fit on."""
    found = figures(folder, *(["--fit", str(folder)] if fit else []))
    assert found["filter_rms_deg"]["value"] < 0.3
    assert found["filter_rms_deg"]["n"] == 4
    share, replayed = (found[key]["value"] for key in ("pull_seen", "pull_seen_replayed"))
    assert share == pytest.approx(replayed, abs=0.05)
    assert found["cable_length_rms_mm"]["value"] < 2.0
    assert found["thrust_error"]["value"] < 0.02
    assert found["thrust_without_factors"]["n"] == 0
    assert all(x["standard_error"] is not None for x in found.values() if "value" in x)
    text = (folder.parent / "results/real.md").read_text("utf-8")
    assert "with factors per drone of other flights (0 series without one)" in text


@pytest.mark.slow
def test_what_other_flights_do_not_tell_is_counted(
    folder: Path,
) -> None:
    found = figures(folder / "load-0", "--fit", str(folder / "load-0"))
    assert found["thrust_without_factors"]["n"] == 2
    assert found["thrust_error"]["value"] == pytest.approx(0.1, abs=0.02)
    assert found["cable_length_rms_mm"] == {"value": None, "standard_error": None, "n": 0}


def test_figures_have_standard_errors() -> None:
    mean, rms = real.Figure.mean([1.0, 2.0, 3.0]), real.Figure.rms([3.0, 3.0, 3.0])
    assert (mean.value, mean.n) == (2.0, 3)
    assert mean.standard_error == pytest.approx(1.0 / math.sqrt(3.0))
    assert (rms.value, rms.standard_error) == (3.0, 0.0)
    assert str(real.Figure.mean([])) == "–"
