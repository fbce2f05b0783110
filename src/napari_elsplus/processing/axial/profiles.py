"""Signals of a scan of depths: means of the central square of both views (the paper, Sec. 3.1).

A scan whose squares are saturated is refused: a signal that is clipped in contact puts all distances too far.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.saturation import saturated_part
from napari_elsplus.processing.axial.axial_response import SystematicUncertainty
from napari_elsplus.processing.axial.black_level import DarkLevels, DarkPixels
from napari_elsplus.processing.axial.rounding import pixel_noise_dn, rounding_bias_dn
from napari_elsplus.processing.axial.tilt import SquareHalves
from napari_elsplus.processing.images.sectioning import Frames, Sectioner

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.progress import ProgressWrapper

    Curve = NDArray[np.float64]
    Frame = NDArray[np.generic]

SQUARE_UM: Final = 240.0
"""Side of the central square that is averaged, micrometres (the paper, Sec. 3.1)."""
MAX_SATURATED_SQUARE: Final = 0.005
"""Share of a view's square in a frame that may be saturated; measured: the brightest cores, clipped, then lower the
mean by 0.05 %, and distances are 0.1 % too long; with 0.014 they are 0.4 % too long (one scan each; light of the cores
with a standard deviation of 15 %)."""


class AxialProfiles(NamedTuple):
    """Signals of a scan of depths; ELS+ is the difference of the two.

    Parameters
    ----------
    ls, residual : numpy.ndarray
        (T,) float64, grey levels.
    systematic : SystematicUncertainty
        Uncertainties common to all depths.
    dark : DarkLevels
        Level of the pixels beside the views, by which a black level that is left in the signals is known.
    halves : SquareHalves
        Light of the square's halves, by which a tilt of the plate is known.
    """

    ls: Curve
    residual: Curve
    systematic: SystematicUncertainty
    dark: DarkLevels
    halves: SquareHalves


def axial_profiles(
    frames: Frames,
    calibration: Calibration,
    *,
    depths_um: ArrayLike | None = None,
    progress: ProgressWrapper = iter,
) -> AxialProfiles:
    """Return the mean LS and residual signal of the central square in each frame.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).
    calibration : Calibration
        With its bundle section and scale.
    depths_um : array_like, optional
        Depth of each frame (T,), for the error of a saturated scan.
    progress : callable
        Wraps the iteration over frame numbers, for a progress bar.

    Returns
    -------
    AxialProfiles
        Systematic uncertainties are that of the residual gain, and the bias of means by rounding to grey levels.

    Raises
    ------
    CalibrationError
        If a section is missing, or the scale is unknown.
    MeasurementError
        If the square does not fit into the bundle, or is saturated in one of the frames.
    """
    bundle, um_per_px = calibration.measured_bundle, calibration.measured_um_per_px
    if not len(frames):
        raise InputError("the scan holds no frame", "record one at each depth")
    diameter_um = bundle.diameter_px * um_per_px
    if SQUARE_UM * np.sqrt(2) > diameter_um:
        raise MeasurementError(
            f"a square of {SQUARE_UM:.0f} um does not fit into the bundle of {diameter_um:.0f} um",
            "check the calibration's um_per_px and diameter",
        )
    sectioner = Sectioner(calibration, frames[0].shape)
    middle, half = (sectioner.side - 1) / 2, SQUARE_UM / um_per_px / 2
    inside = slice(round(middle - half), round(middle + half) + 1)
    squares = (_square(bundle.confocal_centre, half), _square(bundle.residual_centre, half))
    dark = DarkPixels(calibration, frames[0].shape)
    ls, residual, saturated, dark_dn = np.empty((4, len(frames)))
    asymmetry = np.empty((len(frames), 2))
    image = np.empty((sectioner.side, sectioner.side), np.float32)
    for k in progress(range(len(frames))):
        frame = frames[k]
        square = sectioner.ls(frame, image)[inside, inside]
        ls[k], asymmetry[k] = square.mean(), _asymmetry(square)
        residual[k] = sectioner.residual(frame, image)[inside, inside].mean()
        saturated[k] = max(saturated_part(frame[each]) for each in squares)
        dark_dn[k] = dark.level_dn(frame) if dark.enough else 0.0
    _refuse_saturated(saturated, depths_um)
    darkest = _darkest(frames, ls)
    zeros = [_zero_dn(darkest, calibration.background, square) for square in squares]
    gain = bundle.residual_gain
    return AxialProfiles(
        ls,
        residual,
        SystematicUncertainty(zeros[0], zeros[1] / gain, bundle.residual_gain_uncertainty / gain),
        DarkLevels(
            dark_dn if dark.enough else None,
            dark.bias_dn(*darkest) if dark.enough and darkest else 0.0,
            gain,
            calibration.background is not None,
        ),
        SquareHalves(asymmetry, SQUARE_UM / 2, diameter_um / 2),
    )


def _asymmetry(square: NDArray[np.float32]) -> tuple[float, float]:
    """Return the light of the lower half less that of the upper, and of the right less the left, over the sum."""
    half = len(square) // 2
    total = float(square.sum())
    if not total:
        return 0.0, 0.0
    upper, left = (float(part.sum(dtype=np.float64)) for part in (square[:half], square[:, :half]))
    lower, right = (float(part.sum(dtype=np.float64)) for part in (square[-half:], square[:, -half:]))
    return (lower - upper) / total, (right - left) / total


def _square(centre: tuple[float, float], half: float) -> tuple[slice, ...]:
    return tuple(slice(max(round(at - half), 0), round(at + half)) for at in centre)


def _refuse_saturated(share: Curve, depths_um: ArrayLike | None) -> None:
    """Raise MeasurementError if the saturated share of a frame is too large, with the depths of those frames."""
    frames = np.flatnonzero(share > MAX_SATURATED_SQUARE)
    if not len(frames):
        return
    at = frames + 1 if depths_um is None else np.asarray(depths_um)[frames]
    first, last = (f"{each:g}" for each in (at.min(), at.max()))
    span = first if first == last else f"{first} to {last}"
    raise MeasurementError(
        f"the scan is saturated {f'in frame {span}' if depths_um is None else f'at {span} um'}"
        f" (up to {100 * share.max():.1f} % of the measured square)",
        "lower the light or the gain, and record the scan again",
    )


def _darkest(frames: Frames, ls: Curve) -> tuple[Frame, Frame] | None:
    """Return the two successive frames with the least signal; None if there is but one."""
    if len(ls) < 2:
        return None
    first = int(np.argmin(ls[:-1] + ls[1:]))
    return frames[first], frames[first + 1]


def _zero_dn(
    darkest: tuple[Frame, Frame] | None, background: NDArray[np.float32] | None, square: tuple[slice, ...]
) -> float:
    """Return the bias of a view's zero by rounding: its background hardly has a pattern that would average it out."""
    if darkest is None or background is None or not np.issubdtype(darkest[0].dtype, np.integer):
        return 0.0
    return rounding_bias_dn(pixel_noise_dn(darkest[0][square], darkest[1][square]), background[square])
