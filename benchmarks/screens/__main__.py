"""Draw every panel in both themes and two window sizes: ``python3 run.py screens``, from a checkout."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import click

from benchmarks.screens.clipping import clipped_texts
from benchmarks.screens.scenes import Scene

SIZES: Final = ((1280, 800), (1600, 1000))
"""Width and height of the window, pixels: a laptop, and a desk."""
THEMES: Final = ("dark", "light")


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("screens"), show_default=True)
def main(out: Path) -> None:
    """Save PANEL-WIDTHxHEIGHT-THEME.png for each into a folder, and list text that does not fit; exit 1 if any."""
    out.mkdir(parents=True, exist_ok=True)
    clipped = []
    with TemporaryDirectory() as settings:
        os.environ["ELSPLUS_CONFIG"] = settings  # as at the first start
        scene = Scene(SIZES[0])
        window = scene.dock.window()
        assert window is not None
        for title in scene.panels():
            for width, height in SIZES:
                scene.viewer.window.resize(width, height)
                for theme in THEMES:
                    scene.viewer.theme = theme
                    scene.viewer.reset_view()
                    scene.settle()
                    name = f"{title.lower().replace(' ', '-')}-{width}x{height}-{theme}"
                    window.grab().save(str(out / f"{name}.png"))
                    clipped += [f"{name}: {text}" for text in clipped_texts(scene.dock)]
            click.echo(title)
        scene.close()
    for line in clipped:
        click.echo(line, err=True)
    raise SystemExit(1 if clipped else 0)


if __name__ == "__main__":
    main()
