"""The live engine that records, tracks, inserts into a mosaic, and displays three images 60 times a second.

A process of its own: ``python -m benchmarks.rigs.displayed SECONDS RECORDING REPORT``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import click

from benchmarks.rigs.engine_run import run_engine
from benchmarks.rigs.engines import Here
from napari_elsplus.acquisition.engine.live_images import LiveView
from napari_elsplus.processing.images.sectioning import Mode

THREE_IMAGES: Final = LiveView(modes=frozenset({Mode.LS, Mode.RESIDUAL, Mode.ELS}))


@click.command()
@click.argument("seconds", type=float)
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("report", type=click.Path(path_type=Path))
def main(seconds: float, recording: Path, report: Path) -> None:
    """Stream at 240 Hz for some seconds; write a report as `acquire` does."""
    run = run_engine(Here("240hz", record=recording, track=True, view=THREE_IMAGES), seconds, settle_s=0.0)
    report.write_text(json.dumps(run.status.report()), encoding="utf-8")


if __name__ == "__main__":
    main()
