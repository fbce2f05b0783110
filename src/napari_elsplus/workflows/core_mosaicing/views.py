"""Images in which cores are read: confocal views of raw frames, and finished images of one bundle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.images.cores import CoreInterpolation
from napari_elsplus.processing.images.sectioning import Frames, Mode, Sectioner
from napari_elsplus.processing.mosaicing.cores.reading import BundleCores
from napari_elsplus.processing.tracking.finished.field import FinishedField, sample_frames
from napari_elsplus.processing.tracking.finished.tracking import FinishedTracking
from napari_elsplus.processing.tracking.front_end.grid import FIELD

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration


@dataclass(frozen=True)
class CoreView:
    """The image in which cores are read.

    Parameters
    ----------
    image : callable
        Returns it, (n, n) float32, from the raw frames of the confocal and of the residual view.
    centre : tuple of float
        Row and column of the bundle's centre in it.
    cores : BundleCores
        The cores.
    """

    image: Callable[[NDArray[Any], NDArray[Any]], NDArray[np.float32]]
    centre: tuple[float, float]
    cores: BundleCores


def view_of_raw_frames(calibration: Calibration, frame_shape: tuple[int, int], mode: Mode) -> CoreView:
    """Return the view of the cores in raw frames of a calibrated rig.

    Parameters
    ----------
    calibration : Calibration
        With its bundle section and its flat field.
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    mode : Mode
        Image type.

    Raises
    ------
    InputError
        If the calibration has no flat field, or the cores are not resolved in it.
    """
    if calibration.flat is None:
        raise InputError(
            "the calibration has no flat field to find the cores in",
            "calibrate with --bundle or --flat, or choose another insertion",
        )
    sectioner = Sectioner(calibration, frame_shape)
    cores = _cores(calibration.flat, sectioner.inside)
    return CoreView(lambda raw, residual: sectioner.section(raw, residual, mode), sectioner.centre, cores)


class FinishedBundle:
    """Finished images of one bundle: its cores, and images without the core pattern, on which the probe is tracked.

    Parameters
    ----------
    frames : Frames
        (T, rows, cols) images that show the cores.
    flat : numpy.ndarray, optional
        (rows, cols) image of the same bundle, evenly lit; the mean of the frames by default, which contains the cores'
        gains relative to their neighbours' but not the light's profile.

    Raises
    ------
    InputError
        If the images are too small, or show no core pattern.
    """

    def __init__(self, frames: Frames, flat: NDArray[Any] | None = None) -> None:
        samples = sample_frames(frames) if flat is None else [flat]
        if samples[0].shape != frames[0].shape:
            raise InputError(
                f"the flat field has {samples[0].shape} pixels, the frames {frames[0].shape}",
                "give one of the same camera region",
            )
        field = FinishedField.of(samples)
        even = np.asarray(np.mean([field.window(sample) for sample in samples], axis=0), np.float32)
        y, x = (np.arange(field.grid.side) - c for c in field.grid.centre)
        inside = np.hypot(y[:, None], x) < 0.5 * FIELD * field.grid.diameter + 1
        self.view = CoreView(lambda raw, _: field.window(raw), field.grid.centre, _cores(even, inside))
        self._window = field.window
        self._smooth = CoreInterpolation.from_flat(even, inside)
        self._frames = frames

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        return self.without_cores(self._frames[index])

    def without_cores(self, raw: NDArray[Any]) -> NDArray[np.float32]:
        """Return an image interpolated between the cores.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) frame.

        Returns
        -------
        numpy.ndarray
            (n, n) float32.
        """
        return self._smooth(self._window(raw))

    def tracking(self) -> FinishedTracking:
        """Return a tracking method for these frames that does not see the cores."""
        return _CorelessTracking(FinishedField.of_stack(self), self.without_cores)


class _CorelessTracking(FinishedTracking):
    """Tracks finished images whose core pattern is interpolated first."""

    def __init__(self, field: FinishedField, without_cores: Callable[[NDArray[Any]], NDArray[np.float32]]) -> None:
        super().__init__(field)
        self._without_cores = without_cores

    def prepare_image(self, raw: NDArray[Any], raw_residual: NDArray[Any], out: NDArray[np.float32]) -> None:
        super().prepare_image(self._without_cores(raw), raw_residual, out)


def _cores(flat: NDArray[np.float32], inside: NDArray[np.bool_]) -> BundleCores:
    try:
        return BundleCores.from_flat(flat, inside)
    except MeasurementError as error:
        raise InputError(
            f"the cores are not resolved ({error.problem})", "choose the insertion dead-leaf or feathered"
        ) from None
