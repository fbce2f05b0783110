"""Enhanced line-scan (ELS+) fibre-bundle endomicroscopy in napari.

One camera frame holds two images of the bundle: one with the rolling-shutter slit on the laser line (confocal, LS), one
with the slit a few rows away from it (residual). Confocal minus residual is ELS+ (Thrapp and Hughes, 2021).

The names in ``__all__`` are the public interface. Each is imported when it is first used: the package itself is quick.

>>> import napari_elsplus as elsplus
>>> recording = elsplus.simulate_recording(frames=2)
>>> elsplus.section(recording, recording.calibration, "els")[:].shape
(2, 467, 467)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from napari_elsplus.acquisition.live_engine import open_engine as open_engine
    from napari_elsplus.acquisition.streaming.recorder import RecordingPlan as RecordingPlan
    from napari_elsplus.hardware.rigs import open_rig as open_rig
    from napari_elsplus.instrument.calibration import Calibration as Calibration
    from napari_elsplus.io.calibrations import read_calibration as load_calibration
    from napari_elsplus.io.calibrations import write_calibration as save_calibration
    from napari_elsplus.io.recordings import open_recording as open_recording
    from napari_elsplus.workflows.axial import measure_axial_response as measure_axial_response
    from napari_elsplus.workflows.batch.run import batch as batch
    from napari_elsplus.workflows.calibration import calibrate as calibrate
    from napari_elsplus.workflows.comparison import compare as compare
    from napari_elsplus.workflows.mosaicing import mosaic as mosaic
    from napari_elsplus.workflows.mosaicing import track as track
    from napari_elsplus.workflows.recommendation.recommend import recommend as recommend
    from napari_elsplus.workflows.sectioning import section as section
    from napari_elsplus.workflows.simulated import simulate_axial_scan as simulate_axial_scan
    from napari_elsplus.workflows.simulated import simulate_calibration as simulate_calibration
    from napari_elsplus.workflows.simulated import simulate_recording as simulate_recording

__version__ = "0.1.0"

_PLACES = {
    "Calibration": "instrument.calibration:Calibration",
    "RecordingPlan": "acquisition.streaming.recorder:RecordingPlan",
    "batch": "workflows.batch.run:batch",
    "calibrate": "workflows.calibration:calibrate",
    "compare": "workflows.comparison:compare",
    "load_calibration": "io.calibrations:read_calibration",
    "measure_axial_response": "workflows.axial:measure_axial_response",
    "mosaic": "workflows.mosaicing:mosaic",
    "open_engine": "acquisition.live_engine:open_engine",
    "open_recording": "io.recordings:open_recording",
    "open_rig": "hardware.rigs:open_rig",
    "recommend": "workflows.recommendation.recommend:recommend",
    "save_calibration": "io.calibrations:write_calibration",
    "section": "workflows.sectioning:section",
    "simulate_axial_scan": "workflows.simulated:simulate_axial_scan",
    "simulate_calibration": "workflows.simulated:simulate_calibration",
    "simulate_recording": "workflows.simulated:simulate_recording",
    "track": "workflows.mosaicing:track",
}
"""Module below this one, and name in it, of each public name (PEP 562)."""

__all__ = [
    "Calibration",
    "RecordingPlan",
    "batch",
    "calibrate",
    "compare",
    "load_calibration",
    "measure_axial_response",
    "mosaic",
    "open_engine",
    "open_recording",
    "open_rig",
    "recommend",
    "save_calibration",
    "section",
    "simulate_axial_scan",
    "simulate_calibration",
    "simulate_recording",
    "track",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), attribute)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACES})
