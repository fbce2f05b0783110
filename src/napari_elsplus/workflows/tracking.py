"""Raw frames to a track and a mosaic, frame by frame as they come, or a whole recording at once."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic, rim_weights
from napari_elsplus.processing.tracking.methods import RegistrationTracking, TemplateTracking, TrackingMethod
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.mosaicing.tiles import TileStore
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration


UNLINKED: Final = "no two frames fit together: was the probe on tissue, and slow enough to overlap?"
"""What to say of a track of which less than two frames are tracked."""


class Method(StrEnum):
    """How the probe is tracked."""

    ELSPLUS = "elsplus"
    """Sub-pixel, rolling shutter undone, gated: this project's method."""
    PAPER = "paper"
    """Whole-pixel template matching from frame to frame, as Thrapp and Hughes describe it: the baseline."""


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
    new_store : callable, optional
        Makes the store of a segment's tiles; on the heap by default.

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
        new_store: Callable[[int], TileStore] | None = None,
    ) -> None:
        ours = Method(method) is Method.ELSPLUS
        make: Callable[..., TrackingMethod] = RegistrationTracking if ours else TemplateTracking
        self._tracking = make(calibration, frame_shape, Mode(mode))
        self._camera_um_per_px = calibration.um_per_px
        self._insertion = Insertion(insertion)
        self._new_store = new_store
        self._weights = np.ones((self.grid.side,) * 2, np.float32)
        if ours:
            subtracts = Mode(mode) in (Mode.ELS, Mode.ELSA) and calibration.offset is not None
            away = calibration.offset.rows / self.grid.binning if subtracts and calibration.offset else 0.0
            self._weights = rim_weights(self.grid, away)
        self.rows: list[TrackPoint] = []
        self.poses: list[Pose] = []
        self.mosaics: dict[int, Mosaic] = {}

    @property
    def grid(self) -> Grid:
        """The grid of the tracked images and of the mosaics."""
        return self._tracking.grid

    @property
    def camera_px_per_pixel(self) -> float:
        """Camera pixels per pixel of the mosaics."""
        return self._tracking.scale

    @property
    def um_per_px(self) -> float | None:
        """Micrometres for a pixel of the mosaics, where the calibration knows the scale."""
        return None if self._camera_um_per_px is None else self._camera_um_per_px * self._tracking.scale

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
        pose, image = self.find(raw, raw_residual)
        self.keep(image, pose, frame, time_s)
        return self.rows[-1]

    def find(self, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> tuple[Pose, NDArray[np.float32]]:
        """Do the first parts of :meth:`add`: find where a frame lies; its image, too, is good until the next call."""
        return self._tracking.track(raw, raw if raw_residual is None else raw_residual)

    def track(
        self, raw: NDArray[Any], frame: int, time_s: float = np.nan, raw_residual: NDArray[Any] | None = None
    ) -> TrackPoint:
        """Do what :meth:`add` does, but leave the mosaics to :meth:`finish`."""
        pose, _ = self._tracking.track(raw, raw if raw_residual is None else raw_residual)
        self._note(pose, frame, time_s)
        return self.rows[-1]

    def look(self, raw: NDArray[Any], out: NDArray[np.float32], raw_residual: NDArray[Any] | None = None) -> None:
        """Do the first part of :meth:`add`: make the image (side, side) by which a raw frame is tracked."""
        self._tracking.look(raw, raw if raw_residual is None else raw_residual, out)

    def place(self, image: NDArray[np.float32]) -> Pose:
        """Do the second: find where the frame of such an image lies, next to those that were placed before."""
        return self._tracking.place(image)

    def keep(self, image: NDArray[np.float32], pose: Pose, frame: int, time_s: float, *, lay: bool = True) -> None:
        """Do the last: put a frame into the track, and its image into the mosaic."""
        self._note(pose, frame, time_s)
        if lay:
            self.put(image, pose)

    def lay(self, pose: Pose, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> None:
        """Lay a raw frame down where another pipeline, of another mode, has found it to be."""
        self.put(self.image(raw, raw_residual), pose)

    def image(self, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> NDArray[np.float32]:
        """Return a frame's image (side, side), which is good until the next call."""
        return self._tracking.image(raw, raw if raw_residual is None else raw_residual)

    def put(self, image: NDArray[np.float32], pose: Pose) -> Mosaic | None:
        """Lay an image down where its frame was tracked; return the mosaic that it lies in then."""
        if pose.state is not TrackingState.TRACKED:
            return None
        mosaic = self.mosaics.get(pose.segment)
        if mosaic is None:
            store = None if self._new_store is None else self._new_store(pose.segment)
            mosaic = self.mosaics[pose.segment] = self.blank_mosaic(store)
        mosaic.insert(image, pose.row, pose.col, pose.velocity, pose.angle, pose.scale)
        return mosaic

    def blank_mosaic(self, store: TileStore | None = None) -> Mosaic:
        """Make a mosaic like those that frames are laid into."""
        return Mosaic(self.grid, self._insertion, weights=self._weights, store=store)

    @property
    def newest_link(self) -> tuple[int, int, PairRegistration] | None:
        """The link by which a frame was tracked last: the earlier and the later one, by their order, and itself."""
        return self._tracking.newest_link

    @property
    def rung(self) -> MotionModel:
        """What is modelled beside translations."""
        return self._tracking.rung

    def forget(self, segment: int) -> None:
        """Take a segment's mosaic away, and call its frames lost."""
        self.mosaics.pop(segment, None)
        for index, pose in enumerate(self.poses):
            if pose.segment == segment and pose.state is not TrackingState.LOST:
                lost = pose._replace(row=np.nan, col=np.nan, score=np.nan, sigma=np.nan, state=TrackingState.LOST)
                self.poses[index] = lost
                self.rows[index] = self._row(lost, self.rows[index].frame, self.rows[index].time_s)

    def relocate(self, segment: NDArray[np.int64], row: NDArray[np.float64], col: NDArray[np.float64]) -> None:
        """Say of every row of the track where its frame belongs: (n,) segments, and pixels of the mosaic."""
        scale, um = self._scales
        where = zip(segment.tolist(), (row * scale).tolist(), (col * scale).tolist(), strict=True)
        self.rows = [
            replace(point, segment=into, row_px=down, col_px=across, row_um=down * um, col_um=across * um)
            for point, (into, down, across) in zip(self.rows, where, strict=True)
        ]

    def forget_the_past(self) -> None:
        """Keep of track and links only the newest row: for streams without end whose track is kept elsewhere.

        What was laid stays, and tracking goes on; :meth:`finish` has nothing to refine then.
        """
        del self.rows[:-1], self.poses[:-1]
        self._tracking.forget_links()

    def refine(self, raw_pair: Callable[[int], tuple[NDArray[Any], NDArray[Any]]]) -> None:
        """Close loops, join segments and solve for all positions at once; mosaics are left as they are.

        Parameters
        ----------
        raw_pair : callable
            Returns by its index, in the order in which frames were added, a raw frame and the one that its residual is
            taken from.
        """
        self.poses = self._tracking.refine(self.poses, lambda index: self._tracking.image(*raw_pair(index)))
        self.rows = [self._row(pose, row.frame, row.time_s) for pose, row in zip(self.poses, self.rows, strict=True)]

    def finish(
        self,
        raw_pair: Callable[[int], tuple[NDArray[Any], NDArray[Any]]],
        progress: Callable[[Sequence[int]], Iterable[int]] = iter,
    ) -> None:
        """Refine all positions (:meth:`refine`) and insert all frames into fresh mosaics at them.

        Parameters
        ----------
        raw_pair : callable
            As in :meth:`refine`.
        progress : callable
            Wraps the indices of the frames that are inserted; a progress bar, for instance.
        """
        self.refine(raw_pair)
        self.mosaics = {}
        for index in progress([k for k, pose in enumerate(self.poses) if pose.state is TrackingState.TRACKED]):
            self.put(self.image(*raw_pair(index)), self.poses[index])

    def _note(self, pose: Pose, frame: int, time_s: float) -> None:
        self.poses.append(pose)
        self.rows.append(self._row(pose, frame, time_s))

    @property
    def _scales(self) -> tuple[float, float]:
        """Camera pixels per pixel of the mosaic, and micrometres per camera pixel."""
        return self._tracking.scale, np.nan if self._camera_um_per_px is None else self._camera_um_per_px

    def _row(self, pose: Pose, frame: int, time_s: float) -> TrackPoint:
        scale, um = self._scales
        row, col = pose.row * scale, pose.col * scale
        return TrackPoint(
            frame, time_s, pose.segment, row, col, row * um, col * um, pose.score, pose.sigma * scale, pose.state.value
        )
