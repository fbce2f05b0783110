"""A rig and its live engine, opened together in this process."""

from __future__ import annotations

import gc

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.live_engine import live_engine
from napari_elsplus.hardware.rig import SIMULATED


def test_memory_of_a_live_rig_is_excluded_from_garbage_collection() -> None:
    """A full collection took tenths of a second, in which calls to the card did not return."""
    before = gc.get_freeze_count()
    with live_engine(SIMULATED, Settings()):
        assert gc.get_freeze_count() > before
    assert gc.get_freeze_count() == 0
