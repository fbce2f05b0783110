"""Layers of a comparison: images side by side with a line across all of them; the user's layers are restored after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from napari.layers import Image, Points, Shapes
from napari.utils import Colormap

from napari_elsplus._view import HiddenLayers, answer, fit_visible_layers
from napari_elsplus.viewing.common_axes import adopt_axes, reference_axes
from napari_elsplus.viewing.layers import GAP_PX, SMOOTH, TITLE_RISE, titles_layer
from napari_elsplus.viewing.provenance import provenance_of
from napari_elsplus.viewing.stack import attributes, provenance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import napari.viewer
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.viewing.lazy import LazyPlanes
    from napari_elsplus.viewing.stack import Stack

    Line = tuple[tuple[float, float], tuple[float, float]]

PREFIX: Final = "compare"
LINE_COLOUR: Final = "#f0e442"
SIGNED: Final = Colormap([[0.34, 0.71, 0.91], [0, 0, 0], [0.9, 0.62, 0]], name="ELS+ difference")
"""Blue below zero, orange above, black at zero: colour-blind safe."""
_LINE_SHARE: Final = (0.15, 0.85)
"""Ends of the first line, fractions of an image's width; chosen, inside the bundle."""
_MIN_LINE_SHARE: Final = 0.05
"""Shortest line that is drawn on purpose, fraction of an image's width; a click makes one of some pixels. Chosen."""


@dataclass(frozen=True)
class ComparedImage:
    """One of the compared images.

    Attributes
    ----------
    title : str
        Its title.
    planes : LazyPlanes
        (T, n, n), of one size in a comparison.
    colour : str
        Colour of its title.
    signed : bool
        Use a colormap symmetric about zero.
    """

    title: str
    planes: LazyPlanes
    colour: str
    signed: bool = False


class ComparisonLayers:
    """Layers of a comparison in the user's viewer.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer.
    line_moved : callable
        Called after the user has drawn or moved the line.
    """

    def __init__(self, viewer: napari.viewer.Viewer, line_moved: Callable[[], None]) -> None:
        self._viewer = viewer
        self._line_moved = line_moved
        self._hidden = HiddenLayers(viewer)
        self._offsets_px: list[int] = []
        self._side = 0
        self._line: Shapes | None = None
        self._titles: Points | None = None
        self._title_texts: list[str] = []
        self._setting_line = False
        self.images: list[Image] = []

    @property
    def _line_px(self) -> float:
        """Width of the line, pixels of the images; visible also where they are small on the screen."""
        return max(1.0, self._side / 100)

    @property
    def intact(self) -> bool:
        """True while all of its layers are in the viewer."""
        return all(layer in self._viewer.layers for layer in self._layers())

    @property
    def line(self) -> Line | None:
        """Ends of the line, (row, col) in pixels of the images; None if the user removed it."""
        if self._line is None or not len(self._line.data):
            return None
        (row, col), (row_end, col_end) = np.asarray(self._line.data[0])[:, -2:].tolist()
        return (row, col), (row_end, col_end)

    def begin(
        self,
        images: Sequence[ComparedImage],
        stack: Stack,
        calibration: Calibration,
        *,
        apart: bool = True,
        line: Line | None = None,
    ) -> None:
        """Hide the user's layers and display the images; the window answers after each of them.

        Parameters
        ----------
        images : sequence of ComparedImage
            From left to right.
        stack : Stack
            Recording they were made from; gives the first axis.
        calibration : Calibration
            Gives the scale.
        apart : bool
            Side by side; otherwise all in one place.
        line : tuple, optional
            Ends of the line, (row, col) in pixels of the images; across the middle if there is none.
        """
        self._hidden.hide()
        answer()
        self._side = images[0].planes.shape[-1]
        self._offsets_px = [index * (self._side + GAP_PX) if apart else 0 for index in range(len(images))]
        made = self._made(images, stack, calibration, line)
        while self._hidden.active and (layer := next(made, None)) is not None:
            self._viewer.layers.append(layer)
            answer()
        if self._hidden.active:
            fit_visible_layers(self._viewer)  # not ended while the window answered

    def hide_opened(self) -> None:
        """Hide images of recordings that were opened during the comparison; they are shown at its end."""
        layers, ours = self._viewer.layers, self._layers()
        opened = [one for one in layers if one not in ours and provenance_of(one.metadata).get("stack") is not None]
        if any(layer.visible for layer in opened):
            self._hidden.hide([layer for layer in layers if layer not in opened])

    def end(self) -> None:
        """Remove the images and the line, and restore the user's layers."""
        ours, self.images, self._line, self._titles = self._layers(), [], None, None
        for layer in ours:
            if layer in self._viewer.layers:
                self._viewer.layers.remove(layer)
                answer()
        self._hidden.restore()
        answer()

    def set_line(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Draw the line on every image.

        Parameters
        ----------
        start, end : tuple of float
            (row, col) in pixels of the images.
        """
        if self._line is None:
            return
        own, mode = np.array([start, end], np.float64), self._line.mode
        self._setting_line = True
        try:
            self._line.data = [(own + np.array([0, offset]), "line") for offset in dict.fromkeys(self._offsets_px)]
            self._line.edge_width = [self._line_px] * len(self._line.data)  # napari makes new ones 1 wide
            self._line.mode = mode
        finally:
            self._setting_line = False

    def show_next(self) -> None:
        """Display one image alone, the next one at each call."""
        lit = [index for index, image in enumerate(self.images) if image.visible]
        chosen = 0 if len(lit) != 1 else (lit[0] + 1) % len(self.images)
        for index, image in enumerate(self.images):
            image.visible = index == chosen
        if self._titles is not None:
            self._titles.text.string = [title if k == chosen else "" for k, title in enumerate(self._title_texts)]

    def set_title_colours(self, colours: Sequence[str]) -> None:
        """Set the colours of the titles, one for each image."""
        if self._titles is not None:
            self._titles.text.color = list(colours)

    def _layers(self) -> list[Image | Shapes | Points]:
        marks = (self._titles, self._line)
        return [*self.images, *(mark for mark in marks if mark is not None)]

    def _made(
        self, images: Sequence[ComparedImage], stack: Stack, calibration: Calibration, line: Line | None
    ) -> Iterator[Image | Points | Shapes]:
        """Make the layers, one after the other; the line last, in the mode in which the mouse draws another."""
        for one, offset in zip(images, self._offsets_px, strict=True):
            options = attributes(stack, one.title, calibration, origin_px=(0, offset))
            options["name"] = f"{PREFIX} {one.title}"
            options["metadata"] = provenance(stack, options["name"], calibration, None)
            options, _ = adopt_axes(options, reference_axes(self._viewer.layers))
            image = Image(
                one.planes.dask(), cache=False, colormap=SIGNED if one.signed else "gray",
                interpolation2d=SMOOTH, **options,
            )  # fmt: skip
            image.colorbar.visible = one.signed  # its grey levels are compared, those of the others are scaled
            image.colorbar.position = "top_right" if self.images else "top_left"  # on the side of its image
            self.images.append(image)
            yield image
        place = {key: options[key][1:] for key in ("scale", "units", "axis_labels")}
        self._title_texts = [one.title for one in images]
        corners = [(-TITLE_RISE * self._side, offset) for offset in self._offsets_px]
        colours = [one.colour for one in images]
        data, words, _ = titles_layer(f"{PREFIX} titles", self._title_texts, corners, place, colours)
        self._titles = Points(data, **words)
        self._titles.editable = False
        yield self._titles
        middle = (self._side - 1) / 2
        start, end = line or ((middle, share * self._side) for share in _LINE_SHARE)
        self._line = Shapes(
            [np.array([start, end])], shape_type="line", name=f"{PREFIX} line", edge_width=self._line_px,
            edge_color=LINE_COLOUR, **place,
        )  # fmt: skip
        self._line.events.data.connect(self._line_changed)
        self.set_line(start, end)
        yield self._line
        self._line.mode = "add_line"

    def _line_changed(self, event: Any) -> None:
        """Copy the line that was drawn or moved last to every image; a click draws none."""
        if self._setting_line or self._line is None or str(event.action) not in ("added", "changed"):
            return
        if len(self._line.data):
            chosen = event.data_indices[-1] if event.data_indices else -1
            drawn = np.asarray(self._line.data[chosen])[:, -2:]
            short = np.hypot(*(drawn[1] - drawn[0])) < _MIN_LINE_SHARE * self._side
            if short and str(event.action) == "added" and self.line is not None:
                self.set_line(*self.line)
                return
            self._repeat_line(drawn)
        self._line_moved()

    def _repeat_line(self, line: NDArray[np.float64]) -> None:
        """Copy a line from the image on which it was drawn to all of them."""
        panel = int(np.clip(line[:, 1].mean() // (self._side + GAP_PX), 0, len(self._offsets_px) - 1))
        (row, col), (row_end, col_end) = line - np.array([0, self._offsets_px[panel]])
        self.set_line((row, col), (row_end, col_end))
