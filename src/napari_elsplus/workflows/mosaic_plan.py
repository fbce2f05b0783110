"""What is made of the frames of a moving probe: which images, tracked and laid how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.workflows.tracking import Method

TRACKED_FIRST: Final = (Mode.ELS, Mode.LS, Mode.RESIDUAL, Mode.ELSA)
"""Of the modes that are asked for, the first of these is tracked; the others are laid along its track."""


@dataclass(frozen=True)
class MosaicPlan:
    """What is made of a stack, or of the live stream.

    Parameters
    ----------
    modes : tuple of Mode
        At least one.
    method : Method
        How the probe is tracked.
    insertion : Insertion
        How frames are laid over one another.
    """

    modes: tuple[Mode, ...] = (Mode.ELS,)
    method: Method = Method.ELSPLUS
    insertion: Insertion = Insertion.DEAD_LEAF

    @property
    def tracked(self) -> Mode:
        """The mode that is tracked.

        Raises
        ------
        InputError
            If none is asked for.
        """
        found = next((mode for mode in TRACKED_FIRST if mode in self.modes), None)
        if found is None:
            raise InputError("no image is chosen", "tick LS, ELSA or ELS+")
        return found
