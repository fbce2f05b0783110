"""A script that scans with a rig which it opened itself, as anyone would write it.

Run as ``python -m napari_elsplus.diagnosis.rehearsal.script``.
"""

from __future__ import annotations

import time
from typing import Final

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.diagnosis.rehearsal.engine import open_rehearsed
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.instrument.optics import PRESETS

SECONDS: Final = 60.0
"""Seconds for which it scans, unless it is killed."""

if __name__ == "__main__":
    rig = open_rehearsed(SIMULATED)
    assert rig.bench is not None
    with Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        engine.use(rig.bench.optics.calibration(PRESETS["240hz"]))
        engine.start()
        time.sleep(SECONDS)
