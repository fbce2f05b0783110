"""Agreement of a calibration with the frames that it is applied to, in where the bundle lies and in grey levels.

A calibration of another geometry has the right frame size as often as not. Frames of a specimen show the bundle less
clearly than the far end's light does: they speak against a calibration only if a view is located elsewhere, with
most of its edge seen, and the edge is not seen where the calibration has it.

Of another bit depth is a background whose level beside the views, where no light falls, is a multiple of that of the
frames, or a fraction of it. Saturated frames are not what any calibration could make up for, and are noted first.

The residual's slit lies beside the line: in all light, of whatever depth, its view is the darker one. Where it is not,
the views are exchanged, or the line stands on the wrong slit, and ELS+ is negative. Of thin tissue in focus it is dark.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.errors import CalibrationError, MeasurementError
from napari_elsplus.processing.analysis.saturation import saturated_part, saturation_note
from napari_elsplus.processing.calibration.bundle.location import MIN_CERTAIN_EDGE, Disc, locate_pair
from napari_elsplus.processing.calibration.bundle.rim import edge_share
from napari_elsplus.processing.images.row_reference import dark_pixels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames

    Image = NDArray[np.float32]

AVERAGED_FRAMES: Final = 8
"""Frames of a recording that are averaged; chosen: a moving specimen is blurred, and few are read."""
MAX_LOCATED_ROWS: Final = 320
"""Rows of the reduced frame in which the bundle is located; chosen: a hundredth of the diameter is then three rows."""
TOLERATED: Final = 0.03
"""Displacement of a view, or change of its radius, over the diameter, up to which a calibration is not doubted; chosen:
twice what specimens that are dark at the rim pretend."""
MAX_EDGE_RATIO: Final = 0.7
"""Edge seen where the calibration has the bundle over that seen where it is located, from which on a calibration is not
doubted; chosen."""
MIN_EDGE_SHARE: Final = 0.65
"""Share of the circumference of both calibrated circles on which the edge is seen, with which nothing is located;
measured: 0.70 to 0.82 in the residual view of the presets, 0.5 in one displaced by 0.05 of its diameter to where it is
lit least."""
MAX_LEVEL_RATIO: Final = 8**0.5
"""Level beside the views of frames over that of the background, or the reverse, from which they are of another bit
depth or black level; derived: bit depths of cameras differ by two bits or more, a factor of 4, not by one, a factor of
2."""
MIN_LEVEL_DIFFERENCE: Final = 2.0
"""Grey levels by which they differ at least; chosen: where black is nearly 0, a ratio is one of noise."""
MIN_LIGHT_RATIO: Final = 0.75
"""Light of the views in frames over that in the background, below which the background is not one of these frames;
chosen: a laser's power, and the light of the bundle itself, change by less."""
MIN_COMPARED_PIXELS: Final = 100
"""Beside the views, below which their level is not known; chosen."""
MAX_RESIDUAL_RATIO: Final = 1.1
"""Light of the residual view over that of the confocal one, both of the same gain, beyond which it is noted; chosen:
gains of calibrations are exact to a percent, and of a lamp at the far end both views show the same."""
LIT_PERCENTILE: Final = 25
"""Of the pixels of the views, that exceed the level beside them; chosen: else no light tells where black pixels are."""
COMPARED_STEP_PX: Final = 4
"""Between the pixels that are compared, in rows and columns; chosen: ten thousand of a frame do."""
_COMPARED: Final = np.s_[::COMPARED_STEP_PX, ::COMPARED_STEP_PX]


def require_agreement(frames: Frames, calibration: Calibration) -> None:
    """Refuse a calibration whose bundle lies elsewhere than that of some frames.

    Parameters
    ----------
    frames : Frames
        Raw frames (rows, cols) that the calibration is applied to; a few of them are averaged.
    calibration : Calibration
        With the bundle section.

    Raises
    ------
    CalibrationError
        If a view is clearly seen elsewhere, or in another size.
    """
    bundle = calibration.bundle
    if bundle is None or not len(frames):
        return
    mean, factor = _reduced_mean(frames)
    calibrated = [(view, *disc) for view, disc in zip(("confocal", "residual"), bundle.discs, strict=True)]
    places = [((np.array(centre) + 0.5) / factor - 0.5, size_px / factor) for _, centre, size_px in calibrated]
    if all(edge_share(mean, *place) >= MIN_EDGE_SHARE for place in places):
        return
    try:
        located = locate_pair(mean)
    except MeasurementError:
        return
    # The residual view is dark where the line has left the bundle: above for a residual view that stands higher.
    sides = 0.0, located[0].centre[0] - located[1].centre[0]
    for disc, (view, centre, diameter_px), place, side in zip(located, calibrated, places, sides, strict=True):
        if _differs(disc, *place, mean, side):
            row, col = ((at + 0.5) * factor - 0.5 for at in disc.centre)
            raise CalibrationError(
                f"the frames show a {view} view of {disc.diameter_px * factor:.0f} px about row {row:.0f}, column "
                f"{col:.0f}, the calibration has it of {diameter_px:.0f} px about row {centre[0]:.0f}, column "
                f"{centre[1]:.0f}",
                "use the calibration that was made with this rig, tilt mirror and camera region",
            )


def grey_level_note(frames: Frames, calibration: Calibration) -> str:
    """Return a message to the user where frames are saturated, or of another bit depth than the background; else "".

    Parameters
    ----------
    frames : Frames
        Raw frames (rows, cols) that the calibration is applied to; a few of them are averaged.
    calibration : Calibration
        Nothing but its background depends on the bit depth.

    Raises
    ------
    CalibrationError
        If the background exceeds what the frames can hold, or what they show: images would be negative.
    """
    if not len(frames):
        return ""
    some = [np.array(frames[number][_COMPARED]) for number in averaged_frames(len(frames))]
    saturated = saturation_note(float(np.mean([saturated_part(pixels) for pixels in some])))
    same_shape = calibration.background is not None and calibration.background.shape == frames[0].shape
    seen = np.mean([pixels.astype(np.float32) for pixels in some], axis=0)
    bit_depth = _bit_depth_note(seen, some[0].dtype, calibration) if same_shape else ""
    notes = saturated, bit_depth, _brighter_view_note(seen, calibration)
    return "; ".join(filter(None, notes))


def _brighter_view_note(seen: Image, calibration: Calibration) -> str:
    """Return the message on a residual view that is brighter than the confocal one, by the mean of some pixels."""
    bundle, background = calibration.bundle, calibration.background
    if bundle is None:
        return ""
    if background is not None and background[_COMPARED].shape == seen.shape:
        seen = seen - background[_COMPARED]
    confocal_dn, residual_dn = (float(seen[_within(seen.shape, *place)].mean()) for place in bundle.discs)
    residual_dn /= bundle.residual_gain
    if residual_dn <= MAX_RESIDUAL_RATIO * max(confocal_dn, 0.0) + MIN_LEVEL_DIFFERENCE:
        return ""
    return (
        f"the right view has {residual_dn / max(confocal_dn, MIN_LEVEL_DIFFERENCE):.2g} times the light of the left"
        " one, so that ELS+ is negative: the left view is to be the confocal one, with the line on its slit"
    )


def _within(shape: tuple[int, ...], centre: tuple[float, float], diameter_px: float) -> NDArray[np.bool_]:
    """Return True for those of the compared pixels, of that shape, that lie within a view."""
    row, col = (COMPARED_STEP_PX * np.arange(size) - at for size, at in zip(shape, centre, strict=True))
    inside: NDArray[np.bool_] = np.hypot(row[:, None], col) < diameter_px / 2
    return inside


def _bit_depth_note(seen: Image, dtype: np.dtype[Any], calibration: Calibration) -> str:
    """Return the message on another bit depth or light of frames of the background's shape by their mean."""
    bundle, background = calibration.bundle, calibration.background
    if bundle is None or background is None:
        return ""
    remedy = "use a calibration of this bit depth and black level, or measure its background again"
    largest = np.iinfo(dtype.name).max if dtype.kind in "ui" else np.inf
    if background.max() > largest:
        raise CalibrationError(
            f"the background has grey levels up to {background.max():.0f}, frames of {dtype} up to {largest}", remedy
        )
    beside = dark_pixels(background.shape, bundle.discs)[_COMPARED] == 1
    if np.count_nonzero(beside) < MIN_COMPARED_PIXELS:
        return ""
    level, expected = float(np.median(seen[beside])), float(np.median(background[_COMPARED][beside]))
    if np.percentile(seen[~beside], LIT_PERCENTILE) <= level:
        return ""
    if max(level, expected) <= MAX_LEVEL_RATIO * min(level, expected) + MIN_LEVEL_DIFFERENCE:
        lit, lit_background = (
            float(np.median(each[~beside])) for each in (seen - level, background[_COMPARED] - expected)
        )
        if lit_background <= MIN_LEVEL_DIFFERENCE or lit >= MIN_LIGHT_RATIO * lit_background:
            return ""
        return (
            f"the views have {lit:.3g} grey levels of light in the frames, {lit_background:.3g} in the background of"
            " the calibration, as of another exposure, or with the specimen lit: measure its background again"
        )
    problem = (
        f"beside the views the frames have grey level {level:.3g}, the background of the calibration {expected:.3g}, "
        "as of another bit depth or black level"
    )
    if level < expected and np.median((seen - background[_COMPARED])[~beside]) < 0:
        raise CalibrationError(problem, remedy)
    return f"{problem}: {remedy}"


def _differs(disc: Disc, centre: NDArray[np.float64], diameter_px: float, mean: Image, side: float) -> bool:
    """Return True if a located disc, clearly seen, contradicts an expected one of which no edge is seen."""
    if disc.edge_seen < MIN_CERTAIN_EDGE:
        return False
    away_px = max(float(np.hypot(*(centre - disc.centre))), abs(disc.diameter_px - diameter_px) / 2)
    if away_px <= TOLERATED * diameter_px:
        return False
    seen = edge_share(mean, disc.centre, disc.diameter_px, side)
    return edge_share(mean, centre, diameter_px, side) < MAX_EDGE_RATIO * seen


def _reduced_mean(frames: Frames) -> tuple[Image, int]:
    """Return the mean of a few frames, reduced to at most `MAX_LOCATED_ROWS`, and the factor."""
    numbers = averaged_frames(len(frames))
    height, cols = frames[0].shape
    factor = -(-height // MAX_LOCATED_ROWS)
    total = np.zeros((len(range(factor // 2, height, factor)), cols // factor * factor), np.float32)
    for number in numbers:
        rows = np.asarray(frames[number])[factor // 2 :: factor, : total.shape[1]]
        cv2.accumulate(rows if rows.dtype in (np.uint8, np.uint16) else rows.astype(np.float32), total)
    mean = np.asarray(cv2.resize(total, (cols // factor, len(total)), interpolation=cv2.INTER_AREA), np.float32)
    mean /= len(numbers)  # in place: another array takes five times as long as the sum of the frames
    return mean, factor


def averaged_frames(count: int) -> list[int]:
    """Return the numbers of the frames that are averaged.

    Parameters
    ----------
    count : int
        Frames of the recording.
    """
    numbers: list[int] = np.unique(np.linspace(0, count - 1, AVERAGED_FRAMES).round().astype(int)).tolist()
    return numbers
