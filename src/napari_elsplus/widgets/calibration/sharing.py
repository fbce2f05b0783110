"""The panel's calibration and the one that all panels work by: each follows the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from concurrent.futures import Future
    from pathlib import Path

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.widgets.shared.connection import Connection


class Sharing:
    """Offers what was accepted, and notices what another panel has loaded or measured.

    Parameters
    ----------
    connection : Connection
        What the panels share.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._asked: Future[None] | None = None
        self._known: Calibration | None = None
        self._refused: BaseException | None = None

    def offer(self, calibration: Calibration, path: Path | None = None) -> None:
        """Let the other panels and the engine work by a calibration, once it says where the bundle is."""
        if calibration.bundle is None:
            return
        self._asked = self._connection.take(calibration, path)
        self._asked.add_done_callback(lambda done: setattr(self, "_refused", done.exception()))

    def refusal(self) -> BaseException | None:
        """Return what the engine had against the last offer, once."""
        refused, self._refused = self._refused, None
        return refused

    def news(self, own: Calibration) -> Calibration | None:
        """Return the calibration that all work by now, if it is new, and not one's own."""
        shared = self._connection.calibration
        if shared is self._known or not (self._asked is None or self._asked.done()):
            return None
        self._known = shared
        return None if shared is own else shared
