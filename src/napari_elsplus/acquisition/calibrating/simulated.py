"""What a user does at a real rig's tip, done for the simulated one: targets for its calibration, tissue afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.acquisition.calibrating.whole import Target, calibrate_rig
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.hardware.virtual.frame_source import Circle
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, fibres, uniform

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.calibrating.procedures import Watch
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.processing.calibration.calibrate import Findings
    from napari_elsplus.processing.calibration.lag import ScanLag

PATH: Final = Circle(diameter_um=800.0, period_s=1.75)
"""How the probe moves over the tissue; 420 frames at 240 Hz, which then come again."""
QUICK_VOLTAGES: Final = 60
"""Steps of the sweep: enough for 0.05 rows, and over in seconds."""


def open_live(name: str, *, own_process: bool = False) -> Rig:
    """Open a rig for live images; the simulated one looks at moving lens tissue.

    Parameters
    ----------
    name : str
        One of :func:`napari_elsplus.hardware.rigs.rig_names`.
    own_process : bool
        Whether the simulated card outlives this process, as a real one does, so that a guardian has something to park.

    Raises
    ------
    InputError
        If there is no such rig, or its file is wrong.
    DeviceError
        If a device is absent, busy or fails.
    """
    if name != SIMULATED:
        return open_rig(name)
    return open_rig(name, Simulation(scene=fibres(), trajectory=PATH, own_process=own_process))


def calibrate_simulated(
    rig: Rig, engine: Engine, *, voltages: int = QUICK_VOLTAGES, watch: Callable[[str], Watch] = lambda _: iter
) -> tuple[Findings, ScanLag]:
    """Calibrate the simulated rig by itself, and put the probe onto moving lens tissue.

    Parameters and results are those of :func:`napari_elsplus.acquisition.calibrating.whole.calibrate_rig`.

    Raises
    ------
    InputError
        If the rig is a real one.
    """
    bench = rig.bench
    if bench is None:
        raise InputError(f"the rig {rig.name} cannot calibrate itself", "give a calibration with -c")

    def prepare(target: Target) -> None:
        match target:
            case Target.FAR_END_LIT:
                bench.optics.show(distal_light())
            case Target.FLUORESCENT:
                bench.optics.show(uniform())
            case Target.DARK_TUBE:
                bench.optics.show(empty())

    found = calibrate_rig(engine, prepare, voltages=voltages, watch=watch)
    bench.optics.show(fibres(), PATH)
    return found
