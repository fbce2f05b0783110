"""The live display: images of the newest frames in a ring from which napari copies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.acquisition.engine.live_images import LiveImages, LiveView
from napari_elsplus.acquisition.engine.workers import DisplaySink
from napari_elsplus.acquisition.streaming.ring import Ring

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.streaming.ring import Layout
    from napari_elsplus.instrument.calibration import Calibration


def on_the_heap(layout: Layout) -> tuple[str, Ring]:
    """Make a display ring of a layout in this process alone."""
    return "", Ring(bytearray(layout.nbytes), layout)


class Display:
    """Images of the newest frames in a ring, which is replaced where the images have another layout.

    Parameters
    ----------
    make_ring : callable
        Makes a ring of a layout, and returns its name and the ring.

    Attributes
    ----------
    sink : DisplaySink or None
        Makes the images, with their ring; None until the first :meth:`renew`.
    where : tuple or None
        Name and layout of the ring, for readers.
    """

    def __init__(self, make_ring: Callable[[Layout], tuple[str, Ring]]) -> None:
        self._make_ring = make_ring
        self._retired: list[Ring] = []
        self.sink: DisplaySink | None = None
        self.where: tuple[str, Layout] | None = None

    def renew(
        self, frame_shape: tuple[int, int], calibration: Calibration | None, view: LiveView | None
    ) -> DisplaySink:
        """Make the images of a frame shape by a calibration and a view from now on.

        Raises
        ------
        CalibrationError
            If the calibration does not fit the frames, or lacks what the view needs; nothing has changed then.
        OSError
            If there is no memory for the ring; nothing has changed then.
        """
        images = LiveImages(frame_shape, calibration, view)
        if self.sink is not None and self.where is not None and self.where[1] == images.layout:
            ring = self.sink.ring
        else:
            name, ring = self._make_ring(images.layout)
            if self.sink is not None:
                self._retired.append(self.sink.ring)
            self.where = (name, images.layout)
        self.sink = DisplaySink(images, ring)
        return self.sink

    def close_retired(self) -> None:
        """Close replaced rings; only while no frames stream."""
        while self._retired:
            self._retired.pop().close()

    def close(self) -> None:
        """Close every ring."""
        self.close_retired()
        if self.sink is not None:
            self.sink.ring.close()
        self.sink = self.where = None
