"""Cache of prepared frames: the ones that were used last."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.registration.pair_registration import PreparedFrame, Registrar


class RecentFrames:
    """The prepared frames that were used last; used by one thread.

    Parameters
    ----------
    registrar : Registrar
        Prepares them.
    limit : int
        How many are held; the memory of the least recently used one is used again.
    """

    def __init__(self, registrar: Registrar, limit: int) -> None:
        self._registrar, self._limit = registrar, limit
        self._views: OrderedDict[int, PreparedFrame] = OrderedDict()

    def get(self, index: int) -> PreparedFrame | None:
        """Return a prepared frame if it is held.

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
        """Prepare and hold a frame whose image `fill` writes into an array.

        Parameters
        ----------
        index : int
            Of the frame.
        fill : callable
            Writes its image into an array.
        """
        view = self._views.popitem(last=False)[1] if len(self._views) >= self._limit else self._registrar.view()
        fill(view.image)
        self._views[index] = self._registrar.prepare(view)
        return view
