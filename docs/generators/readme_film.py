"""The film at the head of the README: ``make film`` draws it from the demo's plan."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

import hitchopt as ho
from generators.problem_collection import ROOT
from hitchopt.view.film import frames
from hitchopt.view.scene import scene_of
from hitchopt.view.style import COLOURS, FRAME

FILM = ROOT / "problems" / "pictures" / "carry_box.gif"

SPEED, INTERVAL = 4.0, 0.08
"""How much faster than the flight it is, and the time that a frame is shown [s]."""

REST = 1.2
"""Time for which the last frame is shown [s]."""

SIZE = (800, 450)
"""Width and height [pixels]."""

COMMON, TINTS = 96, (1.0, 0.75, 0.5, 0.25)
"""Number of colours that cover most, and shares of the cables' own colours on white besides.

All frames have the same ones: flat areas stay as they are between them.
"""


def save_readme_film(plan: ho.Plan, path: Path) -> None:
    """Write the film of a plan as a small gif.

    Parameters
    ----------
    plan: what is shown.
    path: the file, replaced if it exists.
    """
    step = SPEED * INTERVAL
    times = step * np.arange(int(np.ceil(plan.duration / step)) + 1)
    scene = scene_of(plan.motion)
    title = f"{plan.title} ({SPEED:g} × the flight's speed)"
    small = [
        Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS)
        for frame in frames(scene, np.minimum(times, plan.duration), title)
    ]
    sheet = Image.new("RGB", (SIZE[0], SIZE[1] * len(small[:: len(small) // 8])))
    for i, frame in enumerate(small[:: len(small) // 8]):
        sheet.paste(frame, (0, i * SIZE[1]))
    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette(sheet))
    first, *others = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in small)
    shown = [1000 * INTERVAL] * len(others) + [1000 * REST]
    first.save(
        path, save_all=True, append_images=others, duration=shown, loop=0, optimize=True
    )  # fmt: skip


def _palette(sheet: Image.Image) -> list[int]:
    """Return red, green and blue of all colours, from a sheet of some frames."""
    common = sheet.quantize(COMMON).getpalette()[: 3 * COMMON]
    own = 255.0 * np.array([to_rgb(colour) for colour in (*COLOURS, FRAME)])
    tints = [share * own + (1.0 - share) * 255.0 for share in TINTS]
    return [*common, *np.rint(np.concatenate(tints)).astype(int).ravel().tolist()]


def main() -> None:
    """Draw the film of the plan in the directory that is named."""
    save_readme_film(ho.load(sys.argv[1]), FILM)
    sys.stdout.write(f"wrote {FILM}, {FILM.stat().st_size / 1e6:.2f} MB\n")


if __name__ == "__main__":
    main()
