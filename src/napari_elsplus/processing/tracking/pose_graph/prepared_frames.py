"""Prepared views of many frames, of which memory holds the few that were asked for last."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar


class RecentFrames:
    """The views that were asked for last; used by one thread.

    Parameters
    ----------
    registrar : Registrar
        Prepares them.
    most : int
        How many are held; the memory of the one that was not asked for longest is used again.
    """

    def __init__(self, registrar: Registrar, most: int) -> None:
        self._registrar, self._most = registrar, most
        self._views: OrderedDict[int, PreparedFrame] = OrderedDict()

    def get(self, index: int) -> PreparedFrame | None:
        """Return a frame's view if it is held.

        Parameters
        ----------
        index : int
            Of the frame.
        """
        if index not in self._views:
            return None
        self._views.move_to_end(index)
        return self._views[index]

    def add(self, index: int, fill: Callable[[NDArray[np.float32]], object]) -> PreparedFrame:
        """Prepare and hold the view of a frame, whose image `fill` writes into an array.

        Parameters
        ----------
        index : int
            Of the frame.
        fill : callable
            Writes its image into an array.
        """
        view = self._views.popitem(last=False)[1] if len(self._views) >= self._most else self._registrar.view()
        fill(view.image)
        self._views[index] = self._registrar.prepare(view)
        return view
