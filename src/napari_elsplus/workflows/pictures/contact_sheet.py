"""Contact sheet of a calibrated recording: raw frame with both views, LS, ELSA, ELS+, mosaics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from napari_elsplus.processing.images.modes import COMPARED_MODES, Mode
from napari_elsplus.workflows.pictures.comparison import COLOURS, ComparisonFigure
from napari_elsplus.workflows.pictures.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration

_BAR_PT: Final = 10.0
"""Size of the labels of scale bars, points: that of the titles."""


def draw_contact_sheet(
    raw: NDArray[np.integer | np.floating],
    calibration: Calibration,
    comparison: ComparisonFigure,
    mosaics: dict[Mode, NDArray[np.float32]],
    mosaic_um_per_px: float | None,
) -> Figure:
    """Draw a raw frame with both bundles outlined, the images made of it, and the mosaics, each with its scale bar.

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
    mosaic_um_per_px : float or None
        Micrometres per pixel of the mosaics; None without a scale in the calibration.
    """
    figure = Figure(figsize=(12, 14), layout="constrained")
    top, middle, bottom = figure.subfigures(3, 1, squeeze=False, height_ratios=[4.4, 3.9, 5.5])[:, 0]
    axes = {
        **top.subplot_mosaic([["raw"]]),
        **middle.subplot_mosaic([["ls", "elsa", "els"]]),
        **bottom.subplot_mosaic([["mosaic_ls", "mosaic_els"]]),
    }
    _draw_raw(axes["raw"], raw, calibration)
    for mode in COMPARED_MODES:
        shown = np.where(comparison.inside, comparison.images[mode], 0)
        _show(axes[mode.value], shown, mode.label, 1.0, comparison.um_per_px)
    for mode in (Mode.LS, Mode.ELS):
        mosaic = mosaics[mode]
        drawn = mosaic[mosaic != 0]
        white = float(np.quantile(drawn, 0.999))
        _show(axes[f"mosaic_{mode.value}"], mosaic, f"mosaic, {mode.label}", white, mosaic_um_per_px)
    return figure


def _draw_raw(axes: Axes, raw: NDArray[np.integer | np.floating], calibration: Calibration) -> None:
    bundle = calibration.measured_bundle
    white = float(np.quantile(raw, 0.9999))
    _show(axes, raw, "raw frame: confocal view left, residual view right", white, calibration.um_per_px)
    for (row, col), colour in (
        (bundle.confocal_centre, COLOURS[Mode.LS]),
        (bundle.residual_centre, COLOURS[Mode.ELSA]),
    ):
        axes.add_patch(Circle((col, row), bundle.diameter_px / 2, fill=False, color=colour, linewidth=1.5))
        axes.plot(col, row, "+", color=colour)


def _show(
    axes: Axes, image: NDArray[np.integer | np.floating], title: str, white: float, um_per_px: float | None
) -> None:
    axes.imshow(image, cmap="gray", vmin=0, vmax=white, interpolation="antialiased")
    axes.set_title(title)
    axes.set_axis_off()
    if um_per_px is not None:
        draw_scale_bar(axes, image.shape, um_per_px, _BAR_PT)
