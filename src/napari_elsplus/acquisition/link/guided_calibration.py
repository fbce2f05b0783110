"""The calibration's steps one by one through an engine's client, each with its target before the probe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.acquisition.calibrating.whole import SWEEP_VOLTAGES, Target
from napari_elsplus.processing.calibration.draft import Draft, Setup, Step, StepResult
from napari_elsplus.processing.calibration.galvo import GalvoMap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.processing.calibration.calibrate import SlitOffset

TARGETS: Final = {
    Step.OFFSET: Target.FLUORESCENT,
    Step.GALVO: Target.FLUORESCENT,
    Step.PAIR: Target.FAR_END_LIT,
    Step.LAG: Target.FLUORESCENT,
    Step.BACKGROUND: Target.DARK_TUBE,
    Step.FLAT: Target.FLUORESCENT,
}
"""What must lie before the probe for each step."""


class GuidedCalibration:
    """Measures one step after the other through an engine's client; to be used by one thread at a time.

    Parameters
    ----------
    client : EngineClient
        With a rig that is open and configured.
    voltages : int
        Steps of the sweep.
    """

    def __init__(self, client: EngineClient, voltages: int = SWEEP_VOLTAGES) -> None:
        self._client, self._voltages = client, voltages
        self._span: tuple[float, float] | None = None

    def setup(self) -> Setup:
        """Say what frames are taken with now."""
        return self._client.setup().result()

    def measure(self, step: Step, draft: Draft) -> StepResult:
        """Measure a step; whatever happens, the mirror is parked in the end.

        Parameters
        ----------
        step : Step
            Which.
        draft : Draft
            What is known so far.

        Raises
        ------
        MeasurementError
            If the step finds nothing.
        InputError
            If it was cancelled.
        DeviceError
            If camera or mirror fail.
        """
        client, known = self._client, draft.calibration
        client.prepare(TARGETS[step]).result()
        try:
            match step:
                case Step.OFFSET:
                    return client.measure_offset(self._middle(draft), known.background, draft.pair).result()
                case Step.GALVO:
                    low, high = self._whole_span(draft)
                    volts = np.linspace(low, high, self._voltages)
                    return client.map_galvo(volts, known.background, draft.pair).result()
                case Step.PAIR:
                    return client.lit_pair().result()
                case Step.LAG:
                    return client.lag_by(known).result()
                case Step.BACKGROUND:
                    return client.background_by(known.model_copy(update={"background": None})).result()
                case Step.FLAT:
                    return client.flat_by(known).result()
        finally:
            client.prepare(None).result()

    def watch_offset(
        self, draft: Draft, go_on: Callable[[], bool]
    ) -> Iterator[tuple[int, SlitOffset | MeasurementError]]:
        """Look at the slit offset while the tilt mirror is being turned; the engine measures it in frame after frame.

        Parameters
        ----------
        draft : Draft
            What is known so far; only where to hold the line is taken from it, and the background.
        go_on : callable
            Asked before each; False ends it.

        Yields
        ------
        int
            Frames measured so far.
        SlitOffset or MeasurementError
            What the newest shows, or why it shows nothing.

        Raises
        ------
        DeviceError
            If camera or mirror fail.
        """
        client = self._client
        client.prepare(TARGETS[Step.OFFSET]).result()
        try:
            old = client.newest_offset(-1).result()
            first = seen = 0 if old is None else old[0]
            followed = client.follow_offset(self._middle(draft), draft.calibration.background)
            try:
                while go_on() and not followed.done():
                    newest = client.newest_offset(seen).result()
                    if newest is not None:
                        seen, found = newest
                        yield seen - first, found
            finally:
                client.cancel().result()
                followed.result()
        finally:
            client.prepare(None).result()

    def _middle(self, draft: Draft) -> float:
        """Voltage that puts the line onto the middle of the bundle."""
        known = draft.calibration
        if known.galvo is not None and known.bundle is not None:
            return float(known.galvo.volts(known.bundle.confocal_centre[0]))
        galvo = draft.found.get(Step.GALVO)
        if isinstance(galvo, GalvoMap):
            return float(np.mean(galvo.volts[galvo.used]))
        if self._span is None:
            self._span = self._client.find_span().result()
        return sum(self._span) / 2

    def _whole_span(self, draft: Draft) -> tuple[float, float]:
        """Voltages that sweep the line over the whole bundle; searched, if nothing is known."""
        known = draft.calibration
        if known.galvo is not None and known.bundle is not None:
            centre, reach = known.bundle.confocal_centre[0], 0.55 * known.bundle.diameter_px
            first, last = (float(known.galvo.volts(row)) for row in (centre - reach, centre + reach))
            return min(first, last), max(first, last)
        self._span = self._client.find_span().result()
        return self._span
