"""Live images: sectioned and finished at the display's rate; averages take up every frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.acquisition.streaming.ring import Layout
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.priority import ordinary_priority
from napari_elsplus.processing.analysis.saturation import saturated_part
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.modes import elsa_pair
from napari_elsplus.processing.images.resampling import cropped
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.workflows.sectioning import finishing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

DISPLAY_SLOTS: Final = 6
"""Images in the display's ring; chosen: a tenth of a second at 60 Hz for a reader to copy one."""
ROW_TEST_INTERVAL_FRAMES: Final = 128
"""Frames from one test for row noise to the next; chosen: half a second, and a hundredth of the cost of a test."""
RAW: Final = "raw"
_SATURATION_STEP: Final = 16
"""Saturated pixels are counted on every sixteenth row; chosen: a sixteenth of the cost, and enough."""
_FOCUS_STEP: Final = 8
"""Gradients are taken on every eighth row; measured on three simulated recordings of 40 frames: within 0.9, 0.9 and
2.8 % (RMS) of every second row's, where the focus varies by 2.5, 1.0 and 5.0 % from frame to frame."""
_GRADIENT_PX: Final = 2
"""Distance over which a gradient is taken, pixels; chosen: about a core's pitch, beyond the noise of single pixels."""


@dataclass(frozen=True, slots=True)
class LiveView:
    """Options of the live images; raw frames are recorded regardless.

    Parameters
    ----------
    background : bool
        Subtract the calibration's background.
    flat_field : bool
        Divide by the calibration's flat field.
    cores : CoreFilter
        Suppression of the core pattern.
    average : int
        Recursive averaging: the weight of a frame is one over this; 1 displays single frames.
    modes : frozenset of Mode
        Image types that are made.
    row_reference : bool
        Take the camera's row noise off frames whose dark pixels show it, as recordings are processed.

    Raises
    ------
    InputError
        If `average` is less than 1.
    """

    background: bool = True
    flat_field: bool = False
    cores: CoreFilter = CoreFilter.NONE
    average: int = 1
    modes: frozenset[Mode] = frozenset(Mode)
    row_reference: bool = True

    def __post_init__(self) -> None:
        if self.average < 1:
            raise InputError(f"an average over {self.average} frames", "average over 1 frame or more")


@dataclass(frozen=True, slots=True)
class Measures:
    """Measures of image quality at the microscope.

    Parameters
    ----------
    saturated : float
        Share of the raw pixels that are white.
    focus : float
        Mean squared gradient of the ELS+ image over its squared mean brightness: largest in focus; NaN if dark.
    """

    saturated: float = np.nan
    focus: float = np.nan


def display_layout(frame_shape: tuple[int, int], side: int | None, modes: frozenset[Mode] = frozenset(Mode)) -> Layout:
    """Return the layout of the display's ring.

    Parameters
    ----------
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    side : int or None
        Side of the images, pixels; None without a calibrated bundle: raw frames only.
    modes : frozenset of Mode
        Image types.
    """
    fields: list[tuple[str, tuple[int, ...], str]] = [(RAW, frame_shape, "uint8")]
    if side is not None:
        fields += [(mode.value, (side, side), "float32") for mode in Mode if mode in modes]
    return Layout(DISPLAY_SLOTS, tuple(fields))


class LiveImages:
    """Makes the images of successive frames; built once per calibration and view.

    Parameters
    ----------
    frame_shape : tuple of int
        Rows and columns of the raw frames.
    calibration : Calibration, optional
        Without its bundle section only raw frames are displayed.
    view : LiveView or None
        Options of the images; None where nobody looks at them, which makes raw frames only.

    Attributes
    ----------
    averages : bool
        True if every frame contributes to the displayed images.

    Raises
    ------
    CalibrationError
        If the calibration does not fit the frames, or lacks what the view needs.

    Notes
    -----
    The confocal view is not resampled: the bundle's centre lies at most half a pixel from the middle of the images.
    ELSA is made of alternating frames, paired as in :mod:`napari_elsplus.processing.images.modes`. Where one of the two
    is missing, the last ELSA image stands.
    """

    def __init__(self, frame_shape: tuple[int, int], calibration: Calibration | None, view: LiveView | None) -> None:
        view = LiveView(modes=frozenset()) if view is None else view
        self._sectioner: Sectioner | None = None
        self.averages = view.average > 1
        self._modes: frozenset[Mode] = frozenset()
        self.layout = display_layout(frame_shape, None)
        if calibration is None or calibration.bundle is None:
            return
        if not view.background:
            calibration = calibration.model_copy(update={"background": None})
        self._sectioner = sectioner = Sectioner(
            calibration,
            frame_shape,
            on_camera_grid=True,
            row_reference=view.row_reference,
            row_test_interval=ROW_TEST_INTERVAL_FRAMES,
        )
        calibration = _on_camera_grid(calibration, sectioner)
        self._finish = finishing(calibration, sectioner, cores=view.cores, flat_field=view.flat_field)
        self._weight = 1 / view.average
        self._modes = view.modes
        self.layout = display_layout(frame_shape, sectioner.side, self._modes)
        square = (sectioner.side, sectioner.side)
        views = {Mode.LS, Mode.RESIDUAL} if Mode.ELSA in self._modes else set[Mode]()
        self._now = {mode: np.zeros(square, np.float32) for mode in self._modes | views}
        self._mean = self._now if view.average == 1 else {mode: np.zeros(square, np.float32) for mode in self._modes}
        self._confocal = np.zeros(square, np.float32)
        self._confocal_number: int | None = None
        self._last_number: int | None = None
        self._first = True
        with ordinary_priority():
            self._warm_up(sectioner, frame_shape)

    @property
    def pairs(self) -> bool:
        """True if an image is made of two successive frames: ELSA is."""
        return Mode.ELSA in self._modes

    @property
    def of_one_frame(self) -> bool:
        """True if every image is made of the frame alone that is displayed: :meth:`fill` needs no :meth:`add`."""
        return not (self.averages or self.pairs)

    def add(self, raw: NDArray[np.uint8], frame_number: int) -> None:
        """Section a raw frame of a frame number, for images of this and later frames."""
        if self._sectioner is None or not self._modes:
            return
        now = self._now
        confocal, _ = elsa_pair(frame_number)
        if Mode.ELSA in self._modes and self._confocal_number == self._last_number:  # with the frame that follows
            self._confocal, now[Mode.LS] = now[Mode.LS], self._confocal
        self._sectioner.fill(raw, raw, ls=now.get(Mode.LS), residual=now.get(Mode.RESIDUAL), els=now.get(Mode.ELS))
        self._last_number = frame_number
        if frame_number == confocal:
            self._confocal_number = confocal
        elif Mode.ELSA in self._modes and self._confocal_number == confocal:
            np.subtract(self._confocal, now[Mode.RESIDUAL], out=now[Mode.ELSA])
        if self._mean is not now:
            for mode in self._modes:
                if self._first:
                    np.copyto(self._mean[mode], now[mode])
                else:
                    cv2.accumulateWeighted(now[mode], self._mean[mode], self._weight)
        self._first = False

    def fill(self, raw: NDArray[np.uint8], arrays: Mapping[str, NDArray[Any]]) -> Measures:
        """Finish the images of a raw frame, which was added last unless images are :attr:`of_one_frame`.

        Those are sectioned where they are displayed.

        Parameters
        ----------
        raw : numpy.ndarray
            (rows, cols) uint8.
        arrays : mapping of str to numpy.ndarray
            A slot of the display's ring, filled.
        """
        np.copyto(arrays[RAW], raw)
        saturated = saturated_part(raw[::_SATURATION_STEP])
        if self._sectioner is None:
            return Measures(saturated)
        if self.of_one_frame:
            ls, residual, els = (arrays.get(mode.value) for mode in (Mode.LS, Mode.RESIDUAL, Mode.ELS))
            self._sectioner.fill(raw, raw, ls=ls, residual=residual, els=els)
        for mode in self._modes:
            image = arrays[mode.value]
            if not self.of_one_frame:
                np.copyto(image, self._mean[mode])
            finished = self._finish(image)
            if finished is not image:
                np.copyto(image, finished)
        return Measures(saturated, focus(arrays[Mode.ELS.value]) if Mode.ELS in self._modes else np.nan)

    def _warm_up(self, sectioner: Sectioner, frame_shape: tuple[int, int]) -> None:
        """Compile all kernels and touch all memory before the first frames, of which the second has row noise."""
        blank = np.zeros(frame_shape, np.uint8)
        noisy = blank + np.random.default_rng(0).integers(0, 9, (len(blank), 1), np.uint8)
        slot = {name: np.empty(shape, dtype) for name, shape, dtype in self.layout.fields}
        for number, frame in enumerate((blank, noisy)):
            self.add(frame, number)
            self.fill(frame, slot)
            sectioner.retest_row_noise()
        self._first, self._confocal_number, self._last_number = True, None, None


def _on_camera_grid(calibration: Calibration, sectioner: Sectioner) -> Calibration:
    """Return the calibration with its flat field on the grid of a sectioner."""
    flat = calibration.flat
    if flat is None or flat.shape != (sectioner.side, sectioner.side):
        return calibration
    row, col = (sectioner.side - 1 - at for at in sectioner.centre)
    return calibration.model_copy(update={"flat": cropped(flat, (row, col), sectioner.side)})


def focus(image: NDArray[np.generic]) -> float:
    """Return the mean squared gradient over the squared mean, on some rows: the normalised Tenengrad.

    Parameters
    ----------
    image : numpy.ndarray
        (n, n) float.

    Returns
    -------
    float
        Larger is sharper; NaN for an image without light. Pixels that are NaN count as 0.
    """
    pixels = np.asarray(image, np.float32)
    rows, below = pixels[:-_GRADIENT_PX:_FOCUS_STEP], pixels[_GRADIENT_PX::_FOCUS_STEP]
    down, across = cv2.subtract(below, rows), cv2.subtract(rows[:, _GRADIENT_PX:], rows[:, :-_GRADIENT_PX])
    gradient = sum(cv2.norm(each, cv2.NORM_L2SQR) / each.size for each in (down, across))
    if np.isnan(gradient):
        return focus(np.nan_to_num(pixels))
    level = cv2.mean(rows)[0]
    return gradient / level**2 if level > 0 else float("nan")
