"""The calibration's steps: frames in, what was measured out.

(i) slit offset, (ii) galvo map, (iii) bundle pair, then background and flat field: the paper's System Calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.uncertainty import newey_west_sigma
from napari_elsplus.processing.calibration.bundle import location as bundles
from napari_elsplus.processing.calibration.bundle.view_alignment import Alignment, align_views
from napari_elsplus.processing.calibration.galvo import GalvoMap, fit_galvo, lines_in_sweep
from napari_elsplus.processing.calibration.line import Line, locate_line
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames

    Image = NDArray[np.float32]

MOST_SATURATED: Final = 0.01
MOST_OF_BUNDLE: Final = 0.05
"""Of the bundle's image; a patch that is saturated has no say in the gain, and the cores around it are enough."""
WHITE: Final = 0.98
"""Of the largest grey level: a pixel that is saturated in most frames but, by its noise, not in all."""
MOST_DRIFT: Final = 0.05
_NEIGHBOURS: Final = 4
"""Runs of columns that are taken together: those of the two views do not hold quite the same cores."""


@dataclass(frozen=True, slots=True)
class SlitOffset:
    """Row of a standing line in the right view minus its row in the left one.

    Parameters
    ----------
    rows, uncertainty_rows : float
        The offset and its standard deviation; what both views share, the cores, does not add to it.
    left, right : Line
        The line in each view; columns count in the view, which begins at ``split`` for the right one.
    split : int
        Column of the frame between the views.
    """

    rows: float
    uncertainty_rows: float
    left: Line
    right: Line
    split: int


@dataclass(frozen=True, slots=True)
class BundlePair:
    """Both bundle images, the right one laid onto the left, and the share of the frame that was saturated."""

    left: bundles.Disc
    right: bundles.Disc
    alignment: Alignment
    saturated: float = 0.0

    @property
    def shows_flat_field(self) -> bool:
        """Whether the frames that told the pair may serve as a flat field."""
        return self.saturated <= MOST_SATURATED

    @property
    def split(self) -> int:
        """Column of the frame between the views."""
        return round((self.left.centre[1] + self.right.centre[1]) / 2)


@dataclass(frozen=True, slots=True)
class Background:
    """Mean frame of the dark tube.

    Parameters
    ----------
    mean : numpy.ndarray
        (rows, cols) float32.
    frames : int
        How many were averaged; the paper averages 50.
    drift : float
        Relative change of the mean level from the first half of the frames to the second.
    """

    mean: Image
    frames: int
    drift: float


def measure_background(frames: Frames) -> Background:
    """Average the frames of a dark tube with the laser on.

    Raises
    ------
    MeasurementError
        If a good part is saturated, or the level drifts.
    """
    mean, drift = mean_frame(frames), _drift(frames, "background")
    _must_not_be_saturated(frames[0], "background")
    return Background(mean, len(frames), drift)


def _drift(frames: Frames, name: str) -> float:
    """Relative change of the mean level from the first half of the frames to the second; refused if it is large."""
    half = len(frames) // 2
    levels = [float(np.mean(np.asarray(frames[k][::4, ::4], np.float64))) for k in range(len(frames))]
    first, second = (float(np.mean(part)) for part in (levels[: max(half, 1)], levels[half:]))
    drift = (second - first) / max(abs(first), 1.0)
    if abs(drift) > MOST_DRIFT:
        raise MeasurementError(
            f"the {name} drifts by {100 * drift:.1f} % while it is taken", "let laser and camera warm up"
        )
    return drift


def measure_offset(
    frames: Frames, background: Image | None = None, pair: BundlePair | None = None, near: SlitOffset | None = None
) -> SlitOffset:
    """Step (i): where the standing line is in both views, and the difference.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of the line standing near the middle of the bundle; they are averaged.
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : BundlePair, optional
        The bundle images; without them each view's middle is the middle of the lit part of the line.
    near : SlitOffset, optional
        What was found a moment ago, which saves the search.

    Raises
    ------
    MeasurementError
        If there is no line in one of the views.
    """
    alone = near is not None and len(frames) == 1
    frame: NDArray[Any] = np.asarray(frames[0]) if alone else mean_frame(frames)
    _must_not_be_saturated(frames[0], "image of the line")
    if near is not None:
        split = near.split
    elif pair is not None:
        split = pair.split
    else:
        split = _between_views(np.asarray(frame, np.float32) if background is None else frame - background)
    lines = []
    for name, part in (("left", slice(0, split)), ("right", slice(split, None))):
        dark = None if background is None else background[:, part]
        before = None if near is None else near.left if name == "left" else near.right
        try:
            lines.append(locate_line(frame[:, part], dark, before))
        except MeasurementError as error:
            raise MeasurementError(f"{name} view: {error.problem}", error.remedy) from None
    left, right = lines
    columns = (left.column, right.column)
    if pair is not None:
        columns = (pair.left.centre[1], pair.right.centre[1] - split)
    return _offset_at(columns, left, right, split)


def offset_at(offset: SlitOffset, pair: BundlePair) -> SlitOffset:
    """Return an offset that was measured before the bundle pair was known, taken at the bundle's centres."""
    columns = pair.left.centre[1], pair.right.centre[1] - offset.split
    return _offset_at(columns, offset.left, offset.right, offset.split)


def _offset_at(columns: tuple[float, float], left: Line, right: Line, split: int) -> SlitOffset:
    influence = right.influence_at(columns[1]) - left.influence_at(columns[0])
    rows = right.row_at(columns[1]) - left.row_at(columns[0])
    return SlitOffset(rows, newey_west_sigma(influence, _NEIGHBOURS), left, right, split)


def map_galvo(
    frames: Frames,
    volts: NDArray[np.floating],
    background: Image | None = None,
    pair: BundlePair | None = None,
    watch: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> GalvoMap:
    """Step (ii): which voltage puts the line onto which row of the left view.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        A raw frame (rows, cols) per voltage.
    volts : numpy.ndarray
        Voltages, shape (frames,).
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : BundlePair, optional
        The bundle images; without them rows are taken at the middle of the longest lines.
    watch : callable, optional
        Wraps the frames' numbers, to show how far it is.

    Raises
    ------
    InputError
        If there are not as many voltages as frames.
    MeasurementError
        If too few frames show a line.
    """
    if len(volts) != len(frames):
        raise InputError(f"{len(volts)} voltages for {len(frames)} frames of the sweep", "give one voltage per frame")
    split = pair.split if pair is not None else _between_views(_brightest(frames, background))

    def views() -> Iterator[NDArray[np.generic]]:
        for number in watch(range(len(frames))):
            yield np.asarray(frames[number])[:, :split]

    lines = lines_in_sweep(views(), None if background is None else background[:, :split])
    return fit_galvo(volts, lines, None if pair is None else pair.left.centre[1])


def locate_pair(frames: Frames) -> BundlePair:
    """Step (iii): both bundle images, their alignment and gain, from frames lit from the far end.

    Raises
    ------
    MeasurementError
        If there are not two bundle images that show the same cores.
    """
    frame = mean_frame(frames)
    share = _must_not_be_saturated(frames[0], "image of the bundle", MOST_OF_BUNDLE)
    left, right = bundles.locate_pair(frame)
    return BundlePair(left, right, align_views(frame, left, right, frame >= WHITE * _white(frames[0])), share)


def measure_flat(frames: Frames, calibration: Calibration) -> Image:
    """Brightness of every pixel of the confocal view under uniform light, mean 1 inside the disc.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames of a uniform scene, or of the bundle lit from its far end.
    calibration : Calibration
        With its bundle section.

    Returns
    -------
    numpy.ndarray
        (n, n) float32, on the grid of :class:`napari_elsplus.processing.images.sectioning.Sectioner`.

    Raises
    ------
    MeasurementError
        If the disc is dark, a good part is saturated, or the level drifts.
    """
    calibration.require("bundle")
    assert calibration.bundle is not None
    frame = mean_frame(frames)
    _must_not_be_saturated(frames[0], "flat field")
    _drift(frames, "flat field")
    sectioner = Sectioner(calibration, frame.shape)
    image = sectioner.ls(frame)
    inside = disc(len(image), calibration.bundle.diameter_px)
    level = float(image[inside].mean())
    if not level > 0.5:
        raise MeasurementError(f"the flat field is dark (mean {level:.2g} grey levels)", "light the scene evenly")
    return np.where(inside, np.maximum(image, 0) / level, 1).astype(np.float32)


def mean_frame(frames: Frames) -> Image:
    """Mean of raw frames, float32 (rows, cols).

    Raises
    ------
    InputError
        If there is none, or one holds NaN or infinity.
    """
    if not len(frames):
        raise InputError("there are 0 frames", "give at least one")
    total = np.zeros(frames[0].shape, np.float64)
    for number in range(len(frames)):
        total += np.asarray(frames[number], np.float64)
    if not np.isfinite(total).all():
        raise InputError("a frame holds NaN or infinity", "record it again")
    return (total / len(frames)).astype(np.float32)


def _must_not_be_saturated(frame: NDArray[Any], name: str, most: float = MOST_SATURATED) -> float:
    """Share of the frame that is saturated."""
    white = _white(frame)
    share = float(np.mean(frame == white))
    if share > most:
        raise MeasurementError(
            f"{100 * share:.0f} % of the {name} is saturated (grey level {white:g})", "lower the light or the gain"
        )
    return share


def _white(frame: NDArray[Any]) -> float:
    """Largest grey level of a camera that counts in whole ones."""
    return float(np.iinfo(frame.dtype).max) if np.issubdtype(frame.dtype, np.integer) else float("inf")


def _brightest(frames: Frames, background: Image | None) -> Image:
    """Brightest value of each pixel over a sweep: the line paints the bundle."""
    painted = np.asarray(frames[0], np.float32)
    for number in range(1, len(frames), max(1, len(frames) // 100)):
        np.maximum(painted, frames[number], out=painted, casting="unsafe")
    return painted if background is None else painted - background


def _between_views(frame: Image) -> int:
    """Column between the two views: the middle of the darkest gap near the middle of the frame."""
    light = frame - np.median(frame, axis=0)
    brightness = np.sort(light, axis=0)[-max(3, len(light) // 50) :].mean(axis=0)
    width = max(3, len(brightness) // 60)
    brightness = np.convolve(brightness, np.full(width, 1 / width), mode="same")
    start, stop = int(0.3 * len(brightness)), int(0.7 * len(brightness))
    middle = brightness[start:stop]
    low, high = float(middle.min()), float(np.percentile(brightness, 90))
    dark = np.flatnonzero(middle <= low + 0.15 * max(high - low, 0))
    runs = np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1)
    return start + round(float(max(runs, key=len).mean()))
