"""Options of the command ``calibrate`` by which steps take recorded frames; imports nothing that computes."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Final, NamedTuple

ENTRY_POINTS: Final = "napari_elsplus.calibration_steps"
"""Group of the entry points by which installed packages add steps; each names a CalibrationStep."""


class FileOption(NamedTuple):
    """An option that names a file of a step's frames: ``--NAME``, and its help."""

    name: str
    help: str


OFFSET: Final = FileOption("line", "Frames of the laser line standing near the middle of the bundle.")
GALVO: Final = FileOption("sweep", "A frame per voltage, the line standing.")
PAIR: Final = FileOption("bundle", "Frames of the bundle lit from its far end.")
BACKGROUND: Final = FileOption("background", "Frames of a dark tube, laser on; the paper takes 50.")
FLAT: Final = FileOption("flat", "Frames of a uniform scene; the bundle's image serves if it is not given.")

FILE_OPTIONS: Final = {"offset": OFFSET, "galvo": GALVO, "pair": PAIR, "background": BACKGROUND, "flat": FLAT}
"""Options of this package's steps, by the key of the step."""
OWN_STEPS: Final = frozenset({*FILE_OPTIONS, "lag"})
"""Keys of this package's steps; the scan lag is measured live only."""


@cache
def added_steps() -> EntryPoints:
    """Return the entry points of the steps of installed packages; all packages are searched once, which takes 4 ms."""
    return entry_points(group=ENTRY_POINTS)
