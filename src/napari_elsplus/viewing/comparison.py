"""LS, ELSA and ELS+ of the same frames, computed when they are read: contrast, background, differences."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER, contrast
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.modes import COMPARED_MODES, frames_in_turn
from napari_elsplus.processing.images.sectioning import Mode, disc
from napari_elsplus.viewing.lazy import LazyPlanes, image_planes
from napari_elsplus.viewing.script import recording_script
from napari_elsplus.viewing.stack import Stack, um_per_px_of

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

    Image = NDArray[np.float32]


@dataclass(frozen=True)
class Comparison:
    """LS, ELSA and ELS+ images of one recording; image k of each is made from raw frame k.

    Attributes
    ----------
    images : dict
        Mode to lazy planes (T, n, n) float32, signed grey levels. ELSA takes its residual from the frame after (at the
        end, before) it, and is absent from a recording of one frame.
    inside : numpy.ndarray
        (n, n) bool: the disc of 90 % of the bundle diameter, in which images are evaluated.
    um_per_px : float or None
        Scale.
    """

    images: dict[Mode, LazyPlanes]
    inside: NDArray[np.bool_]
    um_per_px: float | None

    @property
    def side(self) -> int:
        """Rows and columns of an image."""
        return len(self.inside)

    def at(self, index: int) -> dict[Mode, Image]:
        """Return the images at a frame index, as a dictionary of mode to (n, n) float32."""
        return {mode: planes[index] for mode, planes in self.images.items()}


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """Contrast and background of an image.

    Attributes
    ----------
    contrast : float
        (structure - background) / (structure + background), from the deciles of the 90 % disc.
    background : float
        Lowest decile, grey levels.
    background_left : float
        Background as a fraction of that of the LS image.
    """

    contrast: float
    background: float
    background_left: float


def compare_stack(stack: Stack, calibration: Calibration, cores: CoreFilter | str = CoreFilter.NONE) -> Comparison:
    """Return lazy LS, ELSA and ELS+ images of a recording.

    Parameters
    ----------
    stack : Stack
        Raw frames.
    calibration : Calibration
        Of the rig that acquired them.
    cores : CoreFilter or str
        Suppression of the core pattern, applied to all modes.

    Raises
    ------
    CalibrationError
        If the calibration does not fit the frames, or has no flat field where the filter needs one.
    """
    bundle = calibration.measured_bundle
    raw = stack.planes
    if note := agreement_note(raw, calibration):
        warnings.warn(note, stacklevel=2)
    images = {
        mode: image_planes(frames_in_turn(raw, mode), calibration, mode, cores=cores)
        for mode in COMPARED_MODES
        if mode is not Mode.ELSA or len(raw) > 1
    }
    side = images[Mode.LS].shape[1]
    inside = disc(side, USED_DIAMETER * bundle.diameter_px)
    return Comparison(images, inside, um_per_px_of(stack, calibration))


def image_statistics(images: Mapping[Mode, Image], inside: NDArray[np.bool_]) -> dict[Mode, ImageStatistics]:
    """Return contrast, background, and fraction of the LS background, of each image.

    Parameters
    ----------
    images : mapping
        Mode to (n, n) grey levels; contains `Mode.LS`.
    inside : numpy.ndarray
        (n, n) bool, pixels that are evaluated.

    Examples
    --------
    >>> import numpy as np
    >>> haze, bars = np.full((8, 8), 60, np.float32), np.tile(np.float32([0, 100]), (8, 4))
    >>> found = image_statistics({Mode.LS: haze + bars, Mode.ELS: bars + 6}, np.ones((8, 8), bool))
    >>> round(found[Mode.ELS].background_left, 3), found[Mode.LS].background
    (0.1, 60.0)
    """
    levels = {mode: contrast(image, inside) for mode, image in images.items()}
    whole = levels[Mode.LS].background
    return {
        mode: ImageStatistics(
            level.michelson, level.background, level.background / whole if whole > 0 else float("nan")
        )
        for mode, level in levels.items()
    }


def difference_planes(comparison: Comparison, minuend: Mode, subtrahend: Mode) -> LazyPlanes:
    """Return lazy differences of two modes, image by image.

    Parameters
    ----------
    comparison : Comparison
        Contains both modes.
    minuend, subtrahend : Mode
        The difference is the first minus the second.

    Raises
    ------
    InputError
        If the recording is too short for one of them.
    """
    for mode in (minuend, subtrahend):
        if mode not in comparison.images:
            raise InputError(f"one frame makes no {mode.value} image", "record at least two frames")
    first, second = comparison.images[minuend], comparison.images[subtrahend]
    return LazyPlanes(lambda index: first[index] - second[index], first.shape, first.dtype)


def comparison_script(stack: Stack, calibration: Path | str | None, cores: str, scaling: str, frame: int) -> str:
    """Return a script that makes the same comparison.

    Parameters
    ----------
    stack : Stack
        Raw frames of a recording in a file.
    calibration : path-like or None
        Its calibration file.
    cores, scaling : str
        Core filter and rule for white.
    frame : int
        Index of the frame that is compared.

    Raises
    ------
    InputError
        If the stack has no file.
    CalibrationError
        If the calibration has no file of its own.
    """
    body = f"""
comparison = compare_stack(Stack.of(recording), calibration, cores={cores!r})
images = comparison.at({frame})
white = white_levels(images, comparison.inside, {scaling!r})
scaled = {{mode: image / white[mode] for mode, image in images.items()}}
for mode, found in image_statistics(images, comparison.inside).items():
    print(f"{{mode}}: contrast {{found.contrast:.3f}}, background {{found.background:.1f}} grey levels")
"""
    imports = (
        "from napari_elsplus.processing.analysis.image_quality import white_levels",
        "from napari_elsplus.viewing.comparison import compare_stack, image_statistics",
        "from napari_elsplus.viewing.stack import Stack",
    )
    return recording_script(f"LS, ELSA and ELS+ of a frame of {stack.file_name}.", stack, calibration, body, imports)
