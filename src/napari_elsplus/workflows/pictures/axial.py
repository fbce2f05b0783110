"""Picture of an axial response: LS, residual and ELS+ against distance, with the drop-offs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.processing.axial.axial_response import LEVEL_3DB, LEVEL_10DB, AxialResponse
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.workflows.pictures.comparison import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes


RESIDUAL_COLOUR = "0.45"


def draw_axial_response(response: AxialResponse) -> Figure:
    """Draw an axial response in the form of the paper's representative profile.

    Parameters
    ----------
    response : AxialResponse
        Of :func:`napari_elsplus.measure_axial_response`.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.
    """
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    plot_axial_response(figure.add_subplot(), response)
    return figure


def plot_axial_response(axes: Axes, response: AxialResponse) -> None:
    """Plot an axial response onto axes."""
    distance_um = response.depth_um - response.contact_um
    axes.plot(distance_um, response.ls, color=COLOURS[Mode.LS], label="LS")
    axes.plot(distance_um, response.residual, "--", color=RESIDUAL_COLOUR, label="residual, on the scale of LS")
    axes.plot(distance_um, response.els, color=COLOURS[Mode.ELS], label="ELS+")
    for drop, level, mode in (
        (response.ls_3db, LEVEL_3DB, Mode.LS),
        (response.ls_10db, LEVEL_10DB, Mode.LS),
        (response.els_3db, LEVEL_3DB, Mode.ELS),
        (response.els_10db, LEVEL_10DB, Mode.ELS),
    ):
        if np.isfinite(drop.um):
            axes.plot(drop.um, level, "o", color=COLOURS[mode])
            axes.annotate(f"{drop.um:.0f} um", (drop.um, level), (5, 5), textcoords="offset points")
    for level, name in ((LEVEL_3DB, "3 dB"), (LEVEL_10DB, "10 dB")):
        axes.axhline(level, color="0.8", lw=0.8, zorder=0)
        axes.text(distance_um[-1], level, name, ha="right", va="bottom", color="0.4")
    axes.set(xlabel="distance from contact (um)", ylabel="signal over signal in contact", ylim=(-0.05, 1.08))
    axes.set_title(f"Signal kept in contact: {100 * response.signal_kept:.0f} %")
    axes.legend(frameon=False)
