"""Whether the probe turned, asked once more of all links when the track is finished, and what it did to them.

While frames come in, rotation is asked for now and then and modelled from when it shows. At the end a turn can be seen
that was too slow to show, and the links from before it showed can be told how far they were turned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.tracking.registration.model_selection import asked_for
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
"""Angle, in radians, from which a link is made anew instead of being corrected by a linear step."""
_MOST_ASKED: Final = 600
_LOOSE: Final = (0.01, 0.01)


def review_rotation(links: Sequence[Found], registrar: Registrar, view: Callable[[int], PreparedFrame]) -> MotionModel:
    """Return what all links together ask for.

    Parameters
    ----------
    links : sequence of tuple
        The tracker's links; at most 600 of them are asked, evenly chosen.
    registrar : Registrar
        Of the same grid.
    view : callable
        Returns the prepared view of a frame by its index.
    """
    keys = {earlier for earlier, _, _, _ in links}
    between = [found for found in links if found[1] in keys]  # those to other frames share a key frame, and its errors
    chosen = between[:: -(-len(between) // _MOST_ASKED) or 1]
    asked = [(registrar.remainder(view(a), view(b), link.warp, _LOOSE), link) for a, b, _, link in chosen]
    every = [found for found, _ in asked if found is not None]
    sure = [found for found, link in asked if found is not None and link.tells_turn]
    return min(asked_for(every), asked_for(sure))


def turned_links(
    links: Sequence[Found],
    poses: list[Pose],
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    rung: MotionModel,
) -> list[Found]:
    """Tell links that were made without it how far they are turned; correct their later frames' velocities.

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
    rung : MotionModel
        Model beside translations.
    """
    scratch = registrar.view()
    return [_turned(found, poses, registrar, view, rung, scratch) for found in links]


def _turned(
    found: Found,
    poses: list[Pose],
    registrar: Registrar,
    view: Callable[[int], PreparedFrame],
    rung: MotionModel,
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
    warp, form = composed(link.warp, more.step[rung])
    turned = link._replace(warp=warp, turn=-angle_of(form), zoom=1 / scale_of(form), turn_sigma=float(more.sigma[0]))
    if abs(turned.turn) > LARGE_TURN:
        velocities = poses[earlier].velocity, poses[later].velocity
        anew = registrar.turned_link(
            before, after, (*moved, turned.turn, turned.zoom), velocities, _LOOSE, rung, scratch
        )
        turned = turned if anew is None or not anew.observed else anew
    if later == earlier + 1:
        poses[later] = poses[later]._replace(velocity=shutter.velocities(turned.warp)[1])
    return earlier, later, shutter.displacement(turned.warp, poses[later].velocity), turned
