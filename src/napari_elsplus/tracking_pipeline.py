"""Raw frames to a track and a mosaic, frame by frame as they come, or a whole recording at once."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.frontend import FrontEnd
from napari_elsplus.processing.mosaic import Insertion, Mosaic, rim_weights
from napari_elsplus.processing.paper_mosaic import PaperTracker
from napari_elsplus.processing.sectioning import Mode, Sectioner
from napari_elsplus.processing.tracking import Pose, State, Tracker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.calibration import Calibration
    from napari_elsplus.processing.frontend import Grid
    from napari_elsplus.processing.sectioning import Frames


class Method(StrEnum):
    """How the probe is tracked."""

    ELSPLUS = "elsplus"
    """Sub-pixel, rolling shutter undone, gated: this project's method."""
    PAPER = "paper"
    """Whole-pixel template matching from frame to frame, as Thrapp and Hughes describe it: the baseline."""


class _Method(Protocol):
    """What a method does with one raw frame."""

    grid: Grid
    scale: float

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> Pose: ...
    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]: ...


class _Ours:
    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._front_end = FrontEnd(calibration, frame_shape, mode)
        self.grid = self._front_end.grid
        self.scale = float(self.grid.binning)
        self._tracker = Tracker(self.grid)
        self._image = np.zeros((self.grid.side, self.grid.side), np.float32)

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> Pose:
        self._front_end.image(raw, self._image, raw_residual)
        self._tracker.slot()[:] = self._image
        return self._tracker.add()

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        return self._front_end.image(raw, self._image, raw_residual)


class _Papers:
    def __init__(self, calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> None:
        self._sectioner, self._mode = Sectioner(calibration, frame_shape), mode
        self._tracker = PaperTracker(self._sectioner.diameter_px, self._sectioner.side)
        self.grid, self.scale = self._tracker.grid, self._tracker.scale

    def track(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> Pose:
        return self._tracker.add(self.image(raw, raw_residual))

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        return self._tracker.prepare(self._sectioner.image([raw, raw_residual], 0, self._mode))


class Pipeline:
    """Turns raw frames into a track and a mosaic while they come.

    One thread adds frames; any thread may read :attr:`rows` and the mosaics.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section. Without rows per frame the rolling shutter is left uncorrected.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode or str
        Which image is tracked and laid into the mosaic.
    method : Method or str
        How the probe is tracked.
    insertion : Insertion or str
        How frames are laid over one another.

    Attributes
    ----------
    rows : list of TrackPoint
        The track so far, a row for every frame.
    mosaics : dict of int to Mosaic
        One for each segment.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        mode: Mode | str = Mode.ELS,
        *,
        method: Method | str = Method.ELSPLUS,
        insertion: Insertion | str = Insertion.DEAD_LEAF,
    ) -> None:
        make: Callable[..., _Method] = _Ours if Method(method) is Method.ELSPLUS else _Papers
        self._method = make(calibration, frame_shape, Mode(mode))
        self._um_per_px = np.nan
        if calibration.optics is not None and calibration.optics.um_per_px is not None:
            self._um_per_px = calibration.optics.um_per_px
        self._insertion = Insertion(insertion)
        self._weights = np.ones((self.grid.side,) * 2, np.float32)
        if Method(method) is Method.ELSPLUS:
            subtracts = Mode(mode) in (Mode.ELS, Mode.ELSA) and calibration.offset is not None
            away = calibration.offset.rows / self.grid.binning if subtracts and calibration.offset else 0.0
            self._weights = rim_weights(self.grid, away)
        self.rows: list[TrackPoint] = []
        self.poses: list[Pose] = []
        self.mosaics: dict[int, Mosaic] = {}

    @property
    def grid(self) -> Grid:
        """The grid of the tracked images and of the mosaics."""
        return self._method.grid

    @property
    def camera_px_per_pixel(self) -> float:
        """Camera pixels per pixel of the mosaics."""
        return self._method.scale

    def add(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> TrackPoint:
        """Track a raw frame and lay it into the mosaic of its segment.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) raw frame.
        frame : int
            Its number.
        time_s : float
            When it was taken.
        raw_residual : numpy.ndarray, optional
            The frame that the residual is taken from (ELSA); the same one by default.
        """
        pose = self._method.track(raw, raw if raw_residual is None else raw_residual)
        row = self._row(pose, frame, time_s)
        self.poses.append(pose)
        self.rows.append(row)
        if pose.state is State.TRACKED:
            self.lay(self._method.image(raw, raw if raw_residual is None else raw_residual), pose)
        return row

    def lay(self, image: NDArray[np.float32], pose: Pose) -> None:
        """Lay an image into the mosaic of its segment."""
        mosaic = self.mosaics.get(pose.segment)
        if mosaic is None:
            mosaic = self.mosaics[pose.segment] = Mosaic(self.grid, self._insertion, weights=self._weights)
        mosaic.insert(image, pose.row, pose.col, pose.velocity)

    def _row(self, pose: Pose, frame: int, time_s: float) -> TrackPoint:
        row_px, col_px = pose.row * self._method.scale, pose.col * self._method.scale
        um = self._um_per_px
        sigma = pose.sigma * self._method.scale
        return TrackPoint(
            frame, time_s, pose.segment, row_px, col_px, row_px * um, col_px * um, pose.score, sigma, pose.state.value
        )


def picture(mosaics: list[Mosaic], gap_px: int = 16) -> NDArray[np.float32]:
    """Put the mosaics of all segments below one another, the largest first.

    Parameters
    ----------
    mosaics : list of Mosaic
        At least one that was drawn on.
    gap_px : int
        Empty rows between them.

    Returns
    -------
    numpy.ndarray
        (rows, cols) float32; 0 where nothing was drawn.

    Raises
    ------
    InputError
        If nothing was drawn.
    """
    images = sorted((mosaic.read()[0] for mosaic in mosaics), key=lambda image: -image.size)
    if not images:
        raise InputError("no frame could be placed", "look at the frames: is the probe on the tissue?")
    height = sum(len(image) + gap_px for image in images) - gap_px
    canvas = np.zeros((height, max(image.shape[1] for image in images)), np.float32)
    top = 0
    for image in images:
        canvas[top : top + len(image), : image.shape[1]] = image
        top += len(image) + gap_px
    return canvas


def raw_pairs(frames: Frames, mode: Mode) -> Iterator[tuple[int, NDArray[Any], NDArray[Any]]]:
    """Go through a recording: number of the raw frame, the frame, and the one that the residual is taken from."""
    step = 2 if mode is Mode.ELSA else 1
    for first in range(0, len(frames) - step + 1, step):
        raw = frames[first]
        yield first, raw, raw if step == 1 else frames[first + 1]
