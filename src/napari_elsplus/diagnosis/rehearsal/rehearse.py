"""The faults that can be rehearsed."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from napari_elsplus.diagnosis.rehearsal.faults import camera_and_disk, card, commands, processes
from napari_elsplus.diagnosis.rehearsal.registry import FAULTS, RehearsedFault
from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

REGISTERING = (card, camera_and_disk, processes, commands)
"""Modules whose functions register themselves when they are imported."""


def faults(names: Sequence[str] = ()) -> list[RehearsedFault]:
    """Return the faults of some names, all that this system can play by default.

    Raises
    ------
    InputError
        If there is no fault of a name.
    """
    unknown = [name for name in names if name not in FAULTS]
    if unknown:
        raise InputError(f"there is no fault {unknown[0]}", f"choose of {', '.join(FAULTS)}")
    if names:
        return [FAULTS[name] for name in names]
    return [fault for fault in FAULTS.values() if not (fault.posix and sys.platform == "win32")]
