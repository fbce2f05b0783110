"""LS, residual, ELS+ or ELSA images of a recording, made when they are read."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, overload

import numpy as np
from scipy.ndimage import distance_transform_edt

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.arguments import require_calibration, require_frames
from napari_elsplus.io import ImageMetadata, Recording, allocate_images, fill_images, write_images
from napari_elsplus.io.frame_times import median_period_s, uneven_times_s
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.row_power import RowPower
from napari_elsplus.processing.images.row_reference import shows_row_noise
from napari_elsplus.processing.images.sectioning import Frames, Mode, Sectioner
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.workflows.two_threads import ComputedAhead

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import DTypeLike, NDArray

    from napari_elsplus.instrument.calibration import Calibration

MIN_FLAT: Final = 0.1
"""Fraction of the flat field's mean below which pixels are set to 0: dividing would only amplify noise. Chosen; between
0.05 and 0.2 only pixels at the rim of the bundle differ."""


class RawPairs:
    """A recording as pairs of raw frames: the one that the confocal view is taken from, and the residual's.

    Parameters
    ----------
    frames : Frames
        Raw frames; those of other sources than arrays and recordings are copied, since the next may overwrite them.
    mode : Mode or str
        Image type, which determines the pairs: :meth:`Mode.source_frames`.
    frame_numbers : sequence of int, optional
        (T,) the camera's number of each frame, where gaps are lost frames; none were lost by default.

    Attributes
    ----------
    frame_numbers : sequence of int or None
        As given.

    Raises
    ------
    InputError
        If the recording is too short for a single pair.
    """

    def __init__(
        self, frames: Frames, mode: Mode | str, frame_numbers: Sequence[int] | NDArray[np.int64] | None = None
    ) -> None:
        self._frames = frames
        self._stay = isinstance(frames, np.ndarray | Recording)
        self.frame_numbers = frame_numbers
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

    def lost_before(self, index: int) -> int:
        """Return how many images were lost just before the one at an index, by the camera's frame numbers."""
        if index == 0 or self.frame_numbers is None:
            return 0
        passed = int(self.frame_numbers[self.frame(index)] - self.frame_numbers[self.frame(index - 1)])
        return max(passed // self._mode.frames_per_image - 1, 0)  # a camera that is started again counts from 0

    def __call__(self, index: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the frames of the confocal and of the residual view."""
        confocal, residual = self._mode.source_frames(index)
        raw = self._frame(confocal)
        return raw, raw if residual == confocal else self._frame(residual)

    def _frame(self, index: int) -> NDArray[Any]:
        """Return a frame, copied if it may be overwritten by the next one."""
        frame = self._frames[index]
        return frame if self._stay else np.array(frame)


class SectionedImages:
    """The images of a recording in one mode: a lazy sequence of (n, n) float32 arrays; made by :func:`section`.

    ``images[k]`` is one image (n, n), ``images[a:b]`` a stack, ``images[:]`` and ``numpy.asarray(images)`` are all.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols): an array (T, rows, cols) or an open recording.
    calibration : Calibration
        Of the rig that recorded them.
    mode : Mode or str
        ``"ls"``, ``"residual"``, ``"els"`` or ``"elsa"``.
    cores : CoreFilter or str
        Suppression of the core pattern.
    flat_field : bool
        Divide by the calibration's flat field.
    row_reference : bool
        Take the camera's row noise off the frames if the dark pixels beside the bundle show it in the first ones.
    row_power : bool
        Divide rows by the laser's power where it differs from row to row, as both views show it; needs a flat field.

    Raises
    ------
    InputError
        If there are no frames, or only one and ELSA needs two, or the arguments are of another kind.
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
        row_reference: bool = True,
        row_power: bool = False,
    ) -> None:
        require_frames(raw)
        require_calibration(calibration)
        self.mode, self.calibration, self._raw = Mode(mode), calibration, raw
        self._pairs = RawPairs(raw, self.mode)
        rows, cols = raw[0].shape
        noisy = row_reference and calibration.bundle is not None and shows_row_noise(raw, calibration)
        self.sectioner = Sectioner(calibration, (rows, cols), row_reference=noisy)
        self._power = RowPower(self.sectioner, calibration) if row_power else None
        self._finish = finishing(calibration, self.sectioner, cores=cores, flat_field=flat_field)

    @property
    def side(self) -> int:
        """Rows and columns of an image."""
        return self.sectioner.side

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of images, rows, columns."""
        return len(self), self.side, self.side

    @property
    def frame_period_s(self) -> float | None:
        """Seconds from one image to the next by the recording's times, else by the calibration's timing; else None.

        ELSA's is that of two frames.
        """
        raw, times_s, period_s = self._raw, self._frame_times_s, self.calibration.frame_period_s
        if isinstance(raw, Recording) and times_s is not None:
            period_s = median_period_s(times_s, raw.frame_numbers) or period_s
        return None if period_s is None else period_s * self.mode.frames_per_image

    @property
    def times_s(self) -> NDArray[np.float64] | None:
        """Time of each image's confocal frame in seconds, (T,); None if the recording has none of its camera."""
        times = self._frame_times_s
        return None if times is None else times[[self._pairs.frame(index) for index in range(len(self))]]

    @cached_property
    def _frame_times_s(self) -> NDArray[np.float64] | None:
        return self._raw.camera_times_by(self.calibration) if isinstance(self._raw, Recording) else None

    def __len__(self) -> int:
        return len(self._pairs)

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...
    @overload
    def __getitem__(self, index: slice) -> NDArray[np.float32]: ...
    def __getitem__(self, index: int | slice) -> NDArray[np.float32]:
        if isinstance(index, slice):
            chosen = range(*index.indices(len(self)))
            stack = np.empty((len(chosen), self.side, self.side), np.float32)
            for place, number in enumerate(chosen):
                stack[place] = self[number]
            return stack
        if not -len(self) <= index < len(self):
            raise IndexError(f"image {index} of {len(self)}")
        return self._make(*self._pairs(index % len(self)))

    def _make(self, raw: NDArray[Any], raw_residual: NDArray[Any]) -> NDArray[np.float32]:
        """Return the image of a pair of raw frames."""
        if self._power is not None:
            return self._finish(self._power.image(raw, self.mode))
        return self._finish(self.sectioner.section(raw, raw_residual, self.mode))

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        return (self[index] for index in range(len(self)))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self[:], dtype=dtype, copy=copy)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        force: bool = False,
        threads: Literal[1, 2] = 2,
        progress: Progress = without_display,
    ) -> None:
        """Write the images (T, n, n), one at a time, with the calibration and the timing, in the suffix's format.

        Parameters
        ----------
        path : path-like
            ``NAME.ome.tif`` for OME-TIFF, ``NAME.ome.zarr`` for OME-Zarr.
        force : bool
            Overwrite an existing file.
        threads : int
            2 to compute the next images while the next frames are read and an image is written.
        progress : Progress
            Wraps the images' numbers.

        Raises
        ------
        InputError
            If no format writes the suffix, or the file exists and `force` is not given.
        """
        pairs = map(self._pairs, progress(range(len(self)), self.mode.value))
        with ComputedAhead(self._make, pairs, len(self), threads=threads) as images:
            write_images(path, images, self._metadata, force=force)

    def allocate(self, path: str | os.PathLike[str]) -> None:
        """Create the file that :meth:`save` writes, with pixels of 0; :meth:`fill` writes spans of images into it.

        Parameters
        ----------
        path : path-like
            ``NAME.ome.tif`` or ``NAME.ome.zarr``, which does not exist.
        """
        allocate_images(path, self.shape, np.float32, self._metadata)

    def fill(self, path: str | os.PathLike[str], span: range) -> None:
        """Write a span of the images into a file of :meth:`allocate`, one at a time; other processes may write others.

        Parameters
        ----------
        path : path-like
            The file.
        span : range
            Indices of successive images.
        """
        fill_images(path, span.start, (self[index] for index in span))

    @property
    def _metadata(self) -> ImageMetadata:
        """Metadata of the images, as they are written."""
        period_s, settings = self.frame_period_s, {"mode": self.mode.value}
        times_s = uneven_times_s(self.times_s, period_s)
        return ImageMetadata(frame_period_s=period_s, times_s=times_s, settings=settings, calibration=self.calibration)


def finishing(
    calibration: Calibration,
    sectioner: Sectioner,
    *,
    cores: CoreFilter | str = CoreFilter.NONE,
    flat_field: bool = False,
) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """Return the function that divides a sectioned image by the flat field and then filters its cores.

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
    suppress_cores = _keeping_unseen(CoreFilter(cores), flat, sectioner)
    if not flat_field:
        return suppress_cores
    if flat is None:
        raise CalibrationError("the calibration has no flat field", "measure it with `calibrate --flat`")
    lit = sectioner.inside & (flat > MIN_FLAT)
    inverse = np.divide(1, flat, out=np.zeros_like(flat), where=lit)
    return lambda image: suppress_cores(np.multiply(image, inverse, out=image))


def _keeping_unseen(
    cores: CoreFilter, flat: NDArray[np.float32] | None, sectioner: Sectioner
) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """Return the core filter; pixels that the frame does not contain stay NaN, and do not spread into others."""
    suppress = cores.prepared(flat, sectioner.inside)
    unseen = sectioner.inside & ~sectioner.subtracted
    if cores is CoreFilter.NONE or not unseen.any():
        return suppress
    row, col = distance_transform_edt(unseen | ~sectioner.inside, return_distances=False, return_indices=True)[
        :, unseen
    ]

    def suppress_within_view(image: NDArray[np.float32]) -> NDArray[np.float32]:
        absent = unseen & np.isnan(image)
        if not absent.any():
            return suppress(image)
        image[unseen] = image[row, col]
        filtered = suppress(image)
        filtered[absent] = np.nan
        return filtered

    return suppress_within_view


def section(
    raw: Frames,
    calibration: Calibration,
    mode: Mode | str = Mode.ELS,
    *,
    cores: CoreFilter | str = CoreFilter.NONE,
    flat_field: bool = False,
    row_reference: bool = True,
    row_power: bool = False,
) -> SectionedImages:
    """Return the LS, residual, ELS+ or ELSA images of raw frames, lazily.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols): an array (T, rows, cols), a list, or an open recording.
    calibration : Calibration
        Of the rig that recorded them; needs the bundle section.
    mode : Mode or str
        ``"ls"`` (confocal), ``"residual"`` (aligned to it, divided by its gain), ``"els"`` (their difference in one
        frame) or ``"elsa"`` (the difference of successive frames, one image for two frames).
    cores : CoreFilter or str
        ``"none"``, ``"median"``, ``"gaussian"`` or ``"interpolate"``: suppression of the core pattern.
    flat_field : bool
        Divide by the calibration's flat field.
    row_reference : bool
        Take the camera's row noise off the frames if the dark pixels beside the bundle show it in the first ones.
    row_power : bool
        Divide rows by the laser's power where it differs from row to row, as both views show it; needs a flat field.

    Returns
    -------
    SectionedImages
        Sequence of (n, n) float32, signed grey levels, the bundle's centre at ((n - 1) / 2, (n - 1) / 2).
        ``section(...)[:]`` is the whole stack (T, n, n).

    Raises
    ------
    InputError, CalibrationError
        As :class:`SectionedImages`.
    """
    images = SectionedImages(
        raw,
        calibration,
        mode,
        cores=cores,
        flat_field=flat_field,
        row_reference=row_reference,
        row_power=row_power,
    )
    if note := agreement_note(raw, calibration):
        warnings.warn(note, stacklevel=2)
    return images
