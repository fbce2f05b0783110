"""``simulate``: raw frames from the model instrument, with truth and calibration beside them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cv2
import numpy as np

from napari_elsplus.cli.options import (
    FILE,
    NUMBER,
    POSITIVE,
    SEED,
    force_option,
    output_option,
    progress,
    refuse_outputs,
)
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.io import beside, replacing, write_calibration, write_column, write_stack
from napari_elsplus.simulation import calibration_scenes, truth
from napari_elsplus.simulation.axial_scan import AxialScan, lit_for_plate, scan_depths_um
from napari_elsplus.simulation.model.axial_response import LINE_MODELS
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import SCENES, Scene, picture, scene
from napari_elsplus.simulation.specimen.trajectories import PATHS, Recorded, Trajectory, trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

preset_option = click.option(
    "--preset",
    type=click.Choice(list(PRESETS)),
    default="240hz",
    show_default=True,
    help="Camera region and objective.",
)
offset_option = click.option(
    "--offset-um",
    type=NUMBER,
    default=-29.0,
    show_default=True,
    help="Slit offset; negative: the residual stands higher.",
)
slit_option = click.option("--slit-um", type=POSITIVE, help="Slit width, rounded to whole rows; 3 rows by default.")
seed_option = click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of scene and camera noise.")


@click.group(short_help="Raw frames from the model instrument.")
def command() -> None:
    """Make raw frames with the model instrument, truth and calibration beside them."""


@command.command()
@preset_option
@click.option(
    "--scene",
    "scene_name",
    default="fibres",
    show_default=True,
    help=f"{', '.join(SCENES)}, plate:DEPTH_UM, or an image file.",
)
@click.option("--scene-um-per-px", type=POSITIVE, help="Scale of an image file; a camera pixel's by default.")
@click.option(
    "--path",
    "path_name",
    default="hand",
    show_default=True,
    help=f"{', '.join(PATHS)}, or a CSV file with columns time_s, row_um, col_um.",
)
@click.option("--speed-um-s", type=NUMBER, default=2000.0, show_default=True, help="Speed of the probe.")
@click.option("--frames", type=click.IntRange(min=1), default=240, show_default=True, help="Number of frames.")
@click.option("--rate-hz", type=POSITIVE, help="Frames per second, below the preset's.")
@offset_option
@slit_option
@seed_option
@output_option
@force_option
def recording(
    preset: str, scene_name: str, scene_um_per_px: float | None, path_name: str, speed_um_s: float, frames: int,
    rate_hz: float | None, offset_um: float, slit_um: float | None, seed: int, output: Path, force: bool,
) -> None:  # fmt: skip
    """Record a moving probe: raw frames, NAME.truth.json, NAME.calibration.json."""
    instrument = Instrument.of(preset, slit_um=slit_um, offset_um=offset_um, rate_hz=rate_hz)
    moved = _trajectory(path_name, speed_um_s, seed)
    looked_at = _scene(scene_name, seed, scene_um_per_px, instrument.optics.um_per_px)
    renderer = Renderer(instrument, looked_at, moved, seed=seed)
    renderer.refuse_path(frames)
    facts = {"seed": seed, "scene": scene_name, "path": path_name, **truth.motion(instrument, moved, frames)}
    _write(output, _counted(renderer.render, frames), instrument, facts, force=force)


@command.command()
@click.option("--slit-um", type=POSITIVE, default=2.9, show_default=True, help="Slit width, rounded to whole rows.")
@click.option("--offset-um", type=NUMBER, default=29.0, show_default=True, help="Slit offset.")
@click.option(
    "--state",
    type=click.Choice(list(LINE_MODELS)),
    default="a",
    show_default=True,
    help="Line of the paper's panels (a, b), or the sharper one of (c, d).",
)
@seed_option
@output_option
@force_option
def axial(slit_um: float, offset_um: float, state: str, seed: int, output: Path, force: bool) -> None:
    """Scan depths: a raw frame of a stained plate at each, NAME.depths.csv, NAME.calibration.json, NAME.truth.json."""
    instrument = lit_for_plate(Instrument.of("120hz", slit_um=slit_um, offset_um=offset_um, line=LINE_MODELS[state]))
    depths_um = scan_depths_um()
    depths = beside(output, ".depths.csv")
    refuse_outputs(depths, force=force)
    scan = progress(AxialScan(instrument, depths_um, seed=seed), describe="depths", total=len(depths_um))
    _write(output, scan, instrument, {"seed": seed, "state": state}, force=force, axes="ZYX")
    write_column(depths, "depth_um", depths_um, force=force)


@command.command()
@preset_option
@offset_option
@slit_option
@seed_option
@click.option("-o", "--output", type=FILE, required=True, help="Folder to write into.")
@force_option
def calibration(preset: str, offset_um: float, slit_um: float | None, seed: int, output: Path, force: bool) -> None:
    """Record what a calibration needs: line, sweep, transmission, background; and the truth, into a folder."""
    instrument = Instrument.of(preset, slit_um=slit_um, offset_um=offset_um)
    volts = calibration_scenes.sweep_volts(instrument)
    parts: dict[str, Callable[[], Iterator[NDArray[np.uint8]]]] = {
        "line": lambda: calibration_scenes.standing_line(
            instrument, calibration_scenes.line_volts(instrument), seed=seed
        ),
        "sweep": lambda: calibration_scenes.standing_line(instrument, volts, seed=seed + 1),
        "transmission": lambda: calibration_scenes.transmission(instrument, seed=seed + 2),
        "background": lambda: calibration_scenes.dark_tube(instrument, seed=seed + 3),
    }
    output.mkdir(parents=True, exist_ok=True)
    others = ("sweep_volts.csv", "truth.json")
    refuse_outputs(*(output / name for name in (*(f"{part}.tif" for part in parts), *others)), force=force)
    for part, frames in parts.items():
        write_stack(
            output / f"{part}.tif",
            progress(frames(), describe=part),
            um_per_px=instrument.optics.um_per_px,
            force=force,
        )
    write_column(output / "sweep_volts.csv", "volts", volts, force=force)
    _write_json(output / "truth.json", {"seed": seed, **truth.geometry(instrument)}, force=force)
    click.echo(f"wrote {output}")


def _write(
    output: Path,
    frames: Iterable[NDArray[np.uint8]],
    instrument: Instrument,
    facts: dict[str, Any],
    *,
    force: bool,
    axes: str = "TYX",
) -> None:
    """Write frames, calibration and truth; all names are checked before the first frame is made."""
    record, known = beside(output, ".calibration.json"), beside(output, ".truth.json")
    refuse_outputs(output, record, record.with_suffix(".npz"), known, force=force)
    calibration: Calibration = truth.true_calibration(instrument, calibration_scenes.background(instrument))
    count = write_stack(output, frames, calibration=calibration, force=force, axes=axes)
    write_calibration(record, calibration, force=force)
    _write_json(known, {**truth.geometry(instrument), **facts}, force=force)
    click.echo(f"wrote {count} frames to {output}")


def _write_json(path: Path, content: dict[str, Any], *, force: bool) -> None:
    with replacing(path, force=force) as target:
        target.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def _counted(render: Callable[[int], NDArray[np.uint8]], frames: int) -> Iterator[NDArray[np.uint8]]:
    for index in progress(range(frames), describe="frames"):
        yield render(index)


def _scene(name: str, seed: int, um_per_px: float | None, camera_um_per_px: float) -> Scene:
    if Path(name).suffix and not name.startswith("plate:"):  # plate:50.5 has no suffix
        image = cv2.imread(name, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if Path(name).is_file() else None
        if image is None:
            raise InputError(f"{name} is no image that can be read", "give PNG, TIFF or JPEG")
        return picture(image, um_per_px or camera_um_per_px)
    if um_per_px is not None:
        raise InputError(f"the scene {name} has no pixels", "leave out --scene-um-per-px, or name an image file")
    return scene(name, seed)


def _trajectory(name: str, speed_um_s: float, seed: int) -> Trajectory:
    return _recorded(Path(name)) if Path(name).suffix else trajectory(name, speed_um_s=speed_um_s, seed=seed)


def _recorded(path: Path) -> Recorded:
    """Read a path from CSV: columns time_s, row_um, col_um, as a track has them."""
    wanted = ("time_s", "row_um", "col_um")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [[float(row[name]) for name in wanted] for row in csv.DictReader(file)]
    except FileNotFoundError:
        raise InputError(f"there is no file {path}", "check the path") from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path.name} is no recorded path ({error!s:.60})", f"give columns {', '.join(wanted)}"
        ) from None
    table = np.array(rows, np.float64).reshape(-1, 3)
    return Recorded(table[:, 0], table[:, 1:])
