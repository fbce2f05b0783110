"""Draw every panel in both themes and two window sizes: ``python3 run.py screens``, from a checkout."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import click
import napari

from benchmarks.screens.clipping import clipped_texts
from benchmarks.screens.scenes import SETTLE_S, Scene
from benchmarks.screens.walk import open_dock_in, walk_to_figure, walk_to_mosaic, write_videos

SIZES: Final = ((1280, 800), (1600, 1000))
"""Width and height of the window, pixels: a laptop, and a desk."""
THEMES: Final = ("dark", "light")

RATE_S: Final = 4.0
"""Time for the display rate, which is averaged over 61 images, to forget the resizing, seconds."""
WALK_FRAMES: Final = 60
"""Frames of the recording of the walk: a quarter of a second."""
DOCS: Final = Path(__file__).parents[2] / "docs" / "images"
IN_DOCS: Final = {
    "Start": "window", "Compare": "compare", "Compare difference": "compare-difference",
    "Axial response": "axial-panel", "Mosaic": "mosaic-panel", "Live": "live-panel",
    "Calibration offset": "calibration-offset", "Calibration pair": "calibration-pair",
}  # fmt: skip
"""Pictures of the documentation by title; drawn in the first size and theme."""


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("screens"), show_default=True)
@click.option("--docs", is_flag=True, help="Save the pictures of the documentation into docs/images, and no others.")
@click.option("--walk", is_flag=True, help="Time the way from another lab's videos to a figure and a mosaic.")
def main(out: Path, docs: bool, walk: bool) -> None:
    """Save PANEL-WIDTHxHEIGHT-THEME.png for each into a folder, and list text that does not fit; exit 1 if any."""
    if walk:
        walk_and_time(DOCS if docs else out)
        return
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


def walk_and_time(out: Path) -> None:
    """Go from videos to a figure and a mosaic, save the figure into a folder, and print the time of each step."""
    with TemporaryDirectory() as settings, TemporaryDirectory() as given:
        os.environ["ELSPLUS_CONFIG"] = settings  # as at the first start
        folder = Path(given)
        write_videos(folder, WALK_FRAMES)
        viewer = napari.Viewer()
        viewer.window.resize(*SIZES[0])
        dock = open_dock_in(viewer)
        hand = walk_to_figure(dock, folder)
        figure_s = hand.seconds
        compare: Any = dock.by_title["Compare"].panel
        compare.save_figure_to(folder / "published-figure.png")
        walk_to_mosaic(hand, folder)
        for step in hand.steps:
            click.echo(f"{step.action:45} person {step.person_s:5.1f} s, computer {step.computer_s:5.1f} s")
        click.echo(f"{figure_s:.0f} s to the figure, {hand.seconds:.0f} s to the mosaic, {hand.typed} typed numbers")
        out.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "published-figure.png", out)
        for tab in dock.by_title.values():
            tab.cleanup()
        viewer.close()


if __name__ == "__main__":
    main()
