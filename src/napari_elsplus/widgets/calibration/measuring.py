"""What the Calibration panel does in a thread: measure a step live, from a file, or on and on."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.io import open_recording, read_volts
from napari_elsplus.processing.calibration.stepwise import measure_step, setup_of
from napari_elsplus.viewing.calibration_script import MeasurementSource
from napari_elsplus.widgets.calibration.pictures import picture
from napari_elsplus.widgets.calibration.session import ShownResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from napari_elsplus.acquisition.link.guided_calibration import GuidedCalibration
    from napari_elsplus.processing.calibration.draft import Draft, Step

LOOK_S: Final = 0.04
"""The engine measures the offset in every frame; nobody reads more than so often."""


def measure_live(
    guided: GuidedCalibration, step: Step, draft: Draft, target_um: float, source: MeasurementSource
) -> ShownResult:
    """Measure a step on the rig.

    Raises
    ------
    ElsPlusError
        As :meth:`~napari_elsplus.acquisition.link.guided_calibration.GuidedCalibration.measure`.
    """
    setup = guided.setup()
    found = guided.measure(step, draft)
    return ShownResult(found, setup, picture(found, draft, setup, target_um), source)


def measure_recorded(
    path: Path,
    volts: Path | None,
    step: Step,
    draft: Draft,
    target_um: float,
    watch: Callable[[Iterable[int]], Iterable[int]],
) -> ShownResult:
    """Measure a step from a recording.

    Raises
    ------
    InputError
        If the recording is empty, or the step cannot be measured from it.
    MeasurementError
        If it finds nothing.
    """
    with open_recording(path) as frames:
        if len(frames) == 0:
            raise InputError(f"{path.name} holds 0 frames", "choose another file")
        setup = setup_of(frames)
        found = measure_step(step, frames, draft, None if volts is None else read_volts(volts), watch)
    return ShownResult(found, setup, picture(found, draft, setup, target_um), MeasurementSource(step, path, volts))


class Watching:
    """The slit offset again and again, while the tilt mirror is being turned.

    Parameters
    ----------
    guided : GuidedCalibration
        On the rig.
    draft : Draft
        What is known so far.
    target_um : float
        Slit offset that is wanted.
    source : MeasurementSource
        Where the frames come from.

    Attributes
    ----------
    target_um : float
        May be changed meanwhile.
    readings : int
        How many were taken with :meth:`newest`.
    """

    def __init__(self, guided: GuidedCalibration, draft: Draft, target_um: float, source: MeasurementSource) -> None:
        self._guided, self._draft, self._source = guided, draft, source
        self._goes_on = True
        self._newest: ShownResult | str | None = None
        self.target_um = target_um
        self.readings = 0

    def run(self) -> None:
        """Measure until :meth:`stop`; in a thread.

        Raises
        ------
        DeviceError
            If camera or mirror fail.
        """
        setup, begun_s = self._guided.setup(), perf_counter()
        for count, found in self._guided.watch_offset(self._draft, lambda: self._goes_on):
            if count == 1:
                begun_s = perf_counter()
            if isinstance(found, MeasurementError):
                self._newest = str(found)
            else:
                shown = picture(found, self._draft, setup, self.target_um)
                if count > 1:
                    rate = f"{(count - 1) / max(perf_counter() - begun_s, 1e-3):.0f} measurements a second"
                    shown = replace(shown, lines=[*shown.lines, rate])
                self._newest = ShownResult(found, setup, shown, self._source)
            sleep(LOOK_S)

    def stop(self) -> None:
        """Measure no more."""
        self._goes_on = False

    def newest(self) -> ShownResult | str | None:
        """Return what was found since the last call, or why nothing was; None if nothing is new."""
        newest, self._newest = self._newest, None
        self.readings += isinstance(newest, ShownResult)
        return newest
