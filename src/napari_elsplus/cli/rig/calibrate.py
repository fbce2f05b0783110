"""``calibrate``: from frames of line, sweep, bundle, background and flat to a calibration file."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import click

from napari_elsplus.cli.options import (
    FILE,
    POSITIVE,
    calibration_files,
    calibration_progress,
    force_option,
    progress,
    refuse_outputs,
)
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import PRESETS, require_bundle_um
from napari_elsplus.processing.calibration.file_options import FILE_OPTIONS, FileOption, added_steps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.step import Target

DEFAULT_PRESET: Final = "240hz"
PLAIN: Final = str.maketrans({"±": "+-", "µ": "u", "°": " deg", "²": "^2", "Ø": "diameter", "\n": ", "})
"""Characters of a summary that not every terminal can print."""


def _file_options() -> dict[str, FileOption]:
    """Return the options for recorded frames by the key of their step, those of installed packages included."""
    if not added_steps():
        return FILE_OPTIONS
    from napari_elsplus.processing.calibration.steps import calibration_steps

    return {step.key: FileOption(step.option, step.option_help) for step in calibration_steps() if step.option}


def _step_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add an option to the command for each step that can be measured from a file; its parameter is the step's key."""
    for key, option in reversed(_file_options().items()):
        command = click.option(f"--{option.name}", key, type=FILE, help=option.help)(command)
    return command


@click.command()
@_step_options
@click.option(
    "--volts",
    type=FILE,
    help="CSV: header `volts`, a line per frame  [default: NAME_volts.csv beside the sweep]",
)
@click.option("--um-per-px", type=POSITIVE, help="Micrometres at the specimen for one camera pixel.")
@click.option(
    "--bundle-um",
    type=POSITIVE,
    help="Diameter of the bundle at the specimen in micrometres, instead of --um-per-px; of a probe with a lens that "
    "of its field of view.",
)
@click.option("--line-period-s", type=POSITIVE, help="Seconds from one row's readout to the next.")
@click.option("--rows-per-frame", type=POSITIVE, help="Line periods from one frame to the next.")
@click.option("--rig", help="Measure everything live on this rig instead; `simulated` runs unattended.")
@click.option("--preset", type=click.Choice(list(PRESETS)), help=f"With --rig.  [default: {DEFAULT_PRESET}]")
@click.option("--rate-hz", type=POSITIVE, help="With --rig: frames per second.  [default: the preset's]")
@click.option("-o", "--output", type=FILE, required=True, help="Calibration file to write, NAME.json.")
@click.option(
    "--report",
    type=FILE,
    help="PDF to write, too: every number, fit, residual and picture, the date, and the folder's earlier calibrations.",
)
@force_option
def command(
    rig: str | None,
    preset: str | None,
    rate_hz: float | None,
    volts: Path | None,
    um_per_px: float | None,
    bundle_um: float | None,
    line_period_s: float | None,
    rows_per_frame: float | None,
    output: Path,
    report: Path | None,
    force: bool,
    **files: Path | None,
) -> None:
    """Measure a calibration from any subset of the inputs, or live on a rig; print the results with uncertainties."""
    names = {key: option.name for key, option in _file_options().items()}
    given = {names[key]: path for key, path in files.items() if path}
    refuse_outputs(
        *calibration_files(output),
        report,
        force=force,
        inputs=(volts, *given.values()),
        suffixes={output: ".json", report: ".pdf"},
    )
    if bundle_um is not None:
        require_bundle_um(bundle_um)  # before a rig starts
    if rig is not None:
        if given:
            raise InputError(f"both --rig and --{next(iter(given))}", "measure live or from files, not both")
        stated = {
            "um-per-px": um_per_px,
            "volts": volts,
            "line-period-s": line_period_s,
            "rows-per-frame": rows_per_frame,
        }
        for name, value in stated.items():
            if value is not None:
                instead = "give the bundle's diameter, --bundle-um" if value is um_per_px else "the rig states its own"
                raise InputError(f"--{name} {value} with --rig", instead)
    elif preset is not None:
        raise InputError(f"--preset {preset} without --rig", "frames from files have their own size and timing")
    elif rate_hz is not None:
        raise InputError(f"--rate-hz {rate_hz:g} without --rig", "give --rows-per-frame with frames from files")
    elif not given:
        raise InputError(
            "there is nothing to measure", f"give one of {', '.join('--' + name for name in names.values())}, or --rig"
        )

    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.io import write_calibration
    from napari_elsplus.processing.calibration.draft import Setup
    from napari_elsplus.workflows.calibration import calibrate
    from napari_elsplus.workflows.calibration_report.history import calibration_history
    from napari_elsplus.workflows.calibration_report.report import save_calibration_report

    if rig is not None:
        draft, setup = _live(rig, Settings(preset or DEFAULT_PRESET, frame_rate_hz=rate_hz), bundle_um)
    else:
        draft = calibrate(
            **given,
            volts=volts,
            um_per_px=um_per_px,
            bundle_um=bundle_um,
            line_period_s=line_period_s,
            line_periods_per_frame=rows_per_frame,
            progress=progress,
        )
        assert draft.calibration.frame is not None
        setup = Setup(draft.calibration.frame, line_period_s=line_period_s)
    write_calibration(output, draft.calibration, force=force)
    for line in summary(draft, setup):
        click.echo(line)
    click.echo(f"wrote {output}")
    if report is not None:
        pages = save_calibration_report(draft, report, history=calibration_history(output.parent), force=force)
        click.echo(f"wrote {report}: {pages} pages")


def _live(rig_name: str, settings: Settings, bundle_um: float | None) -> tuple[Draft, Setup]:
    """Calibrate on a rig, its user placing each target; the line is parked on every way out."""
    from napari_elsplus.acquisition.calibrating.live import SWEEP_VOLTAGES, calibrate_rig, engine_setup
    from napari_elsplus.acquisition.calibrating.simulated import calibrate_simulated
    from napari_elsplus.acquisition.live_engine import live_engine
    from napari_elsplus.hardware.priority import keep_pace

    def confirm(target: Target) -> None:
        click.confirm(f"Please {target.value}. Is it so?", abort=True, err=True, default=True)

    keep_pace()
    with live_engine(rig_name, settings) as (rig, engine):
        engine.show(None)
        calibrate = (
            partial(calibrate_rig, engine, confirm) if rig.bench is None else partial(calibrate_simulated, rig, engine)
        )
        draft = calibrate(voltages=SWEEP_VOLTAGES, bundle_um=bundle_um, progress=calibration_progress)
        return draft, engine_setup(engine)


def summary(draft: Draft, setup: Setup) -> Iterator[str]:
    """Yield the results of a draft and its setup in words, some lines a step."""
    from napari_elsplus.processing.calibration.steps import calibration_steps

    for step in calibration_steps():
        if step.key in draft.found:
            found = step.summary(draft, draft.found[step.key], setup)
            for line in (f"{step.title}: {found.headline}", *(f"  {line}" for line in (*found.lines, *found.details))):
                yield line.translate(PLAIN)
            for warning in found.warnings:
                yield f"  note: {warning}".translate(PLAIN)
