"""The threads that watch a running stream: what fails without a command ends it, parked; a calibration is compared."""

from __future__ import annotations

from functools import partial
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import CalibrationError, DeviceError, InputError
from napari_elsplus.processing.calibration.core_agreement import CoreAgreement

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

_PERIOD_S: Final = 0.05
"""Chosen: a tenth of the 0.5 s in which the galvo has to be parked after a fault."""
COMPARISON_PERIOD_S: Final = 5.0
"""From one comparison to the next; chosen: it takes 11 to 14 ms of one core."""
COMPARED_FRAMES: Final = 8
"""Frames that are averaged; chosen: the cores of the residual view of a sparse specimen are then clear."""


class Watcher(Thread):
    """Calls a check periodically; whatever fails, the watch goes on.

    Parameters
    ----------
    check : callable
        Raises what has failed.
    failed : callable
        Receives what was raised; what it raises itself it receives at the next check.
    """

    def __init__(self, check: Callable[[], None], failed: Callable[[BaseException], None]) -> None:
        super().__init__(name="engine-watch", daemon=True)
        self._check, self._failed = check, failed
        self._stopping = Event()
        self.start()

    def stop(self) -> None:
        """End the watch."""
        self._stopping.set()
        self.join()

    def run(self) -> None:
        """Check until :meth:`stop`."""
        error: BaseException | None = None
        while not self._stopping.wait(_PERIOD_S):
            if error is None:
                error = _raised_by(self._check)
            if error is not None:
                error = _raised_by(partial(self._failed, error))


class AgreementWatch(Thread):
    """Compares the newest frames with the calibration that they are scanned by.

    Parameters
    ----------
    scanned_by : callable
        Returns the calibration by which the line scans now; None while it does not, or scans by a trial.
    fresh_frames : callable
        Returns a number of new frames (count, rows, cols).
    failed : callable
        Receives a defect; the comparisons end then.

    Attributes
    ----------
    disagreement : str
        Problem and remedy in one line; empty while the frames agree with the calibration, or show too little. It stays
        as it is until the frames agree, or disagree otherwise.
    """

    def __init__(
        self,
        scanned_by: Callable[[], Calibration | None],
        fresh_frames: Callable[[int], NDArray[np.uint8]],
        failed: Callable[[Exception], None],
    ) -> None:
        super().__init__(name="calibration-watch", daemon=True)
        self._scanned_by, self._fresh_frames, self._failed = scanned_by, fresh_frames, failed
        self._stopping = Event()
        self._known: tuple[Calibration, CoreAgreement | None] | None = None
        self.disagreement = ""

    def stop(self) -> None:
        """End the comparisons."""
        self._stopping.set()

    def run(self) -> None:
        """Compare until :meth:`stop`."""
        while not self._stopping.wait(COMPARISON_PERIOD_S):
            try:
                self.compare()
            except (DeviceError, InputError):
                continue  # the stream ends, or pauses
            except Exception as error:  # noqa: BLE001 - frames go on being acquired and recorded
                self._failed(error)
                return

    def compare(self) -> None:
        """Compare a few frames, if the line scans by the calibration that is active, and still does afterwards."""
        calibration = self._scanned_by()
        if calibration is None:
            return
        frames = self._fresh_frames(COMPARED_FRAMES)
        agreement = self._agreement(calibration, frames.shape[1:])
        if agreement is None or self._scanned_by() is not calibration:
            return
        found = agreement.disagreement(frames)
        text = "" if found is None else f"{found.problem}: {found.remedy}"
        if _without_numbers(text) != _without_numbers(self.disagreement):
            self.disagreement = text

    def _agreement(self, calibration: Calibration, frame_shape: tuple[int, int]) -> CoreAgreement | None:
        if self._known is None or self._known[0] is not calibration:
            try:
                self._known = calibration, CoreAgreement(calibration, frame_shape)
            except CalibrationError:
                self._known = calibration, None
            self.disagreement = ""
        return self._known[1]


def _raised_by(step: Callable[[], None]) -> BaseException | None:
    try:
        step()
    except BaseException as error:  # noqa: BLE001 - handled by the owner of the watch, which must not end
        return error
    return None


def _without_numbers(text: str) -> str:
    return "".join(letter for letter in text if not letter.isdigit())
