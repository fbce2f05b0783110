"""Mosaics in pixels of the camera, of frames that are tracked on a coarser grid.

A large bundle is tracked at about a pixel per core, which is as exact, and quicker. Its mosaics would lose detail
there: they are drawn of images that are not binned.
"""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic, rim_weights
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.mosaicing.deformation.fields import Deformation
    from napari_elsplus.processing.mosaicing.line_light import LineLight
    from napari_elsplus.processing.mosaicing.tiles import TileStore
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.workflows.tracking import RawPair

    Image = NDArray[np.float32]


class FinePipeline(Pipeline):
    """Tracks frames, and inserts finer images of them than those that are tracked.

    Parameters
    ----------
    calibration, frame_shape, mode, method, insertion
        As of :class:`Pipeline`.

    Raises
    ------
    CalibrationError, InputError
        As :class:`Pipeline`.
    """

    inserts_tracked_images = False

    def __init__(
        self,
        calibration: Calibration,
        frame_shape: tuple[int, int],
        mode: Mode | str = Mode.ELS,
        *,
        method: str = Method.ELSPLUS,
        insertion: Insertion | str = Insertion.DEAD_LEAF,
    ) -> None:
        super().__init__(calibration, frame_shape, mode, method=method, insertion=insertion)
        self._new_tracked = partial(
            Pipeline, calibration, frame_shape, mode, method=method, insertion=insertion, tracking=self.tracking
        )
        self._front_end = FrontEnd(calibration, frame_shape, self._mode, inf)
        self._drawn = self._front_end.grid
        self._finer = self.grid.binning / self._drawn.binning
        self._image = np.empty((self._drawn.side,) * 2, np.float32)
        self._drawn_weights = rim_weights(self._drawn, self._finer * self._line_offset)
        self._enlarged: tuple[LineLight | None, Image | None] = None, None
        self._moved: tuple[Deformation | None, Deformation | None] = None, None

    @property
    def camera_px_per_pixel(self) -> float:
        """Camera pixels per pixel of the mosaics."""
        return float(self._drawn.binning)

    def insert_raw(self, pose: Pose, index: int, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> None:
        """Insert a raw frame at the pose of its `index`; others as of :meth:`Pipeline.add`."""
        self.insert(lambda: self._corrected(self._fine_image(raw, raw_residual), index), self._placed(pose))

    def blank_mosaic(self, store: TileStore | None = None) -> Mosaic:
        """Return an empty mosaic with this pipeline's insertion, on the grid of its images, in a tile store."""
        return Mosaic(self._drawn, self._insertion, weights=self._drawn_weights, store=store)

    def finish(self, raw_pair: RawPair, progress: Progress = without_display) -> None:
        """Do what :meth:`Pipeline.finish` does with the images that are tracked, and insert the finer ones."""
        tracked = self._new_tracked()
        tracked.poses, tracked.rows = self.poses, self.rows
        tracked.settle(raw_pair, progress)
        self.poses, self.rows = tracked.poses, tracked.rows
        self.line_light, self.fading = tracked.line_light, tracked.fading
        self.deformation = tracked.deformation
        self._draw(lambda index: self._corrected(self._fine_image(*raw_pair(index)), index), progress)

    def _fine_image(self, raw: NDArray[Any], raw_residual: NDArray[Any] | None = None) -> Image:
        """Return the image (side, side) of a raw frame on the grid of the mosaics, valid until the next call."""
        return self._front_end.image(raw, self._image, raw if raw_residual is None else raw_residual)

    def _placed(self, pose: Pose) -> Pose:
        """Return a pose in pixels of the mosaics."""
        row, col, down, across = (self._finer * each for each in (pose.row, pose.col, *pose.velocity))
        return pose._replace(row=row, col=col, velocity=Velocity(down, across))

    @property
    def _light(self) -> Image | None:
        """Relative light of the laser line on the grid of the mosaics, where it is uneven."""
        if self.line_light is not self._enlarged[0]:
            light = super()._light
            self._enlarged = self.line_light, None if light is None else self._at_drawn_pixels(light)
        return self._enlarged[1]

    def _corrected(self, image: Image, index: int) -> Image:
        lit = self._lit(image, index)
        if self.deformation is not self._moved[0]:
            self._moved = self.deformation, None if self.deformation is None else self.deformation.on(self._drawn)
        return lit if self._moved[1] is None else self._moved[1].undone(index, lit)

    def _at_drawn_pixels(self, image: Image) -> Image:
        """Return an image (side, side) of the tracking grid at the pixels of the mosaics, bilinear."""
        (row, col), (own_row, own_col), step = self.grid.centre, self._drawn.centre, 1 / self._finer
        to_grid = np.array([[step, 0, col - step * own_col], [0, step, row - step * own_row]])
        size, how = (self._drawn.side,) * 2, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        enlarged = cv2.warpAffine(image, to_grid, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(enlarged, np.float32)
