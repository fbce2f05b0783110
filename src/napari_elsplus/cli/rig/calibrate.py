"""``calibrate``: from frames of line, sweep, bundle, background and flat to a calibration file."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated
from napari_elsplus.acquisition.calibrating.whole import SWEEP_VOLTAGES, Target, calibrate_rig
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.session import live_engine
from napari_elsplus.cli.options import FILE, POSITIVE, force_option, progress, refuse_outputs
from napari_elsplus.cli.rig.live import watch_calibration
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import BUNDLE_UM, PRESETS
from napari_elsplus.io import open_recording, read_volts, write_calibration
from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT
from napari_elsplus.processing.calibration.calibrate import Findings, measure
from napari_elsplus.processing.calibration.galvo import PAPER_VOLTAGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

INPUTS = ("line", "sweep", "bundle", "background", "flat")


@click.command(short_help="Measure offset, galvo map and bundle pair.")
@click.option("--line", type=FILE, help="Frames of the laser line standing near the middle of the bundle.")
@click.option("--sweep", type=FILE, help="A frame per voltage, the line standing.")
@click.option("--volts", type=FILE, help="CSV with header `volts`, a line per frame of the sweep.")
@click.option("--bundle", type=FILE, help="Frames of the bundle lit from its far end.")
@click.option("--background", type=FILE, help="Frames of a dark tube, laser on; the paper takes 50.")
@click.option("--flat", type=FILE, help="Frames of a uniform scene; the bundle's image serves if it is not given.")
@click.option("--um-per-px", type=POSITIVE, help="Micrometres at the bundle for one camera pixel.")
@click.option("--bundle-um", type=POSITIVE, help="The bundle image's diameter in micrometres, instead of --um-per-px.")
@click.option("--line-period-s", type=POSITIVE, help="Seconds from one row's readout to the next.")
@click.option("--rows-per-frame", type=POSITIVE, help="Line periods from one frame to the next.")
@click.option("--rig", help="Measure everything live on this rig instead; `simulated` needs nobody's hands.")
@click.option("--preset", type=click.Choice(list(PRESETS)), default="240hz", show_default=True, help="With --rig.")
@click.option("-o", "--output", type=FILE, required=True, help="Calibration file to write, NAME.json.")
@force_option
def command(
    rig: str | None,
    preset: str,
    volts: Path | None,
    um_per_px: float | None,
    bundle_um: float | None,
    line_period_s: float | None,
    rows_per_frame: float | None,
    output: Path,
    force: bool,
    **files: Path | None,
) -> None:
    """Measure a calibration from any subset of the inputs, or live on a rig; say what was found, how surely."""
    refuse_outputs(output, output.with_suffix(".npz"), force=force, inputs=(volts, *files.values()))
    given = [name for name, path in files.items() if path]
    if rig is not None:
        if given:
            raise InputError(f"both --rig and --{given[0]}", "measure live or from files, not both")
        findings = _live(rig, preset, bundle_um)
    elif not given:
        raise InputError(
            "there is nothing to measure", f"give one of {', '.join('--' + name for name in INPUTS)}, or --rig"
        )
    else:
        with ExitStack() as stack:
            recordings = {name: stack.enter_context(open_recording(path)) for name, path in files.items() if path}
            findings = measure(
                **recordings,
                volts=None if volts is None else read_volts(volts),
                um_per_px=um_per_px,
                bundle_um=bundle_um,
                line_period_s=line_period_s,
                line_periods_per_frame=rows_per_frame,
                watch=lambda numbers: progress(numbers, "sweep"),
            )
    write_calibration(output, findings.calibration, force=force)
    for found in summary(findings):
        click.echo(found)
    click.echo(f"wrote {output}")


def _live(rig_name: str, preset: str, bundle_um: float | None) -> Findings:
    """Calibrate on a rig, asking for each target; the mirror is parked on every way out."""

    def ask(target: Target) -> None:
        click.confirm(f"Please {target.value}. Is it so?", abort=True, err=True, default=True)

    with live_engine(rig_name, Settings(preset)) as (rig, engine):
        if rig.bench is not None:
            findings, lag = calibrate_simulated(rig, engine, voltages=SWEEP_VOLTAGES, watch=watch_calibration)
        else:
            findings, lag = calibrate_rig(engine, ask, bundle_um=bundle_um or BUNDLE_UM, watch=watch_calibration)
    click.echo(f"scan lag: {1e6 * lag.lag_s:.2f} +- {1e6 * lag.uncertainty_s:.2f} us")
    return findings


def summary(findings: Findings) -> Iterable[str]:
    """Say what was found, a line each."""
    yield from _bundle(findings)
    yield from _offset(findings)
    yield from _galvo(findings)
    if findings.background is not None:
        yield f"background: {findings.background.frames} frames, drift {100 * findings.background.drift:.2f} %"


def _bundle(findings: Findings) -> Iterator[str]:
    pair, quality, (raw, filtered) = findings.pair, findings.calibration.quality, PAPER_ALIGNMENT_PERCENT
    if pair is None or quality is None:
        return
    for name, disc in (("confocal", pair.left), ("residual", pair.right)):
        yield (
            f"{name} bundle: centre row {disc.centre[0]:.2f}, column {disc.centre[1]:.2f} "
            f"+- {disc.centre_uncertainty_px:.2f} px, diameter {disc.diameter_px:.2f} "
            f"+- {disc.diameter_uncertainty_px:.2f} px (threshold {disc.threshold:.3g})"
        )
    yield (
        f"right onto left: {pair.alignment.model} to {pair.alignment.uncertainty_px:.3f} px, "
        f"gain {pair.alignment.gain:.4f} +- {pair.alignment.gain_uncertainty:.4f}"
    )
    if not pair.shows_flat_field:
        yield f"note: {100 * pair.saturated:.0f} % of the bundle's image is saturated: no flat field is made of it"
    yield (
        f"alignment error: {100 * quality.alignment_error:.2f} %, "
        f"{100 * quality.alignment_error_filtered:.2f} % after the core filter (paper: {raw} %, {filtered} %)"
    )


def _offset(findings: Findings) -> Iterator[str]:
    offset = findings.offset
    if offset is None:
        return
    scale = findings.calibration.um_per_px
    in_um = f" ({offset.rows * scale:.2f} um)" if scale is not None else ""
    yield (
        f"slit offset: {offset.rows:.3f} +- {offset.uncertainty_rows:.3f} rows{in_um}, "
        f"line tilt {offset.left.tilt_deg:.2f} +- {offset.left.tilt_uncertainty_deg:.2f} deg"
    )


def _galvo(findings: Findings) -> Iterator[str]:
    galvo, section = findings.galvo, findings.calibration.galvo
    if galvo is None or section is None:
        return
    yield (
        f"galvo: {galvo.volts_per_row:.7f} +- {galvo.volts_per_row_uncertainty:.1g} V/row, "
        f"{galvo.volts_at_row_zero:.5f} +- {galvo.volts_at_row_zero_uncertainty:.1g} V at row 0, "
        f"R^2 {galvo.r_squared:.6f}, {galvo.rms_rows:.3f} rows RMS, line tilt {galvo.tilt_deg:.2f} deg"
    )
    yield f"sweep: {galvo.lines} frames fitted, {galvo.dark} without a whole line, {galvo.outliers} outliers"
    if section.park_v is not None:
        yield f"park voltage: {section.park_v:.4f} V"
    if galvo.curved:
        yield f"note: the galvo is not linear, it departs by up to {galvo.curvature_rows:.2f} rows from the line"
    if len(galvo.volts) + galvo.dark < PAPER_VOLTAGES:
        yield f"note: {len(galvo.volts) + galvo.dark} voltages; the paper takes at least {PAPER_VOLTAGES}"
