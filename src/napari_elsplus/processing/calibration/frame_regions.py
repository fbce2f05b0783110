"""Raw frames before the bundle is located: mean, saturation, lit part, the column between the views, unlit pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.saturation import largest_level, saturation_level
from napari_elsplus.processing.calibration.bundle.location import middle_of_longest_run
from napari_elsplus.processing.calibration.bundle.pair import MAX_SATURATED
from napari_elsplus.processing.images.row_reference import dark_columns, dark_pixels

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.calibration.bundle.location import Circle
    from napari_elsplus.processing.images.sectioning import Frames

    Image = NDArray[np.float32]

EXACT_FLOAT32: Final = 2**24
"""Up to which float32 holds every integer; derived from its 24 bits of mantissa."""
LINE_MARGIN_PX: Final = 40
"""Beside the lit columns of a line, in pixels; chosen: its ends fade out towards the rim."""
SAMPLED_FRAMES: Final = 8
"""In which saturation is searched; chosen: light that changes in a recording shows in one of them."""


def mean_frame(frames: Frames) -> Image:
    """Return the mean of raw frames, float32 (rows, cols).

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).

    Raises
    ------
    InputError
        If there are no frames, or one contains NaN or infinity.
    """
    if not len(frames):
        raise InputError("there are 0 frames", "give at least one")
    exact = largest_level(frames[0]) * len(frames) < EXACT_FLOAT32
    total = np.zeros(frames[0].shape, np.float32 if exact else np.float64)
    for number in range(len(frames)):
        frame = np.asarray(frames[number])
        # OpenCV adds integers to floats without a converted copy of the frame, many times as fast as numpy.
        cv2.accumulate(frame if frame.dtype in (np.uint8, np.uint16) else frame.astype(total.dtype), total)
    total /= len(frames)
    return _finite(total.astype(np.float32, copy=False), frames[0].dtype)


def _finite(frame: Image, dtype: np.dtype[Any]) -> Image:
    """Return the mean of frames of a dtype; integers are finite."""
    if not np.issubdtype(dtype, np.integer) and not np.isfinite(frame.sum(dtype=np.float64)):
        raise InputError("a frame holds NaN or infinity", "record it again")
    return frame


def brightest(frames: Frames) -> NDArray[Any]:
    """Return the brightest value of each pixel over a sweep: an image of the bundle in the frames' dtype.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols); about 100 of them are used.
    """
    painted = np.array(frames[0])
    for number in range(1, len(frames), max(1, len(frames) // 100)):
        np.maximum(painted, frames[number], out=painted)  # in the camera's numbers, which compare fastest
    return painted


def column_between_views(frame: Image) -> int:
    """Return the column between the two views: the middle of the darkest gap near the middle of the frame."""
    ordered = np.sort(cv2.transpose(frame), axis=1)
    medians = ordered[:, [(len(frame) - 1) // 2, len(frame) // 2]].mean(axis=1)
    brightness = ordered[:, -max(3, len(frame) // 50) :].mean(axis=1) - medians
    width = max(3, len(brightness) // 60)
    brightness = np.convolve(brightness, np.full(width, 1 / width), mode="same")
    start, stop = int(0.3 * len(brightness)), int(0.7 * len(brightness))
    middle = brightness[start:stop]
    low, high = float(middle.min()), float(np.percentile(brightness, 90))
    return start + middle_of_longest_run(np.flatnonzero(middle <= low + 0.15 * max(high - low, 0)))


def unlit_pixels(
    frame: NDArray[Any],
    background: Image | None = None,
    discs: Sequence[Circle] = (),
    lines: Sequence[tuple[int, int]] = (),
) -> NDArray[np.uint8]:
    """Return 1 in the pixels of a frame that no light of the bundle reaches, 0 elsewhere, (rows, cols) uint8.

    Parameters
    ----------
    frame : numpy.ndarray
        (rows, cols); its own light decides where neither discs nor lines are known.
    background : numpy.ndarray, optional
        Mean frame of the dark tube, (rows, cols).
    discs : sequence of tuple
        Centre (row, col) and diameter in pixels of each view, if they were located.
    lines : sequence of tuple
        First lit column of the line, and the one after the last, in each view, if they were located.
    """
    if discs:
        return dark_pixels((frame.shape[0], frame.shape[1]), discs)
    if lines:
        dark = np.ones(frame.shape[1], np.uint8)
        for first, stop in lines:
            dark[max(first - LINE_MARGIN_PX, 0) : stop + LINE_MARGIN_PX] = 0
        return np.broadcast_to(dark, frame.shape)
    image = np.asarray(frame, np.float32)
    return dark_columns(image if background is None else image - background)


def sampled(frames: Frames) -> Iterator[NDArray[Any]]:
    """Yield the first, the last and some frames between, in which saturation is searched.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).

    Examples
    --------
    >>> [int(frame[0, 0]) for frame in sampled(np.arange(50).reshape(50, 1, 1))]
    [0, 7, 14, 21, 28, 35, 42, 49]
    """
    count = min(len(frames), SAMPLED_FRAMES)
    for number in range(count):
        yield np.asarray(frames[number * (len(frames) - 1) // max(count - 1, 1)])


def saturated_share(frames: Frames, name: str, limit: float = MAX_SATURATED) -> float:
    """Return the saturated share of the frame that is saturated most, of some frames.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols), any real dtype.
    name : str
        Of what they show, for the error.
    limit : float
        Largest share.

    Raises
    ------
    MeasurementError
        If it exceeds the limit.
    """
    whites = ((frame, saturation_level(frame)) for frame in sampled(frames))
    share, white = max((np.count_nonzero(frame == white) / frame.size, white) for frame, white in whites)
    if share > limit:
        raise MeasurementError(
            f"{100 * share:.0f} % of the {name} is saturated (grey level {white:g})", "lower the light or the gain"
        )
    return share
