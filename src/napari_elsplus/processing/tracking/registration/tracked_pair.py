"""A registration that was accepted, with the frames that it belongs to."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
    from napari_elsplus.processing.tracking.registration.pair_registration import PairRegistration


class TrackedPair(NamedTuple):
    """A registration that the tracker has accepted.

    Parameters
    ----------
    earlier, later : int
        The two frames, by the tracker's count.
    displacement : Displacement
        Of the later frame from the earlier one, in the later one's orientation, pixels.
    registration : PairRegistration
        Of the two.
    """

    earlier: int
    later: int
    displacement: Displacement
    registration: PairRegistration
