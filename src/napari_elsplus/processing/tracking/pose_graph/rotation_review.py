"""Test for rotation over all registrations of a finished track.

While frames come, rotation is tested for now and then and modelled from when it is found. At the end a rotation can be
found that was too slow; the pose graph then estimates the angles of the edges from before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.processing.tracking.registration.model_selection import selected_model

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
    from napari_elsplus.processing.tracking.registration.motion_models import MotionModel
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

    Found = tuple[int, int, Displacement, PairRegistration]

_MAX_TESTED: Final = 600
"""Registrations that are tested; chosen: some 0.2 s."""
_LOOSE: Final = (0.01, 0.01)
"""Standard deviations of stretch and shear; chosen, above what velocities leave open."""


def review_rotation(links: Sequence[Found], registrar: Registrar, view: Callable[[int], PreparedFrame]) -> MotionModel:
    """Return the motion model that all registrations together select.

    Parameters
    ----------
    links : sequence of tuple
        The tracker's registrations; at most :data:`_MAX_TESTED` of them are tested, evenly chosen.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared frame of an index.
    """
    keys = {earlier for earlier, _, _, _ in links}
    between = [found for found in links if found[1] in keys]  # others share a keyframe, and its errors
    chosen = between[:: -(-len(between) // _MAX_TESTED) or 1]
    asked = [(registrar.remainder(view(a), view(b), link.warp, _LOOSE), link) for a, b, _, link in chosen]
    every = [found for found, _ in asked if found is not None]
    sure = [found for found, link in asked if found is not None and link.tells_turn]
    return min(selected_model(every), selected_model(sure))
