"""Plan of a mosaic: image types, tracking method and insertion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.registry import Method

TRACKED_FIRST: Final = (Mode.ELS, Mode.LS, Mode.RESIDUAL, Mode.ELSA)
"""Of the chosen modes the first in this order is tracked; the others are inserted along its track."""


@dataclass(frozen=True)
class MosaicPlan:
    """Image types, tracking method and insertion of the mosaics of a stack or of the live stream.

    Parameters
    ----------
    modes : tuple of Mode
        At least one.
    method : str
        Name of the tracking method: "elsplus", "paper", or one that was registered.
    insertion : Insertion
        How overlapping frames are combined.
    """

    modes: tuple[Mode, ...] = (Mode.ELS,)
    method: str = Method.ELSPLUS
    insertion: Insertion = Insertion.DEAD_LEAF

    @property
    def tracked(self) -> Mode:
        """The image type to track.

        Raises
        ------
        InputError
            If no mode is chosen.
        """
        found = next((mode for mode in TRACKED_FIRST if mode in self.modes), None)
        if found is None:
            raise InputError("no image is chosen", "tick LS, ELSA or ELS+")
        return found
