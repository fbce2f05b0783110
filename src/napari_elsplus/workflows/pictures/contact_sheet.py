"""Contact sheet of a calibrated recording: raw frame with both views, LS, ELSA, ELS+, mosaics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.pictures.comparison import COLOURS, TITLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.workflows.pictures.comparison import ComparisonFigure


def draw_contact_sheet(
    raw: NDArray[np.integer | np.floating],
    calibration: Calibration,
    comparison: ComparisonFigure,
    mosaics: dict[Mode, NDArray[np.float32]],
) -> Figure:
    """Draw a raw frame with both bundles outlined, the images made of it, and the mosaics.

    Parameters
    ----------
    raw : numpy.ndarray
        Raw frame (rows, cols).
    calibration : Calibration
        With its bundle section.
    comparison : ComparisonFigure
        LS, ELSA and ELS+ of that frame.
    mosaics : dict
        Mode to mosaic (rows, cols) float32, 0 where nothing was inserted; LS and ELS+.
    """
    figure = Figure(figsize=(12, 14), layout="constrained")
    top, middle, bottom = figure.subfigures(3, 1, squeeze=False, height_ratios=[4.4, 3.9, 5.5])[:, 0]
    axes = {
        **top.subplot_mosaic([["raw"]]),
        **middle.subplot_mosaic([["ls", "elsa", "els"]]),
        **bottom.subplot_mosaic([["mosaic_ls", "mosaic_els"]]),
    }
    _draw_raw(axes["raw"], raw, calibration)
    for mode, title in TITLES.items():
        shown = np.where(comparison.inside, comparison.images[mode], 0)
        _show(axes[mode.value], shown, title, 1.0)
    for mode in (Mode.LS, Mode.ELS):
        mosaic = mosaics[mode]
        drawn = mosaic[mosaic != 0]
        _show(axes[f"mosaic_{mode.value}"], mosaic, f"mosaic, {TITLES[mode]}", float(np.quantile(drawn, 0.999)))
    return figure


def _draw_raw(axes: Axes, raw: NDArray[np.integer | np.floating], calibration: Calibration) -> None:
    calibration.require("bundle")
    assert calibration.bundle is not None
    bundle = calibration.bundle
    _show(axes, raw, "raw frame: confocal view left, residual view right", float(np.quantile(raw, 0.9999)))
    for (row, col), colour in (
        (bundle.confocal_centre, COLOURS[Mode.LS]),
        (bundle.residual_centre, COLOURS[Mode.ELSA]),
    ):
        axes.add_patch(Circle((col, row), bundle.diameter_px / 2, fill=False, color=colour, linewidth=1.5))
        axes.plot(col, row, "+", color=colour)


def _show(axes: Axes, image: NDArray[np.integer | np.floating], title: str, white: float) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=white, interpolation="antialiased")
    axes.set_title(title)
    axes.set_axis_off()
