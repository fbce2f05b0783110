"""Image quality as in the paper: alignment error of the views, resolution on a bar target, artefact at the rim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER, edge_artefact
from napari_elsplus.processing.analysis.resolution import (
    RESOLVED_CONTRAST,
    BarElement,
    bars_within,
    element_contrast,
    nearest_usaf_1951,
    smallest_resolved_line_pair_um,
)
from napari_elsplus.processing.calibration.bundle.cancellation import AlignmentErrors, measure_alignment_errors
from napari_elsplus.processing.images.sectioning import Mode, disc
from napari_elsplus.viewing.lazy import image_planes
from napari_elsplus.viewing.script import recording_script
from napari_elsplus.viewing.stack import Stack, um_per_px_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.progress import ProgressWrapper

    Box = tuple[float, float, float, float]

MIN_BOX_PX: Final = 5.0
"""Smallest side of a box, pixels: three bars and two gaps of one pixel each."""
_PROFILE_SHARE: Final = 0.1
"""Half-width of the columns averaged into the profile, as a fraction of the disc's radius; chosen."""


@dataclass(frozen=True, slots=True)
class Element:
    """A marked element of a USAF 1951 bar target.

    Attributes
    ----------
    group, element : int
        Numbers on the target.
    line_pair_um : float
        Period: one bar and one gap.
    contrast : float
        Michelson contrast of bars and gaps.
    """

    group: int
    element: int
    line_pair_um: float
    contrast: float

    @property
    def resolved(self) -> bool:
        """True if the contrast reaches the threshold of resolution."""
        return self.contrast >= RESOLVED_CONTRAST


@dataclass(frozen=True, slots=True)
class Resolution:
    """Contrasts of the marked elements, and the smallest resolved line pair.

    Attributes
    ----------
    elements : tuple of Element
        In the order of their boxes.
    finest_um : float
        Finest period at which, and above which, all marked elements are resolved; NaN if none is.
    """

    elements: tuple[Element, ...]
    finest_um: float


@dataclass(frozen=True)
class EdgeMap:
    """Mean residual image, normalised to its level at the centre.

    Attributes
    ----------
    image : numpy.ndarray
        (n, n); below 1 where the line has left the bundle during the residual's exposure, NaN outside of the bundle.
    position_um : numpy.ndarray
        (m,): row positions from the bundle's centre in the 90 % disc, um; pixels where the scale is unknown.
    profile : numpy.ndarray
        (m,): mean over the central columns.
    frames : int
        Number of residual images averaged.
    """

    image: NDArray[np.float64]
    position_um: NDArray[np.float64]
    profile: NDArray[np.float64]
    frames: int


def measure_alignment(stack: Stack, calibration: Calibration, frame: int) -> AlignmentErrors:
    """Measure the alignment error of one frame, before and after core filters, as the calibration does.

    Parameters
    ----------
    stack : Stack
        Raw frames in transmission, lit from the distal end of the bundle, so that both views show one scene.
    calibration : Calibration
        Of the rig that acquired them.
    frame : int
        Index of the frame.

    Raises
    ------
    CalibrationError
        If the calibration does not fit the frames.
    MeasurementError
        If the frame is dark.
    """
    errors = measure_alignment_errors(stack.planes[frame], calibration)
    if not np.isfinite(errors.before):
        raise MeasurementError(f"frame {frame} is dark", "light the bundle from its distal end")
    return errors


def measure_resolution(image: NDArray[np.floating], boxes_px: Sequence[Box], um_per_px: float) -> Resolution:
    """Measure the contrast of elements of a USAF 1951 target, and the smallest line pair resolved.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols), bars brighter than gaps.
    boxes_px : sequence of tuple
        Edges (top, left, bottom, right) in pixels, each drawn closely around the three bars of one element. Their
        direction is the one of greater contrast.
    um_per_px : float
        Scale; with the box size it identifies the element.

    Raises
    ------
    InputError
        If there is no box, or one is too small or outside the image.
    """
    marked = [_marked(image, box, um_per_px) for box in boxes_px]
    elements = tuple(
        Element(*nearest_usaf_1951(bars.line_pair_um)[:2], bars.line_pair_um, element_contrast(image, bars))
        for bars in marked
    )
    try:
        finest_um = smallest_resolved_line_pair_um(image, marked)
    except MeasurementError:  # not even the coarsest
        finest_um = float("nan")
    return Resolution(elements, finest_um)


def measure_edge(stack: Stack, calibration: Calibration, progress: ProgressWrapper = iter) -> EdgeMap:
    """Average the residual images of a recording, which are dark where the line has left the bundle.

    Parameters
    ----------
    stack : Stack
        Raw frames of a moving probe; the paper averages about 300.
    calibration : Calibration
        Of the rig that acquired them; its flat field is used if it has one.
    progress : callable
        Wraps the sequence of frame indices, for instance with a progress bar.

    Raises
    ------
    CalibrationError
        If the calibration does not fit the frames.
    MeasurementError
        If there is no light at the centre.
    """
    residuals = image_planes(stack.planes, calibration, Mode.RESIDUAL, flat_field=calibration.flat is not None)
    image = edge_artefact(residuals[index] for index in progress(range(len(residuals))))
    middle, radius = (len(image) - 1) / 2, USED_DIAMETER * calibration.measured_bundle.diameter_px / 2
    near = np.flatnonzero(np.abs(np.arange(len(image)) - middle) < _PROFILE_SHARE * radius)
    rows = np.flatnonzero(np.abs(np.arange(len(image)) - middle) < radius)
    scale = um_per_px_of(stack, calibration)
    profile = image[np.ix_(rows, near)].mean(axis=1)
    position_um = (rows - middle).astype(np.float64) * (scale or 1.0)
    image[~disc(len(image), calibration.measured_bundle.diameter_px)] = np.nan
    return EdgeMap(image, position_um, profile, len(residuals))


def quality_script(
    stack: Stack, calibration: Path | str | None, cores: str, frame: int, boxes_px: Sequence[Box]
) -> str:
    """Return a script that makes the same measurements.

    Parameters
    ----------
    stack : Stack
        Raw frames of a recording in a file.
    calibration : path-like or None
        Its calibration file.
    cores : str
        Core filter of the resolution.
    frame : int
        Index of the frame that is measured.
    boxes_px : sequence of tuple
        As for :func:`measure_resolution`; may be empty.

    Raises
    ------
    InputError
        If the stack has no file.
    CalibrationError
        If the calibration has no file of its own.
    """
    boxes = [tuple(round(float(edge), 2) for edge in box) for box in boxes_px]
    body = f"""
FRAME = {frame}
BOXES_PX = {boxes!r}  # top, left, bottom, right of each element

stack = Stack.of(recording)
print(f"alignment error: {{measure_alignment(stack, calibration, FRAME).text}}")
if BOXES_PX:
    image = elsplus.section(recording, calibration, "ls", cores={cores!r})[FRAME]
    found = measure_resolution(image, BOXES_PX, calibration.um_per_px)
    print(f"smallest resolved line pair: {{found.finest_um:.2f}} um")
edge = measure_edge(stack, calibration)
print(f"residual at the rim over the central level: {{edge.profile.min():.2f}}")
"""
    imports = (
        "from napari_elsplus.viewing.quality import measure_alignment, measure_edge, measure_resolution",
        "from napari_elsplus.viewing.stack import Stack",
    )
    title = f"Alignment error, resolution and artefact at the rim of {stack.file_name}."
    return recording_script(title, stack, calibration, body, imports)


def _marked(image: NDArray[np.floating], box_px: Box, um_per_px: float) -> BarElement:
    top, left, bottom, right = box_px
    if min(bottom - top, right - left) < MIN_BOX_PX:
        raise InputError(
            f"a box of {bottom - top:.0f} x {right - left:.0f} pixels contains no bars", "draw it around all three bars"
        )
    ways = []
    for upright, across in ((True, right - left), (False, bottom - top)):
        period_um = nearest_usaf_1951(across * um_per_px / 2.5)[2]
        ways.append(bars_within(box_px, period_um, upright=upright))
    return max(ways, key=lambda bars: np.nan_to_num(element_contrast(image, bars), nan=-1.0))
