"""Track the probe through raw frames or finished images and insert them into mosaics, frame by frame or all."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.images.sectioning import Frames, Mode
from napari_elsplus.processing.mosaicing.clarity import Clarity
from napari_elsplus.processing.mosaicing.deformation.estimation import estimate_deformation
from napari_elsplus.processing.mosaicing.exposure import estimate_fading
from napari_elsplus.processing.mosaicing.line_light import LineLight, estimate_line_light
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic, rim_weights
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState, tracked_frames
from napari_elsplus.processing.tracking.registry import Method, tracking_method

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.processing.mosaicing.deformation.fields import Deformation
    from napari_elsplus.processing.mosaicing.tiles import TiledCanvas, TileStore
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.methods import TrackingMethod

    RawPair = Callable[[int], tuple[NDArray[Any], NDArray[Any]]]
    """Returns the raw frames of the confocal and of the residual view, by the index in the order of adding."""

UNLINKED: Final = "no two frames fit together: was the probe on tissue, and slow enough to overlap?"
"""Note for the user where fewer than two frames are tracked."""
INSERTION: Final = "Mosaic"
"""Name of the step in which frames are inserted once all are tracked."""
_RIM_PX: Final = 4
"""Margin by which the nominal disc is smaller than the image, pixels; chosen, for the interpolation at its rim."""


class Pipeline:
    """Tracks raw frames and inserts them into mosaics as they arrive.

    One thread adds frames; any thread may read :attr:`rows` and the mosaics.

    Parameters
    ----------
    calibration : Calibration
        Needs the bundle section. Without the line periods per frame the rolling shutter is not corrected.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode or str
        Image type to track and insert.
    method : str
        Name of the tracking method: "elsplus", "paper", or one that was registered.
    insertion : Insertion or str
        How overlapping frames are combined.
    new_store : callable, optional
        Returns the tile store of a segment, given its number; on the heap by default.
    tracking : TrackingMethod, optional
        A tracking method that was built for one stack; by default the one that is registered as `method`.

    Attributes
    ----------
    tracking : TrackingMethod
        Estimates the poses.
    rows : list of TrackPoint
        The track so far, a row for every frame.
    mosaics : dict of int to TiledCanvas
        One for each segment.
    line_light : LineLight or None
        Light of the laser line, as :meth:`finish` estimates it, but for ELSA; taken out of raw frames that are
        inserted from then on where it is uneven.
    fading : float or None
        By how much the logarithm of the light falls from frame to frame, as :meth:`finish` estimates it; made up for.
    deformation : Deformation or None
        Deformation of the tissue in each frame, as :meth:`finish` estimates it; taken out in the same way.

    Raises
    ------
    CalibrationError
        If the bundle was not located, or does not fit the frames.
    InputError
        If there is no such tracking method.
    """

    inserts_tracked_images: ClassVar = True
    """False where frames are inserted otherwise than as the images by which they are tracked."""

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        mode: Mode | str = Mode.ELS,
        *,
        method: str = Method.ELSPLUS,
        insertion: Insertion | str = Insertion.DEAD_LEAF,
        new_store: Callable[[int], TileStore] | None = None,
        tracking: TrackingMethod | None = None,
    ) -> None:
        registered, self._mode = tracking_method(method), Mode(mode)
        self.tracking = tracking or registered.factory(calibration, frame_shape, self._mode)
        self._camera_um_per_px = calibration.um_per_px
        self._insertion = Insertion(insertion)
        self._new_store = new_store
        offset = calibration.offset if self._mode in (Mode.ELS, Mode.ELSA) else None
        self._line_offset = 0.0 if offset is None else offset.rows / self.grid.binning
        self._weights = np.ones((self.grid.side,) * 2, np.float32)
        self._tapers_rim = registered.tapers_rim
        if self._tapers_rim:
            self._weights = rim_weights(self.grid, self._line_offset)
        self.rows: list[TrackPoint] = []
        self.poses: list[Pose] = []
        self.mosaics: dict[int, TiledCanvas] = {}
        self.line_light: LineLight | None = None
        self.fading: float | None = None
        self.deformation: Deformation | None = None

    @property
    def grid(self) -> Grid:
        """The grid of the tracked images and of the mosaics."""
        return self.tracking.grid

    @property
    def camera_px_per_pixel(self) -> float:
        """Camera pixels per pixel of the mosaics."""
        return self.tracking.scale

    @property
    def um_per_px(self) -> float | None:
        """Micrometres per pixel of the mosaics; None if not calibrated."""
        return None if self._camera_um_per_px is None else self._camera_um_per_px * self.camera_px_per_pixel

    def add(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> TrackPoint:
        """Track a raw frame and insert it into the mosaic of its segment.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) raw frame.
        frame : int
            Frame number.
        time_s : float
            Time of the frame, seconds.
        raw_residual : numpy.ndarray, optional
            (rows, cols) frame of which the residual view is used (ELSA); the same one by default.
        """
        raw_residual = raw if raw_residual is None else raw_residual
        pose, image = self.tracking.track(raw, raw_residual)
        self.note(pose, frame, time_s)
        if self.inserts_tracked_images:
            self.insert(lambda: image, pose)
        else:
            self.insert_raw(pose, len(self.poses) - 1, raw, raw_residual)
        return self.rows[-1]

    def track(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> TrackPoint:
        """Do what :meth:`add` does without inserting; :meth:`finish` makes the mosaics."""
        pose, _ = self.tracking.track(raw, raw if raw_residual is None else raw_residual)
        self.note(pose, frame, time_s)
        return self.rows[-1]

    def note(self, pose: Pose, frame: int, time_s: float) -> None:
        """Append the pose of a frame, by its number and its time in seconds, to the track."""
        self.poses.append(pose)
        self.rows.append(self._row(pose, frame, time_s))

    def insert_raw(self, pose: Pose, index: int, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> None:
        """Insert a raw frame at the pose of its `index` that the pipeline of another mode estimated; as :meth:`add`."""
        raw_residual = raw if raw_residual is None else raw_residual
        self.insert(lambda: self._corrected(self.tracking.image(raw, raw_residual), index), pose)

    def insert(
        self,
        image: Callable[[], NDArray[np.float32]],
        pose: Pose,
        *,
        always: bool = False,
        clarity: Clarity | None = None,
    ) -> Mosaic | None:
        """Insert an image at its pose; return its mosaic, or None if lost.

        Parameters
        ----------
        image : callable
            Makes the image (side, side), if it is due.
        pose : Pose
            Where it belongs.
        always : bool
            Insert it even if it is not due.
        clarity : Clarity, optional
            Measure by which it is weighted, one for all images of a mosaic; unweighted by default.
        """
        if pose.state is not TrackingState.TRACKED:
            return None
        mosaic = self.mosaics.get(pose.segment)
        if not isinstance(mosaic, Mosaic):
            store = self._new_store and self._new_store(pose.segment)
            mosaic = self.mosaics[pose.segment] = self.blank_mosaic(store)
        if always or mosaic.due(pose):
            made = image()
            clear = None if clarity is None else clarity.of(made)
            mosaic.insert(made, pose.row, pose.col, pose.velocity, pose.angle, clear)
        return mosaic

    def blank_mosaic(self, store: TileStore | None = None) -> Mosaic:
        """Return an empty mosaic with this pipeline's grid, insertion and weights, in a tile store."""
        return Mosaic(self.grid, self._insertion, weights=self._weights, store=store)

    def discard_segment(self, segment: int) -> None:
        """Remove the mosaic of a segment and mark its frames lost."""
        self.mosaics.pop(segment, None)
        for index, pose in enumerate(self.poses):
            if pose.segment == segment and pose.state is not TrackingState.LOST:
                lost = pose._replace(row=np.nan, col=np.nan, score=np.nan, sigma=np.nan, state=TrackingState.LOST)
                self.poses[index] = lost
                self.rows[index] = self._row(lost, self.rows[index].frame, self.rows[index].time_s)

    def relocate(self, segment: NDArray[np.int64], row: NDArray[np.float64], col: NDArray[np.float64]) -> None:
        """Set segment (n,) and position (n,) of every frame of the track, `row` and `col` in pixels of the mosaic."""
        scale, um = self._scales
        where = zip(segment.tolist(), (row * scale).tolist(), (col * scale).tolist(), strict=True)
        self.rows = [
            point._replace(segment=into, row_px=down, col_px=across, row_um=down * um, col_um=across * um)
            for point, (into, down, across) in zip(self.rows, where, strict=True)
        ]

    def discard_history(self) -> None:
        """Discard all rows of the track but the newest: for streams of unlimited length.

        Mosaics stay and tracking continues; :meth:`finish` has nothing to refine then.
        """
        del self.rows[:-1], self.poses[:-1]

    def refine(self, raw_pair: RawPair, progress: Progress = without_display) -> None:
        """Close loops, join segments and solve the pose graph; mosaics are left as they are.

        Parameters
        ----------
        raw_pair : callable
            Returns, by the index in the order in which frames were added, a raw frame and the frame of which the
            residual view is used.
        progress : Progress
            Wraps the frames' numbers where all are tracked once more; an exception raised in it ends that.
        """
        tracking = self.tracking
        self.poses = tracking.refine(self.poses, lambda index: tracking.image(*raw_pair(index)), progress=progress)
        self._rewrite_rows()

    def _rewrite_rows(self) -> None:
        """Write the refined poses into the track."""
        poses = self.tracking.at_middle_rows(self.poses)
        self.rows = [self._row(pose, row.frame, row.time_s) for pose, row in zip(poses, self.rows, strict=True)]

    def finish(self, raw_pair: RawPair, progress: Progress = without_display) -> None:
        """Refine all positions, and insert all frames into fresh mosaics, without uneven light, fading and deformation.

        Parameters are `raw_pair` and `progress`, as in :meth:`refine`; the latter wraps the frames' indices here, too.
        """
        self._draw(self.settle(raw_pair, progress), progress)

    def settle(self, raw_pair: RawPair, progress: Progress = without_display) -> Callable[[int], NDArray[np.float32]]:
        """Refine all positions (:meth:`refine`); estimate the laser line's light, fading, and the tissue's deformation.

        Parameters
        ----------
        raw_pair, progress
            As in :meth:`refine`.

        Returns
        -------
        callable
            Returns the image of a frame (side, side), freed of all three, by its index.
        """
        self.refine(raw_pair, progress)
        self.deformation = None
        self._estimate_light(raw_pair)
        self.fading = None

        def image(index: int) -> NDArray[np.float32]:
            return self._corrected(self.tracking.image(*raw_pair(index)), index)

        if self._tapers_rim:
            self.fading = estimate_fading(image, self.poses, self.grid)
            self.deformation = estimate_deformation(image, self.poses, self.grid)
        return image

    def _draw(self, image: Callable[[int], NDArray[np.float32]], progress: Progress = without_display) -> None:
        """Insert all tracked frames into fresh mosaics."""
        tracked = tracked_frames(self.poses)
        last = {self.poses[k].segment: k for k in tracked}.values()
        self.mosaics = {}
        covers = self._tapers_rim and self._insertion is Insertion.DEAD_LEAF
        clarity = Clarity(self.blank_mosaic().grid) if covers else None
        for index in progress(tracked, INSERTION):
            self.insert(partial(image, index), self._placed(self.poses[index]), always=index in last, clarity=clarity)

    def _placed(self, pose: Pose) -> Pose:
        """Return a pose in pixels of the mosaics."""
        return pose

    def complete(self) -> None:
        """Complete the mosaics after the last frame; nothing is left to do where frames are inserted as images."""

    def _estimate_light(self, raw_pair: RawPair) -> None:
        """Estimate the light of the laser line.

        Where the line has left the bundle while the residual is read, its haze is left, which does not move. Not of
        ELSA: the edges that motion leaves in it move with the probe, as uneven light does.
        """
        if self._mode is not Mode.ELSA:
            grid = replace(self.grid, line_offset=self._line_offset)
            self.line_light = estimate_line_light(lambda index: self.tracking.image(*raw_pair(index)), self.poses, grid)

    @property
    def _light(self) -> NDArray[np.float32] | None:
        """Relative light of the laser line (side, side) where it is uneven."""
        return self.line_light.relative if self.line_light is not None and self.line_light.uneven else None

    def _corrected(self, image: NDArray[np.float32], index: int) -> NDArray[np.float32]:
        """Return the image (side, side) of a frame freed of uneven light of the laser line, fading and deformation."""
        lit = self._lit(image, index)
        return lit if self.deformation is None else self.deformation.undone(index, lit)

    def _lit(self, image: NDArray[np.float32], index: int) -> NDArray[np.float32]:
        """Return the image (side, side) of a frame freed of uneven light of the laser line and of fading."""
        lit = image if self._light is None else image / self._light
        return lit if self.fading is None else lit * np.float32(np.exp(self.fading * index))

    @property
    def _scales(self) -> tuple[float, float]:
        """Camera pixels per pixel of the mosaic, and micrometres per camera pixel."""
        return self.tracking.scale, np.nan if self._camera_um_per_px is None else self._camera_um_per_px

    def _row(self, pose: Pose, frame: int, time_s: float) -> TrackPoint:
        scale, um = self._scales
        row, col = pose.row * scale, pose.col * scale
        return TrackPoint(
            frame, time_s, pose.segment, row, col, row * um, col * um, pose.score, pose.sigma * scale, pose.state.value
        )


def calibration_of_finished_images(frames: Frames, um_per_px: float | None = None) -> Calibration:
    """Return a nominal calibration for finished images of one bundle, whose disc touches the image's edges.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols).
    um_per_px : float, optional
        Scale.

    Raises
    ------
    CalibrationError
        If the images are too small to be tracked.
    """
    rows, cols = frames[0].shape
    diameter = min(rows, cols) - _RIM_PX
    if diameter < 2 * _RIM_PX:
        raise CalibrationError(f"the images have {rows} x {cols} pixels", "choose a stack of larger ones")
    centre = [(rows - 1) / 2, (cols - 1) / 2]
    bundle = {
        "confocal_centre": centre,
        "residual_centre": centre,
        "diameter_px": diameter,
        "residual_to_confocal": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    }
    return Calibration.parse({"bundle": bundle, **({} if um_per_px is None else {"optics": {"um_per_px": um_per_px}})})
