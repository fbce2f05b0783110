"""Mosaics and their track as files: OME-TIFF with pyramid, PNG with scale bar, CSV; and as a script."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.io import ImageMetadata, refuse_existing, write_mosaic, write_track
from napari_elsplus.io.formats.registry import recording_stem
from napari_elsplus.processing.analysis.image_quality import white_level
from napari_elsplus.processing.mosaicing.sheet import Sheet
from napari_elsplus.viewing.mosaic.growing import SATURATED_FRACTION
from napari_elsplus.viewing.script import recording_script, write_script

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.mosaic.mosaics import Mosaics
    from napari_elsplus.viewing.stack import Stack
    from napari_elsplus.workflows.mosaic_plan import MosaicPlan


def save_mosaics(
    mosaics: Mosaics, path: Path, plan: MosaicPlan, calibration: Calibration | None = None, *, force: bool = False
) -> list[Path]:
    """Save each mode's mosaic as NAME.ome.tif and NAME.png, and the track as NAME.track.csv.

    Parameters
    ----------
    mosaics : Mosaics
        The mosaics and the track.
    path : pathlib.Path
        ``NAME.ome.tif``; where there are several modes each one's name is added to NAME.
    plan : MosaicPlan
        Modes, method and insertion; written into the file.
    calibration : Calibration, optional
        Written into the file.
    force : bool
        Replace existing files.

    Returns
    -------
    list of pathlib.Path
        The files. All modes have one size and one layout; the position of each segment's first frame, in pixels of
        the mosaic, is written into each.

    Raises
    ------
    InputError
        If the mosaic is empty, or a file exists and `force` is false.
    """
    from napari_elsplus.workflows.pictures.files import save_figure  # matplotlib, which no panel waits for
    from napari_elsplus.workflows.pictures.mosaic_picture import draw_mosaic

    name = recording_stem(path.name)
    several = len(mosaics.canvases) > 1
    names = {mode: f"{name}-{mode.value}" if several else name for mode in mosaics.canvases}
    table = path.with_name(f"{name}.track.csv")
    targets = [path.with_name(one + ending) for one in names.values() for ending in (".ome.tif", ".png")]
    for target in (*targets, table):
        refuse_existing(target, force=force)
    layout = Sheet.of(mosaics.canvases[plan.tracked])
    part = layout.drawn
    if part is None:
        raise InputError("there is no mosaic to save", "make one first")
    um_per_px = mosaics.scale.um_per_px
    places = {
        str(segment + 1): [row - part.top, col - part.left] for segment, (row, col) in layout.origins.items()
    }  # fmt: skip
    for mode, one in names.items():
        image, weight = Sheet.of(mosaics.canvases[mode], layout).read(part)
        settings = {"mode": mode.value, "method": str(plan.method), "insertion": plan.insertion.value}
        known = {**settings, "first_frames_px": places}
        metadata = ImageMetadata(um_per_px=um_per_px, settings=known, calibration=calibration)
        write_mosaic(path.with_name(f"{one}.ome.tif"), image, metadata, force=force)
        white = white_level(image[weight > 0], SATURATED_FRACTION)
        save_figure(draw_mosaic(image, um_per_px, white), path.with_name(f"{one}.png"), force=force)
    write_track(table, mosaics.rows, force=force)
    return [*targets, table]


def mosaic_script(stack: Stack, calibration_file: Path | None, plan: MosaicPlan) -> str:
    """Return a script that makes and saves the same mosaics.

    Parameters
    ----------
    stack : Stack
        Raw frames of a recording in a file.
    calibration_file : pathlib.Path or None
        Its calibration file.
    plan : MosaicPlan
        Modes, method and insertion.

    Raises
    ------
    InputError
        If the stack has no file.
    CalibrationError
        If the calibration has no file of its own.
    """
    modes = ", ".join(f"Mode.{mode.name}" for mode in plan.modes)
    body = f"""
plan = MosaicPlan(({modes},), {str(plan.method)!r}, Insertion.{plan.insertion.name})
times_s, numbers = recording.times_by(calibration), recording.frame_numbers
mosaics = StackMosaics(recording, calibration, plan, times_s, numbers)
mosaics.run()
for path in save_mosaics(mosaics, Path({f"{stack.name}-mosaic.ome.tif"!r}), plan, calibration):
    print(path)
"""
    imports = (
        "from pathlib import Path",
        "from napari_elsplus.processing.images.sectioning import Mode",
        "from napari_elsplus.processing.mosaicing.mosaic import Insertion",
        "from napari_elsplus.viewing.mosaic.files import save_mosaics",
        "from napari_elsplus.viewing.mosaic.recorded import StackMosaics",
        "from napari_elsplus.workflows.mosaic_plan import MosaicPlan",
    )
    return recording_script(f"Mosaics and track of {stack.file_name}.", stack, calibration_file, body, imports)


def finished_script(stack: Stack, plan: MosaicPlan) -> str:
    """Return a script that makes and saves the mosaic of a stack of finished images.

    Parameters
    ----------
    stack : Stack
        Images in a file.
    plan : MosaicPlan
        Method and insertion.

    Raises
    ------
    InputError
        If the stack has no file.
    """
    if stack.recording is None:
        raise InputError(f"{stack.name} has no file", "save its layer, and open that")
    names = f"{stack.name}-mosaic.ome.tif", f"{stack.name}-mosaic.track.csv"
    body = f"""
with elsplus.open_recording({str(stack.recording.path)!r}) as images:
    result = elsplus.mosaic(images, finished=True, method={str(plan.method)!r}, insertion={plan.insertion.value!r})
result.save({names[0]!r}, {names[1]!r})
"""
    return write_script(f"Mosaic and track of {stack.file_name}.", body)
