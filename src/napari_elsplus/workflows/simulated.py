"""Simulated recordings, axial scans and calibration frames with known truth, as arrays or as files."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.virtual.steady_scan import steady_line_rows
from napari_elsplus.io import (
    ImageMetadata,
    beside,
    refuse_existing,
    write_calibration,
    write_column,
    write_images,
    write_json,
)
from napari_elsplus.io.atomic import in_folder
from napari_elsplus.io.disk import require_room
from napari_elsplus.io.formats.registry import format_to_write
from napari_elsplus.io.formats.source import MAX_FRAMES
from napari_elsplus.io.text import read_lines
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.simulation import calibration_scenes, truth
from napari_elsplus.simulation.axial_scan import axial_scan, lit_for_plate, scan_depths_um
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, LineModel
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.frames import RenderedFrames
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import Scene, picture, scene
from napari_elsplus.simulation.specimen.trajectories import Recorded, trajectory

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration


@dataclass(frozen=True)
class SimulatedRecording(RenderedFrames):
    """Raw frames of the model instrument with their calibration and truth.

    Attributes
    ----------
    calibration : Calibration
        The one that a perfect measurement of the instrument would give.
    truth : dict
        Geometry of the instrument and motion of the probe, as written to ``NAME.truth.json``.
    depth_um : numpy.ndarray or None
        (T,) depths of an axial scan.
    """

    calibration: Calibration
    truth: dict[str, Any]
    depth_um: NDArray[np.float64] | None = None

    def save(self, path: str | os.PathLike[str], *, force: bool = False, progress: Progress = without_display) -> None:
        """Write the frames in the suffix's format; beside them NAME.{calibration.json,truth.json,depths.csv}.

        Parameters
        ----------
        path : path-like
            File of the frames: ``NAME.ome.tif`` for OME-TIFF, ``NAME.ome.zarr`` for OME-Zarr.
        force : bool
            Overwrite existing files.
        progress : Progress
            Wraps the frames' numbers.

        Raises
        ------
        InputError
            If no format writes the suffix, or a file exists and `force` is not given; then none is written.
        """
        output = Path(path)
        format_to_write(output)
        record, facts = beside(output, ".calibration.json"), beside(output, ".truth.json")
        depths = beside(output, ".depths.csv")
        scanned = self.depth_um is not None
        for target in (output, record, record.with_suffix(".npz"), facts, *([depths] if scanned else [])):
            refuse_existing(target, force=force)
        frames = (self[index] for index in progress(range(self.count), "depths" if scanned else "frames"))
        metadata = ImageMetadata(calibration=self.calibration, depth_scan=scanned)
        write_images(output, frames, metadata, count=self.count, force=force)
        write_calibration(record, self.calibration, force=force)
        write_json(facts, self.truth, allow_nan=False, force=force)
        if self.depth_um is not None:
            write_column(depths, "depth_um", self.depth_um, force=force)


def simulate_recording(
    *,
    preset: str = "240hz",
    scene_name: str = "fibres",
    scene_um_per_px: float | None = None,
    path: str = "hand",
    speed_um_s: float = 2000.0,
    frames: int = 240,
    rate_hz: float | None = None,
    offset_um: float = -29.0,
    slit_um: float | None = None,
    seed: int = 0,
    imperfections: Imperfections = IDEAL,
) -> SimulatedRecording:
    """Simulate raw frames of a moving probe with known truth.

    Parameters
    ----------
    preset : str
        ``"240hz"`` or ``"120hz"``: camera region and objective.
    scene_name : str
        Scene of :mod:`napari_elsplus.simulation.specimen.scenes`, ``plate:DEPTH_UM``, or an image file.
    scene_um_per_px : float, optional
        Scale of an image file; a camera pixel's by default.
    path : str
        Path of :mod:`napari_elsplus.simulation.specimen.trajectories`, or a CSV file with columns time_s, row_um,
        col_um.
    speed_um_s : float
        Speed of the probe in micrometres per second.
    frames : int
        Number of frames.
    rate_hz : float, optional
        Frames per second; the preset's highest by default.
    offset_um : float
        Slit offset in micrometres at the bundle; negative: the residual image stands higher.
    slit_um : float, optional
        Slit width in micrometres at the bundle, rounded to whole rows; 3 rows by default.
    seed : int
        Seed of the scene and of the camera noise.
    imperfections : Imperfections
        Departures from the ideal instrument.

    Returns
    -------
    SimulatedRecording

    Raises
    ------
    InputError
        If there are no frames, or more than can be read; there is no such scene or path; the path leaves the scene; or
        the optics do not fit the camera region.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise InputError(f"a recording of {frames} frames", f"give 1 to {MAX_FRAMES}, which can be read")
    instrument = Instrument.of(
        preset, slit_um=slit_um, offset_um=offset_um, rate_hz=rate_hz, imperfections=imperfections
    )
    moved = _recorded(Path(path)) if Path(path).suffix else trajectory(path, speed_um_s=speed_um_s, seed=seed)
    specimen = _scene(scene_name, seed, scene_um_per_px, instrument.optics.um_per_px)
    renderer = Renderer(instrument, specimen, moved, seed=seed)
    renderer.refuse_path(frames)
    facts = {"scene": scene_name, "path": path, **truth.motion(instrument, moved, frames)}
    line_rows = steady_line_rows(instrument) if imperfections.moves_galvo else None
    return _simulated(instrument, seed, facts, partial(renderer.render, line_rows=line_rows), frames)


def simulate_axial_scan(
    *,
    slit_um: float = 2.9,
    offset_um: float = 29.0,
    state: str = "a",
    depth_um: Sequence[float] | NDArray[np.float64] | None = None,
    seed: int = 0,
    imperfections: Imperfections = IDEAL,
) -> SimulatedRecording:
    """Simulate a scan of depths: a raw frame of a stained plate at each, as sectioning is measured.

    Parameters
    ----------
    slit_um : float
        Slit width in micrometres at the bundle, rounded to whole rows.
    offset_um : float
        Slit offset in micrometres at the bundle.
    state : str
        Line model: ``"a"`` and ``"b"`` of the paper's panels, or the sharper one of ``"c"`` and ``"d"``.
    depth_um : sequence of float, optional
        (T,) distances of the plate from contact; by default 2 um apart near the focus, farther apart beyond.
    seed : int
        Seed of the camera noise.
    imperfections : Imperfections
        Departures from the ideal instrument.

    Returns
    -------
    SimulatedRecording
        With `depth_um`.

    Raises
    ------
    InputError
        If there is no depth, or one is not finite, no such line model, or the optics do not fit the camera region.
    """
    depths = scan_depths_um() if depth_um is None else np.asarray(depth_um, np.float64)
    if not (depths.size and np.isfinite(depths).all()):
        raise InputError(f"a scan of {depths.size} depths", "give one or more finite depths in micrometres")
    line = _line_model(state)
    instrument = lit_for_plate(
        Instrument.of("120hz", slit_um=slit_um, offset_um=offset_um, line=line, imperfections=imperfections)
    )
    line_rows = steady_line_rows(instrument) if imperfections.moves_galvo else None
    scan = axial_scan(instrument, depths, seed=seed, line_rows=line_rows)
    return _simulated(instrument, seed, {"state": state}, scan.render, scan.count, depths)


@dataclass(frozen=True)
class SimulatedCalibrationFrames:
    """The recordings that a calibration is measured from, with known truth.

    Attributes
    ----------
    line, sweep, bundle, background : RenderedFrames
        Raw frames (rows, cols) uint8: the line standing, the line at each of `volts`, the bundle lit from its far end,
        a dark tube.
    volts : numpy.ndarray
        (T,) galvo voltages of the sweep.
    um_per_px : float
        Micrometres at the bundle per camera pixel.
    truth : dict
        Geometry of the instrument.
    """

    line: RenderedFrames
    sweep: RenderedFrames
    bundle: RenderedFrames
    background: RenderedFrames
    volts: NDArray[np.float64]
    um_per_px: float
    truth: dict[str, Any]

    def save(
        self, folder: str | os.PathLike[str], *, force: bool = False, progress: Progress = without_display
    ) -> None:
        """Write line.tif, sweep.tif, sweep_volts.csv, transmission.tif, background.tif and truth.json into a folder.

        Parameters
        ----------
        folder : path-like
            Made if it does not exist.
        force : bool
            Overwrite existing files.
        progress : Progress
            Wraps the frames' numbers, once for each file.

        Raises
        ------
        InputError
            If a file exists and `force` is not given; then none is written.
        """
        folder = Path(folder)
        parts = {"line": self.line, "sweep": self.sweep, "transmission": self.bundle, "background": self.background}
        with in_folder(folder):
            for name in (*(f"{part}.tif" for part in parts), "sweep_volts.csv", "truth.json"):
                refuse_existing(folder / name, force=force)
            require_room(folder / "line.tif", sum(len(frames) * frames[0].nbytes for frames in parts.values()))
            for part, frames in parts.items():
                shown = (frames[index] for index in progress(range(len(frames)), part))
                metadata = ImageMetadata(um_per_px=self.um_per_px)
                write_images(folder / f"{part}.tif", shown, metadata, count=len(frames), force=force)
            write_column(folder / "sweep_volts.csv", "volts", self.volts, force=force)
            write_json(folder / "truth.json", self.truth, allow_nan=False, force=force)


def simulate_calibration(
    *,
    preset: str = "240hz",
    offset_um: float = -29.0,
    slit_um: float | None = None,
    state: str = "a",
    seed: int = 0,
    imperfections: Imperfections = IDEAL,
) -> SimulatedCalibrationFrames:
    """Simulate the recordings that a calibration is measured from: line, sweep, transmission, background.

    Parameters
    ----------
    preset : str
        ``"240hz"`` or ``"120hz"``: camera region and objective.
    offset_um : float
        Slit offset in micrometres at the bundle; negative: the residual image stands higher.
    slit_um : float, optional
        Slit width in micrometres at the bundle, rounded to whole rows; 3 rows by default.
    state : str
        Line model, as of :func:`simulate_axial_scan`.
    seed : int
        Seed of the camera noise.
    imperfections : Imperfections
        Departures from the ideal instrument.

    Returns
    -------
    SimulatedCalibrationFrames
    """
    instrument = Instrument.of(
        preset, slit_um=slit_um, offset_um=offset_um, line=_line_model(state), imperfections=imperfections
    )
    volts = calibration_scenes.sweep_volts(instrument)
    return SimulatedCalibrationFrames(
        line=calibration_scenes.standing_line(instrument, calibration_scenes.line_volts(instrument), seed=seed),
        sweep=calibration_scenes.standing_line(instrument, volts, seed=seed + 1),
        bundle=calibration_scenes.transmission(instrument, seed=seed + 2),
        background=calibration_scenes.dark_tube(instrument, seed=seed + calibration_scenes.DARK_TUBE_SEED),
        volts=volts,
        um_per_px=instrument.optics.um_per_px,
        truth={"seed": seed, **truth.geometry(instrument)},
    )


def _simulated(
    instrument: Instrument,
    seed: int,
    facts: dict[str, Any],
    render: Callable[[int], NDArray[np.uint8]],
    count: int,
    depth_um: NDArray[np.float64] | None = None,
) -> SimulatedRecording:
    calibration = truth.true_calibration(instrument, calibration_scenes.background(instrument, seed=seed))
    known = {**truth.geometry(instrument), "seed": seed, **facts}
    return SimulatedRecording(render, count, calibration, known, depth_um)


def _line_model(state: str) -> LineModel:
    if state not in LINE_MODELS:
        raise InputError(f"there is no line model {state!r}", f"choose one of {', '.join(LINE_MODELS)}")
    return LINE_MODELS[state]


def _scene(name: str, seed: int, um_per_px: float | None, camera_um_per_px: float) -> Scene:
    if Path(name).suffix and not name.startswith("plate:"):  # plate:50.5 has no suffix
        image = cv2.imread(name, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if Path(name).is_file() else None
        if image is None:
            raise InputError(f"{name} is no image that can be read", "give PNG, TIFF or JPEG")
        return picture(image, um_per_px or camera_um_per_px)
    if um_per_px is not None:
        raise InputError(f"the scene {name} has no pixels", "leave out --scene-um-per-px, or name an image file")
    return scene(name, seed)


def _recorded(path: Path) -> Recorded:
    """Read a path from CSV: columns time_s, row_um, col_um, as a track has them."""
    wanted = ("time_s", "row_um", "col_um")
    remedy = f"give columns {', '.join(wanted)}"
    lines = read_lines(path, remedy)
    try:
        rows = [[float(row[name]) for name in wanted] for row in csv.DictReader(lines)]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path.name} is no recorded path ({error!s:.60})", remedy) from None
    table = np.array(rows, np.float64).reshape(-1, 3)
    return Recorded(table[:, 0], table[:, 1:])
