"""Draw every panel in both themes and two window sizes: ``python3 run.py screens``, from a checkout."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import click

from benchmarks.screens.clipping import clipped_texts
from benchmarks.screens.scenes import SETTLE_S, Scene

SIZES: Final = ((1280, 800), (1600, 1000))
"""Width and height of the window, pixels: a laptop, and a desk."""
THEMES: Final = ("dark", "light")

RATE_S: Final = 4.0
"""Time for the display rate, which is averaged over 61 images, to forget the resizing, seconds."""
DOCS: Final = Path(__file__).parents[2] / "docs" / "images"
IN_DOCS: Final = {
    "Compare": "compare", "Compare difference": "compare-difference", "Axial response": "axial-panel",
    "Mosaic": "mosaic-panel", "Live": "live-panel", "Calibration offset": "calibration-offset",
    "Calibration pair": "calibration-pair",
}  # fmt: skip
"""Pictures of the documentation by title; drawn in the first size and theme."""


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("screens"), show_default=True)
@click.option("--docs", is_flag=True, help="Save the pictures of the documentation into docs/images, and no others.")
def main(out: Path, docs: bool) -> None:
    """Save PANEL-WIDTHxHEIGHT-THEME.png for each into a folder, and list text that does not fit; exit 1 if any."""
    sizes, themes = (SIZES[:1], THEMES[:1]) if docs else (SIZES, THEMES)
    out = DOCS if docs else out
    out.mkdir(parents=True, exist_ok=True)
    clipped = []
    with TemporaryDirectory() as settings:
        os.environ["ELSPLUS_CONFIG"] = settings  # as at the first start
        scene = Scene(SIZES[0])
        window = scene.dock.window()
        assert window is not None
        for title in scene.panels():
            if docs and title not in IN_DOCS:
                continue
            for width, height in sizes:
                scene.viewer.window.resize(width, height)
                for theme in themes:
                    scene.viewer.theme = theme
                    scene.settle()
                    scene.fit()
                    scene.settle(RATE_S if title == "Live" else SETTLE_S)
                    name = f"{title.lower().replace(' ', '-')}-{width}x{height}-{theme}"
                    window.grab().save(str(out / f"{IN_DOCS[title] if docs else name}.png"))
                    clipped += [f"{name}: {text}" for text in clipped_texts(scene.dock)]
            click.echo(title)
        scene.close()
    for line in clipped:
        click.echo(line, err=True)
    raise SystemExit(1 if clipped else 0)


if __name__ == "__main__":
    main()
