"""What is shown live: how images are made of frames, and the ring that napari looks into."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.acquisition.engine.live_images import LiveImages, LiveView
from napari_elsplus.acquisition.engine.workers import Shown
from napari_elsplus.acquisition.streaming.ring import Ring

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.streaming.ring import Layout
    from napari_elsplus.instrument.calibration import Calibration


def on_the_heap(layout: Layout) -> tuple[str, Ring]:
    """Make a display ring that only this process sees."""
    return "", Ring(bytearray(layout.nbytes), layout)


class Display:
    """Images of the newest frames in a ring; another ring only where the images have another layout.

    Parameters
    ----------
    make_ring : callable
        Makes a ring, and says its name.

    Attributes
    ----------
    shown : Shown or None
        How images are made and the ring for them; None until the first :meth:`renew`.
    where : tuple or None
        Name and layout of the ring, for whoever looks into it.
    """

    def __init__(self, make_ring: Callable[[Layout], tuple[str, Ring]]) -> None:
        self._make_ring = make_ring
        self._retired: list[Ring] = []
        self.shown: Shown | None = None
        self.where: tuple[str, Layout] | None = None

    def renew(self, frame_shape: tuple[int, int], calibration: Calibration | None, view: LiveView) -> Shown:
        """Build how images are made anew.

        Raises
        ------
        CalibrationError
            If the calibration does not fit the frames, or lacks what the view needs; nothing has changed then.
        """
        images = LiveImages(frame_shape, calibration, view)
        if self.shown is not None and self.where is not None and self.where[1] == images.layout:
            ring = self.shown.ring
        else:
            if self.shown is not None:
                self._retired.append(self.shown.ring)
            name, ring = self._make_ring(images.layout)
            self.where = (name, images.layout)
        self.shown = Shown(images, ring)
        return self.shown

    def forget_retired(self) -> None:
        """Let go of rings that nobody fills any more; only while no frames stream."""
        while self._retired:
            self._retired.pop().close()

    def close(self) -> None:
        """Let go of every ring."""
        self.forget_retired()
        if self.shown is not None:
            self.shown.ring.close()
        self.shown = self.where = None
