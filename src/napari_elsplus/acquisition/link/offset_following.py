"""The slit offset through an engine's client, again and again while the tilt mirror is being turned."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.errors import MeasurementError
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.processing.calibration.slit_offset import SlitOffset


def follow_offset(
    client: EngineClient, draft: Draft, keep_on: Callable[[], bool]
) -> Iterator[tuple[int, SlitOffset | MeasurementError]]:
    """Yield the newest slit offset, which the engine measures in frame after frame.

    Parameters
    ----------
    client : EngineClient
        With a rig that is open and configured.
    draft : Draft
        Results so far; the place of the line and the background are taken from it.
    keep_on : callable
        Called before each; False ends the measurement.

    Yields
    ------
    int
        Frames measured so far.
    SlitOffset or MeasurementError
        The newest offset, or the reason why there is none.

    Raises
    ------
    DeviceError
        If camera or galvo fail.
    """
    old = client.newest_offset(-1).result()
    first = seen = 0 if old is None else old[0]
    followed = client.follow_offset(draft)
    try:
        while keep_on() and not followed.done():
            newest = client.newest_offset(seen).result()
            if newest is not None:
                seen, found = newest
                yield seen - first, found
    finally:
        client.cancel().result()
        followed.result()
