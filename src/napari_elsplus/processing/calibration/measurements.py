"""Measurements of the calibration: from frames to a galvo map, bundle pair, background or flat field.

(ii) galvo map and (iii) bundle pair are those of the paper's System Calibration; (i) is :mod:`slit_offset`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.saturation import saturation_level
from napari_elsplus.processing.analysis.uncertainty import robust_sigma
from napari_elsplus.processing.calibration.bundle import location as bundles
from napari_elsplus.processing.calibration.bundle.gain import darkness
from napari_elsplus.processing.calibration.bundle.laser_gain import LightCollector
from napari_elsplus.processing.calibration.bundle.pair import BundlePair, structure_of_light
from napari_elsplus.processing.calibration.bundle.view_alignment import align_views
from napari_elsplus.processing.calibration.frame_regions import (
    brightest,
    column_between_views,
    mean_frame,
    sampled,
    saturated_share,
    unlit_pixels,
)
from napari_elsplus.processing.calibration.galvo import GalvoMap, fit_galvo, visible_line
from napari_elsplus.processing.calibration.line.clipping import MAX_CLIPPED_CORE, clipped_share
from napari_elsplus.processing.calibration.line.view_offset import IN_PLACE
from napari_elsplus.processing.images.resampling import crop_to_frame, cropped, within_frame
from napari_elsplus.processing.images.row_reference import RowReference
from napari_elsplus.processing.images.sectioning import Frames, Sectioner, disc

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.calibration.line.location import Line
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset
    from napari_elsplus.processing.progress import ProgressWrapper

    Image = NDArray[np.float32]

MAX_SATURATED_BUNDLE: Final = 0.05
"""Largest saturated share of the bundle's image; chosen: saturated pixels are left out of the gain."""
SATURATION_LEVEL: Final = 0.98
"""Share of the largest grey level; chosen: reached by the mean of a pixel that is saturated in most frames."""
SATURATED_FRAMES: Final = 0.5
"""Share of the frames in which such a pixel is saturated; chosen, for light that changes while it is taken."""
MAX_DRIFT: Final = 0.05
"""Largest relative change of the mean level between halves of the frames; chosen, above that of a warm laser."""
DRIFT_SIGMAS: Final = 3.0
"""Standard deviations by which it exceeds that limit where it is not by chance, of light that flickers; chosen."""
MOVING_SIGMAS: Final = 10.0
"""Robust standard deviations by which pixels are brighter where light moves, and where a line stands in a background;
chosen: noise of pixels and rows stays below."""
MAX_MOVING: Final = 0.02
"""Share of such pixels in a background; chosen, above that of hot pixels that blink. Measured: 0 in
dark tubes of seventeen rigs, 0.18 and more in sweeps of 12 to 400 lines."""
MOVING_FRAMES, MOVING_STEP_PX = 100, 8
"""Frames that are searched for it, and the step between their rows and columns; chosen: some thousand pixels do."""
NOISE_PX: Final = 9
"""Width in which the noise of these pixels is averaged; chosen, over it the light of a dark tube hardly changes."""
MIN_MOVING_FRAMES: Final = 5
"""For a robust standard deviation; chosen."""
DARK_PERCENTILE: Final = 5.0
"""Of the pixels of a view, that lie beside the bundle; chosen: corners of the view have a fifth of its pixels."""
MIN_NOISE: Final = 0.5
"""Steps between a camera's grey levels; chosen, as one that rounds to them may show none."""
MAX_CHORD: Final = 1.1
"""Length of a line over the bundle's diameter; chosen: the rim's blur, and what a threshold makes of it."""
LIT_FRAMES: Final = 400
"""Frames of a sweep from which the light of the line is collected; chosen: all of the paper's sweep, since power noise
gives each line a gain of its own."""


@dataclass(frozen=True, slots=True)
class Background:
    """Mean frame of the dark tube.

    Parameters
    ----------
    mean : numpy.ndarray
        (rows, cols) float32.
    frames : int
        Number of frames that were averaged; the paper averages 50.
    drift : float
        Relative change of the mean level from the first half of the frames to the second.
    line_row : float, optional
        Row of a line that stands in the confocal view; None if there is none, as in a dark tube.
    """

    mean: Image
    frames: int
    drift: float
    line_row: float | None = None


def measure_background(frames: Frames) -> Background:
    """Average the frames of a dark tube with the laser on.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols).

    Raises
    ------
    MeasurementError
        If more than 1 % is saturated, a line moves, or the level drifts by more than 5 %.
    """
    mean = mean_frame(frames)
    saturated_share(frames, "background")
    moving, noise = _movement(frames)
    if moving > MAX_MOVING:
        raise MeasurementError(
            f"light moves over {100 * moving:.0f} % of the background, as the line of a sweep does",
            "give frames of the dark tube",
        )
    drift, line = _drift(frames, "background"), visible_line(mean[:, : column_between_views(mean)])
    stands = line is not None and line.amplitude > MOVING_SIGMAS * noise
    return Background(mean, len(frames), drift, line.row if line is not None and stands else None)


def _line_alone(frame: Image) -> Line | None:
    """Return the laser line where it is brighter than all else, as on a bundle that no other light fills; else None."""
    view = frame[:, : column_between_views(frame)]
    line = visible_line(view)
    if line is None:
        return None
    dark, glow = np.percentile(view, (DARK_PERCENTILE, 50))
    return line if line.amplitude > glow - dark else None


def _movement(frames: Frames) -> tuple[float, float]:
    """Return the share of pixels that are far brighter in single frames, and the pixels' typical noise in grey levels.

    The frame with most of these pixels is left out: a flash of light moves nowhere. A pixel's noise in few frames may
    be small by chance: it is taken to be no less than that of the pixels around.
    """
    every = -(-len(frames) // MOVING_FRAMES)
    some = np.asarray([frames[k][::MOVING_STEP_PX, ::MOVING_STEP_PX] for k in range(0, len(frames), every)])
    step = int(np.gcd.reduce(some, axis=None)) if some.dtype.kind == "u" else 1  # of few bits that lie to the left
    above = some.astype(np.float32)
    above -= np.median(above, axis=0)
    sigma = robust_sigma(above, axis=0).astype(np.float32)
    around = np.sqrt(cv2.blur(np.square(sigma), (NOISE_PX, NOISE_PX)))
    noise = np.maximum(np.maximum(sigma, around), MIN_NOISE * max(step, 1))
    lit = above > MOVING_SIGMAS * noise
    lit[np.count_nonzero(lit, axis=(1, 2)).argmax()] = False
    moving = float(lit.any(axis=0).mean()) if len(above) >= MIN_MOVING_FRAMES else 0.0
    return moving, float(np.median(noise))


def _drift(frames: Frames, name: str) -> float:
    """Return the relative change of the mean level from the first half of the frames to the second, unless large."""
    half = len(frames) // 2
    levels = np.array([np.mean(np.asarray(frames[k][::4, ::4], np.float64)) for k in range(len(frames))])
    parts = levels[: max(half, 1)], levels[half:]
    steps = np.concatenate([np.diff(part) for part in parts])  # within the halves, which a drift hardly changes
    variance = float(np.square(steps).mean()) / 2 if len(steps) else 0.0
    first, second = (float(part.mean()) for part in parts)
    level = max(abs(first), 1.0)
    drift, sigma = (second - first) / level, np.sqrt(variance * sum(1 / len(part) for part in parts)) / level
    if abs(drift) - DRIFT_SIGMAS * sigma > MAX_DRIFT:
        raise MeasurementError(
            f"the {name} drifts by {100 * drift:.1f} % while it is taken", "let laser and camera warm up"
        )
    return drift


def map_galvo(
    frames: Frames,
    volts: NDArray[np.floating],
    background: Image | None = None,
    pair: BundlePair | None = None,
    progress: ProgressWrapper = iter,
    offset: SlitOffset | None = None,
) -> GalvoMap:
    """Fit the voltage that puts the line onto a row of the confocal view (step ii).

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
    progress : callable, optional
        Wraps the frames' numbers, to display progress.
    offset : SlitOffset, optional
        Of the same line. Where it or the pair is known, the light of the lines is collected in both views.

    Raises
    ------
    InputError
        If the numbers of voltages and frames differ.
    MeasurementError
        If too few frames show a line.
    """
    if len(volts) != len(frames):
        raise InputError(f"{len(volts)} voltages for {len(frames)} frames of the sweep", "give one voltage per frame")
    seen = brightest(frames)
    white = saturation_level(seen)
    painted = np.subtract(seen, 0 if background is None else background, dtype=np.float32)
    split = pair.split if pair is not None else column_between_views(painted)
    dark = unlit_pixels(painted, discs=[] if pair is None else pair.discs)
    reference, place = RowReference(dark, background), pair or offset
    collector = None if place is None else LightCollector(painted.shape, place.split)
    max_chord_px = MAX_CHORD * (split - float(dark[0, :split].sum()) if pair is None else pair.confocal.diameter_px)
    every, noisy = -(-len(frames) // LIT_FRAMES), reference.some_show_noise(frames)
    lines, clipped = [], 0
    for number in progress(range(len(frames))):
        raw = frames[number]
        frame = reference.without_row_noise(raw) if noisy else raw
        line = visible_line(frame[:, :split], None if background is None else background[:, :split])
        lines.append(line)
        if collector is None or place is None or line is None or number % every or line.length_px > max_chord_px:
            continue
        view_offset = place.view_offset(line)
        if max(clipped_share(raw, white, line, each) for each in (IN_PLACE, view_offset)) > MAX_CLIPPED_CORE:
            clipped += 1
        else:
            collector.add(frame, line, view_offset)
    column, diameter_px = (None, None) if pair is None else (pair.confocal.centre[1], pair.confocal.diameter_px)
    found = fit_galvo(volts, lines, column, diameter_px, max_chord_px)
    return found if collector is None else replace(found, light=collector.swept(dark, background, clipped))


def measure_pair(frames: Frames) -> BundlePair:
    """Locate both bundle images, and measure their alignment and gain (step iii).

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of the bundle lit from its far end.

    Raises
    ------
    MeasurementError
        If there are not two bundle images that show the same cores, the laser line outshines them, or the level drifts
        by more than 5 %.
    """
    frame = mean_frame(frames)
    share = saturated_share(frames, "image of the bundle", MAX_SATURATED_BUNDLE)
    if (line := _line_alone(frame)) is not None:
        raise MeasurementError(
            f"the laser line stands at row {line.row:.0f}, and lights no more of the bundle than that",
            "give frames of the bundle lit from its far end",
        )
    confocal, residual = bundles.locate_pair(frame)
    whites = [(each, saturation_level(each)) for each in sampled(frames)]
    often = np.mean([each >= white for each, white in whites], axis=0) >= SATURATED_FRAMES
    saturated = often | (frame >= SATURATION_LEVEL * min(white for _, white in whites))
    alignment = align_views(frame, confocal, residual, saturated)
    light, side = frame - darkness(frame, (confocal.circle, residual.circle)), ceil(confocal.diameter_px)
    inside = disc(side, confocal.diameter_px) & within_frame(crop_to_frame(confocal.centre, side), side, frame.shape)
    structure = structure_of_light(cropped(light, confocal.centre, side), inside)
    pair = BundlePair(confocal, residual, alignment, frame, share, structure)
    if pair.shows_flat_field:
        _drift(frames, "flat field")
    return pair


def measure_flat_field(frames: Frames, calibration: Calibration) -> Image:
    """Measure the relative brightness of the confocal view's pixels under uniform light, mean 1 inside the disc.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of a uniform scene, or of the bundle lit from its far end.
    calibration : Calibration
        With its bundle section.

    Returns
    -------
    numpy.ndarray
        (n, n) float32, on the grid of :class:`napari_elsplus.processing.images.sectioning.Sectioner`.

    Raises
    ------
    MeasurementError
        If the disc is dark, more than 1 % is saturated, or the level drifts by more than 5 %.
    """
    bundle = calibration.measured_bundle
    frame = mean_frame(frames)
    saturated_share(frames, "flat field")
    _drift(frames, "flat field")
    sectioner = Sectioner(calibration, frame.shape)
    image = sectioner.ls(frame)
    inside = disc(len(image), bundle.diameter_px)
    level = float(image[inside].mean())
    if not level > 0.5:
        raise MeasurementError(f"the flat field is dark (mean {level:.2g} grey levels)", "light the scene evenly")
    return np.where(inside, np.maximum(image, 0) / level, 1).astype(np.float32)
