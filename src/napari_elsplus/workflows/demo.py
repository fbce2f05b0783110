"""Demonstration on the simulated rig: calibrate, acquire, section, mosaic, and compare all results with the truth.

It tests an installation within a minute.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.io import (
    RecordingWriter,
    open_recording,
    refuse_existing,
    write_calibration,
    write_json,
)
from napari_elsplus.io.atomic import in_folder
from napari_elsplus.io.formats.ome_xml import SOFTWARE
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.simulation.accuracy import (
    TrackErrors,
    calibration_errors,
    correlation_with_focal_plane,
    track_errors,
)
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import Straight, trajectory
from napari_elsplus.simulation.truth import motion
from napari_elsplus.workflows.calibration import calibrate
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.mosaicing import mosaic
from napari_elsplus.workflows.pictures.comparison import draw_comparison
from napari_elsplus.workflows.pictures.contact_sheet import draw_contact_sheet
from napari_elsplus.workflows.pictures.files import save_figure
from napari_elsplus.workflows.sectioning import section
from napari_elsplus.workflows.simulated import simulate_calibration

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

FRAMES: Final = 120
SPEED_UM_S: Final = 6000.0
"""Frames and speed of the probe, micrometres per second; chosen: half a second over several fields of view."""
SHOWN_FRAMES: Final = 12
"""Number of images of each mode that are written, from the start of the recording."""
SLOW_RATE_HZ: Final = 10.0
SLOW_SPEED_UM_S: Final = 400.0
"""Frame rate and speed of the probe at which ELSA has motion artefacts, as in the paper's lens-paper figure."""
FILES: Final = (
    "calibration.json",
    "calibration.npz",
    "recording.ome.tif",
    "recording.calibration.json",
    "recording.calibration.npz",
    "ls.ome.tif",
    "residual.ome.tif",
    "els.ome.tif",
    "mosaic_ls.ome.tif",
    "mosaic_els.ome.tif",
    "track.csv",
    "comparison.png",
    "contact_sheet.png",
    "report.json",
)
"""Files that the demonstration writes into its folder."""
_SEED: Final = 1
"""Seed of scene, path and noise; chosen."""


@dataclass(frozen=True)
class _Stage:
    """The simulated rig, its scene, and the folder of the files."""

    instrument: Instrument
    folder: Path
    force: bool
    progress: Progress

    def renderer(self, *, in_focus_only: bool = False) -> Renderer:
        whole = scene("fibres")
        shown = whole.in_focus() if in_focus_only else whole
        path = trajectory("spiral", speed_um_s=SPEED_UM_S)
        return Renderer(self.instrument, shown, path, seed=_SEED, noise=not in_focus_only)


def run_demo(folder: Path, *, force: bool = False, progress: Progress = without_display) -> dict[str, Any]:
    """Calibrate the simulated rig, record a moving probe, make images and mosaics; write them all into a folder.

    Parameters
    ----------
    folder : pathlib.Path
        For the files; made if it does not exist.
    force : bool
        Overwrite existing files.
    progress : Progress
        Wraps the numbers of each step's loop.

    Returns
    -------
    dict
        The report, as written to ``report.json``: errors relative to the simulated truth.

    Raises
    ------
    InputError
        If a file exists and `force` is not given.
    """
    started = perf_counter()
    with in_folder(folder):
        for name in FILES:
            refuse_existing(folder / name, force=force)
        stage = _Stage(Instrument.of("240hz"), folder, force, progress)
        calibration = _calibrate(stage)
        _record(stage, calibration)
        tracks, mosaics, mosaic_um_per_px = _process(stage, calibration)
        slow = _slow_frames(stage.instrument)
        comparison = compare(slow, calibration)
        figure = draw_comparison(comparison)
        save_figure(figure, folder / "comparison.png", force=force)
        sheet = draw_contact_sheet(slow[0], calibration, comparison, mosaics, mosaic_um_per_px)
        save_figure(sheet, folder / "contact_sheet.png", force=force)
        report = {
            "software": SOFTWARE,
            "rig": f"simulated, {stage.instrument.preset.name}",
            "calibration_errors": asdict(calibration_errors(calibration, stage.instrument)),
            "correlation_with_focal_plane": _sectioning(stage, calibration),
            "tracking": {mode.value: asdict(errors) for mode, errors in tracks.items()},
            "seconds": round(perf_counter() - started, 1),
        }
        write_json(folder / "report.json", report, indent=2, force=force)
        return report


def _calibrate(stage: _Stage) -> Calibration:
    """Measure the calibration from frames of the simulated rig, as on a real one."""
    taken, optics = simulate_calibration(seed=_SEED), stage.instrument.optics
    draft = calibrate(
        line=taken.line,
        sweep=taken.sweep,
        volts=taken.volts,
        bundle=taken.bundle,
        background=taken.background,
        um_per_px=taken.um_per_px,
        line_period_s=optics.line_period_s,
        line_periods_per_frame=optics.line_periods_per_frame,
        progress=stage.progress,
    )
    write_calibration(stage.folder / "calibration.json", draft.calibration, force=stage.force)
    return draft.calibration


def _record(stage: _Stage, calibration: Calibration) -> None:
    renderer = stage.renderer()
    frame = np.empty(renderer.frame_shape, np.uint8)
    path = stage.folder / "recording.ome.tif"
    with RecordingWriter(path, renderer.frame_shape, frame.dtype, calibration=calibration, force=stage.force) as writer:
        for k in stage.progress(range(FRAMES), "acquiring"):
            writer.append(renderer.render(k, frame), k * stage.instrument.optics.frame_period_s, k)


def _process(
    stage: _Stage, calibration: Calibration
) -> tuple[dict[Mode, TrackErrors], dict[Mode, NDArray[np.float32]], float | None]:
    """Write images of the first frames, LS and ELS+ mosaics, each along its own track, and the track of ELS+.

    Returns
    -------
    tracks, mosaics : dict
        Errors of the track, and mosaic (rows, cols), of each mode.
    um_per_px : float or None
        Of the mosaics.
    """
    tracks, mosaics = {}, {}
    with open_recording(stage.folder / "recording.ome.tif") as recording:
        for mode in (Mode.LS, Mode.RESIDUAL, Mode.ELS):
            images = section(recording[:SHOWN_FRAMES], calibration, mode)
            images.save(stage.folder / f"{mode.value}.ome.tif", force=stage.force)
        path = trajectory("spiral", speed_um_s=SPEED_UM_S)
        true_px = np.array(motion(stage.instrument, path, len(recording))["positions_mid"])
        for mode, track in ((Mode.LS, None), (Mode.ELS, stage.folder / "track.csv")):
            made = mosaic(recording, calibration, mode, progress=stage.progress)
            made.save(stage.folder / f"mosaic_{mode.value}.ome.tif", track, force=stage.force)
            tracks[mode], mosaics[mode] = track_errors(made.track, true_px), made.image
    return tracks, mosaics, made.um_per_px


def _sectioning(stage: _Stage, calibration: Calibration) -> dict[str, float]:
    raw = stage.renderer().render(0)
    in_focus = stage.renderer(in_focus_only=True).render(0)
    return {mode.value: correlation_with_focal_plane(raw, in_focus, calibration, mode) for mode in (Mode.LS, Mode.ELS)}


def _slow_frames(instrument: Instrument) -> list[NDArray[np.uint8]]:
    """Return two successive frames at 10 Hz of a slowly moving probe."""
    slow = replace(instrument, preset=replace(instrument.preset, optics=instrument.optics.at_rate(SLOW_RATE_HZ)))
    renderer = Renderer(slow, scene("fibres"), Straight(SLOW_SPEED_UM_S), seed=_SEED)
    return [renderer.render(k) for k in range(2)]
