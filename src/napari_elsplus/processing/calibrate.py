"""The calibration's steps, and all of them together: frames in, the calibration out.

(i) slit offset, (ii) galvo map, (iii) bundle pair, then background and flat field: the paper's System Calibration.
What one step finds serves the next: rows are taken at the bundle's centre column where the bundle is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from napari_elsplus.calibration import (
    BundleSection,
    Calibration,
    FrameSection,
    GalvoSection,
    OffsetSection,
    OpticsSection,
    QualitySection,
)
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.optics import BUNDLE_UM
from napari_elsplus.processing import bundle as bundles
from napari_elsplus.processing.cores import CoreFilter
from napari_elsplus.processing.galvo import GalvoMap, fit_galvo, lines_in_sweep
from napari_elsplus.processing.line import Line, locate_line
from napari_elsplus.processing.pair import Alignment, align_pair, darkness
from napari_elsplus.processing.quality import alignment_error
from napari_elsplus.processing.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

PARK_CLEARANCE_UM: Final = 120.0
"""A halo's width is 100 um; a fifth more for what the galvo map does not know outside of the bundle."""
MOST_SATURATED: Final = 0.01
MOST_DRIFT: Final = 0.05


class Frames(Protocol):
    """Raw frames: an array (T, rows, cols), a list, an open recording."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> NDArray[Any]: ...


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
class Pair:
    """Both bundle images, and the right one laid onto the left."""

    left: bundles.Disc
    right: bundles.Disc
    alignment: Alignment

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


@dataclass(frozen=True, slots=True)
class Findings:
    """What was measured, step by step; absent what was not."""

    shape: tuple[int, int] | None = None
    offset: SlitOffset | None = None
    galvo: GalvoMap | None = None
    pair: Pair | None = None
    background: Background | None = None
    calibration: Calibration = field(default_factory=Calibration)


def measure_background(frames: Frames) -> Background:
    """Average the frames of a dark tube with the laser on.

    Raises
    ------
    MeasurementError
        If a good part is saturated, or the level drifts.
    """
    mean = mean_frame(frames)
    half = len(frames) // 2
    levels = [float(np.mean(frames[k][::4, ::4])) for k in range(len(frames))]
    first, second = (float(np.mean(part)) for part in (levels[: max(half, 1)], levels[half:]))
    drift = (second - first) / max(abs(first), 1.0)
    if abs(drift) > MOST_DRIFT:
        raise MeasurementError(
            f"the background drifts by {100 * drift:.1f} % while it is taken", "let laser and camera warm up"
        )
    _must_not_be_saturated(frames[0], "background")
    return Background(mean, len(frames), drift)


def measure_offset(frames: Frames, background: Image | None = None, pair: Pair | None = None) -> SlitOffset:
    """Step (i): where the standing line is in both views, and the difference.

    Parameters
    ----------
    frames : sequence of numpy.ndarray
        Raw frames (rows, cols) of the line standing near the middle of the bundle; they are averaged.
    background : numpy.ndarray, optional
        Mean frame of the dark tube.
    pair : Pair, optional
        The bundle images; without them each view's middle is the middle of the lit part of the line.

    Raises
    ------
    MeasurementError
        If there is no line in one of the views.
    """
    frame = mean_frame(frames)
    if background is not None:
        frame = frame - background
    _must_not_be_saturated(frames[0], "image of the line")
    split = pair.split if pair is not None else _between_views(frame)
    lines = []
    for name, view in (("left", frame[:, :split]), ("right", frame[:, split:])):
        try:
            lines.append(locate_line(view))
        except MeasurementError as error:
            raise MeasurementError(f"{name} view: {error.problem}", error.remedy) from None
    left, right = lines
    columns = (left.column, right.column)
    if pair is not None:
        columns = (pair.left.centre[1], pair.right.centre[1] - split)
    influence = right.influence_at(columns[1]) - left.influence_at(columns[0])
    return SlitOffset(
        rows=right.row_at(columns[1]) - left.row_at(columns[0]),
        uncertainty_rows=float(np.linalg.norm(influence)),
        left=left,
        right=right,
        split=split,
    )


def map_galvo(
    frames: Frames,
    volts: NDArray[np.floating],
    background: Image | None = None,
    pair: Pair | None = None,
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
    pair : Pair, optional
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


def locate_pair(frames: Frames) -> Pair:
    """Step (iii): both bundle images, their alignment and gain, from frames lit from the far end.

    Raises
    ------
    MeasurementError
        If there are not two bundle images that show the same cores.
    """
    frame = mean_frame(frames)
    _must_not_be_saturated(frames[0], "image of the bundle")
    left, right = bundles.locate_pair(frame)
    return Pair(left, right, align_pair(frame, left, right))


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
        (n, n) float32, on the grid of :class:`napari_elsplus.processing.sectioning.Sectioner`.

    Raises
    ------
    MeasurementError
        If the disc is dark.
    """
    calibration.require("bundle")
    assert calibration.bundle is not None
    frame = mean_frame(frames)
    sectioner = Sectioner(calibration, frame.shape)
    image = sectioner.ls(frame)
    inside = disc(len(image), calibration.bundle.diameter_px)
    level = float(image[inside].mean())
    if not level > 0.5:
        raise MeasurementError(f"the flat field is dark (mean {level:.2g} grey levels)", "light the scene evenly")
    return np.where(inside, np.maximum(image, 0) / level, 1).astype(np.float32)


def calibrate(
    *,
    line: Frames | None = None,
    sweep: Frames | None = None,
    volts: NDArray[np.floating] | None = None,
    bundle: Frames | None = None,
    background: Frames | None = None,
    flat: Frames | None = None,
    um_per_px: float | None = None,
    bundle_um: float | None = None,
    line_period_s: float | None = None,
    rows_per_frame: float | None = None,
) -> Calibration:
    """Make a calibration of any subset of its inputs; see :func:`measure`.

    Returns
    -------
    Calibration
        With a section for each input.
    """
    return measure(
        line=line,
        sweep=sweep,
        volts=volts,
        bundle=bundle,
        background=background,
        flat=flat,
        um_per_px=um_per_px,
        bundle_um=bundle_um,
        line_period_s=line_period_s,
        rows_per_frame=rows_per_frame,
    ).calibration


def measure(
    *,
    line: Frames | None = None,
    sweep: Frames | None = None,
    volts: NDArray[np.floating] | None = None,
    bundle: Frames | None = None,
    background: Frames | None = None,
    flat: Frames | None = None,
    um_per_px: float | None = None,
    bundle_um: float | None = None,
    line_period_s: float | None = None,
    rows_per_frame: float | None = None,
    watch: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Findings:
    """Measure whatever the inputs allow.

    Parameters
    ----------
    line, sweep, bundle, background, flat : sequence of numpy.ndarray, optional
        Raw frames (rows, cols): the line standing still; the line at each of `volts`; the bundle lit from the far end;
        a dark tube; a uniform scene.
    volts : numpy.ndarray, optional
        A voltage per frame of `sweep`.
    um_per_px, bundle_um : float, optional
        Scale, or the bundle's diameter from which it follows.
    line_period_s, rows_per_frame : float, optional
        Timing.
    watch : callable, optional
        Wraps the numbers of the sweep's frames, to show how far it is.

    Returns
    -------
    Findings
        The steps' results with their uncertainties, and the calibration made of them.

    Raises
    ------
    InputError
        If inputs are missing, disagree in shape, or make no sense together.
    MeasurementError
        If a step finds no line or no pair.
    """
    inputs = {"line": line, "sweep": sweep, "bundle": bundle, "background": background, "flat": flat}
    shape = _common_shape({name: frames for name, frames in inputs.items() if frames is not None})
    if (sweep is None) != (volts is None):
        raise InputError(
            *(
                ("voltages without a sweep", "give --sweep")
                if sweep is None
                else ("a sweep without voltages", "give --volts")
            )
        )
    if um_per_px is not None and bundle_um is not None:
        raise InputError(f"two scales, {um_per_px} um per pixel and a bundle of {bundle_um} um", "give one of them")
    if bundle_um is not None and bundle is None:
        raise InputError(f"a bundle of {bundle_um} um gives no scale without its image", "give --bundle or --um-per-px")
    if flat is not None and bundle is None:
        raise InputError("a flat field belongs to a located bundle", "give --bundle")
    dark = None if background is None else measure_background(background)
    mean = None if dark is None else dark.mean
    pair = None if bundle is None else locate_pair(bundle)
    offset = None if line is None else measure_offset(line, mean, pair)
    galvo = None if sweep is None or volts is None else map_galvo(sweep, volts, mean, pair, watch)
    if pair is not None and bundle_um is not None:
        um_per_px = bundle_um / pair.left.diameter_px
    calibration = Calibration(
        frame=None if shape is None else FrameSection(shape=shape),
        offset=None if offset is None else _offset_section(offset),
        galvo=None if galvo is None else _galvo_section(galvo, pair, um_per_px),
        bundle=None if pair is None else _bundle_section(pair),
        optics=_optics_section(um_per_px, line_period_s, rows_per_frame),
        background=mean,
    )
    if pair is not None and bundle is not None:
        calibration = _with_flat_and_quality(calibration, pair, bundle, flat)
    return Findings(shape, offset, galvo, pair, dark, calibration)


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
        total += frames[number]
    if not np.isfinite(total).all():
        raise InputError("a frame holds NaN or infinity", "record it again")
    return (total / len(frames)).astype(np.float32)


def _common_shape(inputs: dict[str, Frames]) -> tuple[int, int] | None:
    shapes = {}
    for name, frames in inputs.items():
        if not len(frames):
            raise InputError(f"{name}: there are 0 frames", "give at least one")
        shape = frames[0].shape
        if len(shape) != 2:
            raise InputError(f"{name}: a frame has shape {shape}", "frames (rows, cols) are expected")
        shapes[name] = shape
    for name, shape in shapes.items():
        first = next(iter(shapes))
        if shape != shapes[first]:
            raise InputError(
                f"{first} has {shapes[first][0]} x {shapes[first][1]} pixels, {name} {shape[0]} x {shape[1]}",
                "record all with the same camera region",
            )
    return next(iter(shapes.values()), None)


def _must_not_be_saturated(frame: NDArray[Any], name: str) -> None:
    if not np.issubdtype(frame.dtype, np.integer):
        return
    white = np.iinfo(frame.dtype).max
    share = float(np.mean(frame == white))
    if share > MOST_SATURATED:
        raise MeasurementError(
            f"{100 * share:.0f} % of the {name} is saturated (grey level {white})", "lower the light or the gain"
        )


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


def _offset_section(offset: SlitOffset) -> OffsetSection:
    return OffsetSection(rows=offset.rows, uncertainty_rows=offset.uncertainty_rows, tilt_deg=offset.left.tilt_deg)


def _galvo_section(galvo: GalvoMap, pair: Pair | None, um_per_px: float | None) -> GalvoSection:
    park_v = None
    if pair is not None:
        clear = pair.left.diameter_px / 2 + PARK_CLEARANCE_UM / (um_per_px or BUNDLE_UM / pair.left.diameter_px)
        park_v = galvo.park_v(pair.left.centre[0] - clear, pair.left.centre[0] + clear)
    return GalvoSection(
        volts_per_row=galvo.volts_per_row,
        volts_at_row_zero=galvo.volts_at_row_zero,
        volts_per_row_uncertainty=galvo.volts_per_row_uncertainty,
        volts_at_row_zero_uncertainty=galvo.volts_at_row_zero_uncertainty,
        r_squared=galvo.r_squared,
        rms_rows=galvo.rms_rows,
        park_v=park_v,
    )


def _bundle_section(pair: Pair) -> BundleSection:
    top, bottom = (tuple(float(value) for value in row) for row in pair.alignment.residual_to_confocal)
    return BundleSection(
        confocal_centre=pair.left.centre,
        residual_centre=pair.right.centre,
        diameter_px=pair.left.diameter_px,
        residual_to_confocal=((top[0], top[1], top[2]), (bottom[0], bottom[1], bottom[2])),
        residual_gain=pair.alignment.gain,
        residual_gain_uncertainty=pair.alignment.gain_uncertainty,
        centre_uncertainty_px=pair.left.centre_uncertainty_px,
        diameter_uncertainty_px=pair.left.diameter_uncertainty_px,
        alignment_uncertainty_px=pair.alignment.uncertainty_px,
    )


def _optics_section(
    um_per_px: float | None, line_period_s: float | None, rows_per_frame: float | None
) -> OpticsSection | None:
    numbers = {"um_per_px": um_per_px, "line_period_s": line_period_s, "rows_per_frame": rows_per_frame}
    known = {name: value for name, value in numbers.items() if value is not None}
    for name, value in known.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", "it must be a positive number")
    return OpticsSection(**known) if known else None


def _with_flat_and_quality(calibration: Calibration, pair: Pair, bundle: Frames, flat: Frames | None) -> Calibration:
    """Flat field, and how well the two views cancel: both from light of the far end, above its own darkness."""
    transmission = mean_frame(bundle)
    dark = darkness(transmission, pair.left, pair.right)
    above_dark = calibration.model_copy(update={"background": dark})
    if flat is None:
        image = measure_flat(bundle, above_dark)
    else:
        image = measure_flat(flat, calibration if calibration.background is not None else above_dark)
    sectioner = Sectioner(above_dark, transmission.shape)
    views = [sectioner.ls(transmission), sectioner.residual(transmission)]
    inside = disc(len(image), pair.left.diameter_px)
    try:
        smooth = CoreFilter.GAUSSIAN.prepared(image, inside)
    except MeasurementError:
        smooth = CoreFilter.MEDIAN.prepared(None, inside)
    quality = QualitySection(
        alignment_error=alignment_error(views[0], views[1], pair.left.diameter_px),
        alignment_error_filtered=alignment_error(smooth(views[0]), smooth(views[1]), pair.left.diameter_px),
    )
    return calibration.model_copy(update={"flat": image, "quality": quality})
