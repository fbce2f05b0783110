"""Test for rotation over all registrations of a finished track, and their correction for it.

While frames come, rotation is tested for now and then and modelled from when it is found. At the end a rotation can be
found that was too slow, and the angles of the registrations from before are estimated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.motion.motion_prior import MotionPrior
from napari_elsplus.processing.tracking.registration.model_selection import selected_model
from napari_elsplus.processing.tracking.registration.motion_models import MotionModel, angle_of, composed, scale_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.motion.rolling_shutter import Displacement
    from napari_elsplus.processing.tracking.registration.pair_registration import (
        PairRegistration,
        PreparedFrame,
        Registrar,
    )

    Found = tuple[int, int, Displacement, PairRegistration]

LARGE_TURN: Final = 0.004
"""Angle from which frames are registered again instead of being corrected by a linear step, radians; derived: half a
pixel at the rim."""
_MAX_TESTED: Final = 600
"""Registrations that are tested; chosen: some 0.2 s."""
_LOOSE: Final = (0.01, 0.01)
"""Standard deviations of stretch and shear; chosen, above what velocities leave open."""
_VELOCITY_SIGMA_PX: Final = 2.0
_SHIFT_SIGMA_PX: Final = 8.0
"""Standard deviations of velocities (per frame period) and of the displacement without a rotation, pixels; chosen,
above what a rotation that was left out makes."""


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


def turned_links(
    links: Sequence[Found],
    poses: list[Pose],
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    model: MotionModel,
) -> list[Found]:
    """Return the registrations with their angles; correct the velocities of their later frames.

    Parameters
    ----------
    links : sequence of tuple
        The tracker's registrations.
    poses : list of Pose
        Modified in place.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared frame of an index.
    model : MotionModel
        Model beside translations.
    """
    scratch = registrar.view()
    return [_turned(found, poses, registrar, view, model, scratch) for found in links]


def _turned(
    found: Found,
    poses: list[Pose],
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    model: MotionModel,
    scratch: PreparedFrame,
) -> Found:
    earlier, later, moved, link = found
    if np.isfinite(link.turn_sigma):
        return found
    shutter = registrar.grid.shutter
    before, after = view(earlier), view(later)
    more = registrar.remainder(before, after, link.warp, _LOOSE)
    if more is None:
        return found
    warp, form = composed(link.warp, more.step[model])
    turned = link._replace(warp=warp, turn=-angle_of(form), zoom=1 / scale_of(form), turn_sigma=float(more.sigma[0]))
    if abs(turned.turn) > LARGE_TURN:
        velocities = poses[earlier].velocity, poses[later].velocity
        motion = MotionPrior.between(velocities, moved, _VELOCITY_SIGMA_PX, _SHIFT_SIGMA_PX, shutter)
        again = registrar.turned_link(before, after, motion, (turned.turn, turned.zoom), model, scratch)
        turned = turned if again is None or not again.observed else again
    if later == earlier + 1:
        poses[later] = poses[later]._replace(velocity=shutter.velocities(turned.warp)[1])
    return earlier, later, shutter.displacement(turned.warp, poses[later].velocity), turned
