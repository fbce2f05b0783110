"""Processor time of each stage from the raw frame to the mosaic, of this software and of the paper's method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from benchmarks.harness.running import thread_clock
from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration, Registrar
from napari_elsplus.processing.tracking.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.tracking.front_end.grid import Grid
    from napari_elsplus.processing.tracking.template_tracking import TemplateTracking

    Image = NDArray[np.float32] | NDArray[np.uint8]

FRONT_END, LINK, SEARCH, MODEL, KEEPING, INSERTION = STAGES = (
    "front end", "link and its odds", "search", "model choice", "prediction, key frames", "insertion",
)  # fmt: skip
_PASSES: Final = 3


class _TimedRegistrar(Registrar):
    """Registers, and tells how long each part of it took."""

    def __init__(self, grid: Grid, clock: Callable[[], float]) -> None:
        super().__init__(grid)
        self._clock = clock
        self.begin()

    def begin(self) -> None:
        """Begin a frame."""
        self.spent = dict.fromkeys((LINK, SEARCH, MODEL), 0.0)

    def register(self, *arguments: Any, anywhere: bool = False, **options: Any) -> PairRegistration | None:
        """Time a registration and its odds, the pyramid and the search over all shifts included."""
        start = self._clock()
        found = super().register(*arguments, anywhere=anywhere, **options)
        self.spent[SEARCH if anywhere else LINK] += self._clock() - start
        return found

    def remainder(self, *arguments: Any, **options: Any) -> Any:
        """Time the question whether the probe turns."""
        start = self._clock()
        found = super().remainder(*arguments, **options)
        self.spent[MODEL] += self._clock() - start
        return found


def our_stages(calibration: Calibration, raw: NDArray[np.uint8]) -> dict[str, float]:
    """Mean time of each stage over a recording, microseconds for each frame.

    Parameters
    ----------
    calibration : Calibration
        As for :class:`~napari_elsplus.workflows.tracking.Pipeline`.
    raw : numpy.ndarray
        (T, rows, cols) raw frames.
    """
    clock = thread_clock()

    def once() -> list[dict[str, float]]:
        front_end = FrontEnd(calibration, (raw.shape[1], raw.shape[2]))
        tracker, mosaic = Tracker(Registrar(front_end.grid)), Mosaic(front_end.grid)
        registrar = tracker.registrar = _TimedRegistrar(front_end.grid, clock)
        frames = []
        for frame in raw:
            registrar.begin()
            start = clock()
            image = front_end.image(frame, tracker.slot())
            made = clock()
            pose = tracker.add()
            tracked = clock()
            if pose.state is TrackingState.TRACKED and mosaic.due(pose):
                mosaic.insert(image, pose.row, pose.col, pose.velocity, pose.angle)
            laid = clock()
            keeping = tracked - made - sum(registrar.spent.values())
            frames.append(
                {FRONT_END: made - start, **registrar.spent, KEEPING: keeping, INSERTION: laid - tracked}
            )  # fmt: skip
        return frames

    return _summary([once() for _ in range(_PASSES)])


def papers_stages(
    raw: NDArray[np.uint8],
    front_end: Callable[[NDArray[np.uint8]], Image],
    tracker: Callable[[], TemplateTracking],
    mask: NDArray[np.uint8],
    canvas_px: int,
) -> dict[str, float]:
    """Mean time of each of the paper's stages over a recording, microseconds for each frame."""
    clock = thread_clock()

    def once() -> list[dict[str, float]]:
        matching, frames = tracker(), []
        lay = PapersCanvas(mask, canvas_px)
        for frame in raw:
            start = clock()
            image = front_end(frame)
            made = clock()
            pose = matching.estimate_pose(image)
            matched = clock()
            lay(image, pose.row, pose.col)
            frames.append({FRONT_END: made - start, LINK: matched - made, INSERTION: clock() - matched})
        return frames

    return _summary([once() for _ in range(_PASSES)])


class PapersCanvas:
    """A canvas on which images are laid as dead leaves, in whole pixels.

    Parameters
    ----------
    mask : numpy.ndarray
        (side, side) uint8: what of an image is laid.
    size : int
        Rows and columns; the first image lies in the middle.
    """

    def __init__(self, mask: NDArray[np.uint8], size: int) -> None:
        self._mask = mask
        self._middle = (size - len(mask)) // 2
        self.covered = np.zeros((size, size), np.uint8)
        self.image: Image = np.zeros((0, 0), np.float32)

    def __call__(self, image: Image, row: float, col: float) -> None:
        """Lay an image down."""
        if not self.image.size:
            self.image = np.zeros(self.covered.shape, image.dtype)
        top, left = int(row) + self._middle, int(col) + self._middle
        here = np.s_[top : top + len(image), left : left + len(image)]
        cv2.copyTo(image, self._mask, self.image[here])
        cv2.copyTo(self._mask, self._mask, self.covered[here])


def _summary(passes: list[list[dict[str, float]]]) -> dict[str, float]:
    """Median of each stage of each frame over the passes, mean over the frames."""
    names = passes[0][0]
    seconds = np.array([[[frame[name] for name in names] for frame in frames] for frames in passes])
    return dict(zip(names, (1e6 * np.median(seconds, axis=0).mean(axis=0)).tolist(), strict=True))
