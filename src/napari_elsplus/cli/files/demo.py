"""``demo``: calibrate, acquire, section and mosaic with the simulated rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.cli.options import FILE, force_option, progress

if TYPE_CHECKING:
    from collections.abc import Iterator


@click.command()
@click.option("--out", type=FILE, default=Path("elsplus-demo"), show_default=True, help="Folder for the results.")
@force_option
def command(out: Path, force: bool) -> None:
    """Calibrate the simulated rig, acquire, section and mosaic; report the errors relative to the simulated truth."""
    from napari_elsplus.workflows.demo import FILES, run_demo

    report = run_demo(out, force=force, progress=progress)
    for line in _summary(report):
        click.echo(line)
    click.echo(f"{len(FILES)} files in {out}; contact sheet: {out / 'contact_sheet.png'}")


def _summary(report: dict[str, Any]) -> Iterator[str]:
    errors, track = report["calibration_errors"], report["tracking"]["els"]
    focal = report["correlation_with_focal_plane"]
    yield (
        f"calibrated: slit offset {errors['offset_rows']:+.3f} rows off, "
        f"galvo slope {errors['galvo_slope_percent']:+.4f} %, centre {errors['centre_px']:.3f} px, "
        f"view alignment {errors['pair_alignment_px']:.3f} px"
    )
    yield f"sectioned: correlation with the focal plane {focal['ls']:.3f} for LS, {focal['els']:.3f} for ELS+"
    yield (
        f"tracked: {track['tracked']} of {track['frames']} frames, "
        f"median error {track['median_pair_error_px']:.3f} px a frame, "
        f"{track['end_error_percent_of_path']:.3f} % of the path at its end"
    )
    yield f"took {report['seconds']} s"
