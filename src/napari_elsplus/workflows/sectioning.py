"""From a recording to images: stateless, random access, one calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode, Sectioner

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Frames

_DARKEST_FLAT = 0.1
"""Where the flat field is darker than this share of its mean, dividing by it would only show noise."""


class RawPairs:
    """A recording as pairs of raw frames: the one that the confocal view is taken from, and the residual's.

    Parameters
    ----------
    frames : Frames
        Raw frames.
    mode : Mode or str
        Image type, which determines the pairs: :meth:`Mode.source_frames`.

    Raises
    ------
    InputError
        If the recording is too short for a single pair.
    """

    def __init__(self, frames: Frames, mode: Mode | str) -> None:
        self._frames = frames
        self._mode = Mode(mode)
        if len(self) == 0:
            needed = self._mode.frames_per_image
            raise InputError(
                f"{self._mode.value} needs {needed} frames, the recording has {len(frames)}", "record more frames"
            )

    def __len__(self) -> int:
        return len(self._frames) // self._mode.frames_per_image

    def frame(self, index: int) -> int:
        """Index of the confocal view's frame in the recording."""
        return self._mode.source_frames(index)[0]

    def __call__(self, index: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the frames of the confocal and of the residual view."""
        confocal, residual = self._mode.source_frames(index)
        raw = self._frames[confocal]
        return raw, raw if residual == confocal else self._frames[residual]


class Images:
    """The images that a recording gives in one mode: a lazy sequence of (n, n) float32 arrays.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols): an array (T, rows, cols) or an open recording.
    calibration : Calibration
        Of the rig that made them.
    mode : Mode or str
        ``"ls"``, ``"residual"``, ``"els"`` or ``"elsa"``.
    cores : CoreFilter or str
        How the core pattern is suppressed.
    flat_field : bool
        Divide by the calibration's flat field.

    Raises
    ------
    InputError
        If there are no frames, or only one and ELSA needs two.
    CalibrationError
        If the calibration does not fit the frames, or lacks what the options need.

    Notes
    -----
    One thread at a time: buffers are reused from image to image.
    """

    def __init__(
        self,
        raw: Frames,
        calibration: Calibration,
        mode: Mode | str,
        *,
        cores: CoreFilter | str = CoreFilter.NONE,
        flat_field: bool = False,
    ) -> None:
        self.mode = Mode(mode)
        self._raw = raw
        self._count = len(RawPairs(raw, self.mode))
        rows, cols = raw[0].shape
        self.sectioner = Sectioner(calibration, (rows, cols))
        self._finish = finishing(calibration, self.sectioner, cores=cores, flat_field=flat_field)

    @property
    def side(self) -> int:
        """Rows and columns of an image."""
        return self.sectioner.side

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of images, rows, columns."""
        return self._count, self.side, self.side

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        if not -self._count <= index < self._count:
            raise IndexError(index)
        return self._finish(self.sectioner.image(self._raw, index % self._count, self.mode))

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        return (self[index] for index in range(self._count))


def finishing(
    calibration: Calibration,
    sectioner: Sectioner,
    *,
    cores: CoreFilter | str = CoreFilter.NONE,
    flat_field: bool = False,
) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """Return what is done to an image once it is sectioned: flat field, then core filter.

    Parameters
    ----------
    calibration : Calibration
        With its flat field, where the options need it.
    sectioner : Sectioner
        Of that calibration.
    cores : CoreFilter or str
        How the core pattern is suppressed.
    flat_field : bool
        Divide by the calibration's flat field.

    Returns
    -------
    callable
        (n, n) float32 to (n, n) float32; may change its argument.

    Raises
    ------
    CalibrationError
        If the flat field is absent or of another size.
    """
    flat = calibration.flat
    if flat is not None and flat.shape != (sectioner.side, sectioner.side):
        raise CalibrationError(
            f"the flat field has {flat.shape} pixels, the images {sectioner.side} x {sectioner.side}",
            "calibrate it again",
        )
    suppress_cores = CoreFilter(cores).prepared(flat, sectioner.inside)
    if not flat_field:
        return suppress_cores
    if flat is None:
        raise CalibrationError("the calibration has no flat field", "measure it with `calibrate --flat`")
    lit = sectioner.inside & (flat > _DARKEST_FLAT)
    inverse = np.divide(1, flat, out=np.zeros_like(flat), where=lit)
    return lambda image: suppress_cores(np.multiply(image, inverse, out=image))


def images(
    raw: Frames,
    calibration: Calibration,
    mode: Mode | str,
    *,
    cores: CoreFilter | str = CoreFilter.NONE,
    flat_field: bool = False,
) -> NDArray[np.float32]:
    """Return all images that a recording gives in one mode.

    Parameters and errors are those of :class:`Images`.

    Returns
    -------
    numpy.ndarray
        (T, n, n) float32, signed grey levels, the bundle's centre at (n - 1) / 2.
    """
    lazy = Images(raw, calibration, mode, cores=cores, flat_field=flat_field)
    made = np.empty(lazy.shape, np.float32)
    for index, image in enumerate(lazy):
        made[index] = image
    return made
