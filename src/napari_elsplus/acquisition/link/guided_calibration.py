"""Calibration step by step through an engine's client."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from napari_elsplus.acquisition.calibrating.live import SWEEP_VOLTAGES
from napari_elsplus.processing.calibration.steps import find_step

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.processing.calibration.draft import Draft, Setup
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset


class GuidedCalibration:
    """Measures one step after the other through an engine's client; to be used by one thread at a time.

    Parameters
    ----------
    client : EngineClient
        With a rig that is open and configured.
    voltages : int
        Of the sweep.
    """

    def __init__(self, client: EngineClient, voltages: int = SWEEP_VOLTAGES) -> None:
        self._client, self._voltages = client, voltages

    def setup(self) -> Setup:
        """Return the settings with which frames are taken now."""
        return self._client.setup().result()

    def measure(self, key: str, draft: Draft) -> Any:
        """Measure the step with a key; the line is parked in the end.

        Parameters
        ----------
        key : str
            Of :func:`napari_elsplus.processing.calibration.steps.calibration_steps`.
        draft : Draft
            Results so far.

        Returns
        -------
        object
            The step's result.

        Raises
        ------
        MeasurementError
            If the step finds nothing.
        InputError
            If it was cancelled.
        DeviceError
            If camera or galvo fail.
        """
        return self._client.measure_step(find_step(key), draft, self._voltages).result()

    def follow_offset(
        self, draft: Draft, keep_on: Callable[[], bool]
    ) -> Iterator[tuple[int, SlitOffset | MeasurementError]]:
        """Yield the slit offset while the tilt mirror is being turned; the engine measures it in frame after frame.

        Parameters
        ----------
        draft : Draft
            Results so far; the place of the line and the background are taken from it.
        keep_on : callable
            Called before each; False ends the measurement.

        Yields
        ------
        int
            Frames measured so far.
        SlitOffset or MeasurementError
            The newest offset, or the reason why there is none.

        Raises
        ------
        DeviceError
            If camera or galvo fail.
        """
        client = self._client
        old = client.newest_offset(-1).result()
        first = seen = 0 if old is None else old[0]
        followed = client.follow_offset(draft)
        try:
            while keep_on() and not followed.done():
                newest = client.newest_offset(seen).result()
                if newest is not None:
                    seen, found = newest
                    yield seen - first, found
        finally:
            client.cancel().result()
            followed.result()
