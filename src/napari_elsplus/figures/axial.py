"""Picture of an axial response: LS, residual and ELS+ against distance, with the drop-offs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from pathlib import Path

    from napari_elsplus.processing.axial import AxialResponse


def draw_axial_response(response: AxialResponse, path: Path) -> None:
    """Draw an axial response like the paper's representative profile.

    Parameters
    ----------
    response : AxialResponse
        What `processing.axial.axial_response` found.
    path : pathlib.Path
        PNG file to write.
    """
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    distance_um = response.depth_um - response.contact_um
    for curve, name, style in (
        (response.ls, "LS", "C0-"),
        (response.residual, "residual (scale of LS)", "C2--"),
        (response.els, "ELS+", "C3-"),
    ):
        axes.plot(distance_um, curve, style, label=name, lw=1.5)
    for drop, level, colour in (
        (response.ls_3db, 0.5, "C0"),
        (response.ls_10db, 0.1, "C0"),
        (response.els_3db, 0.5, "C3"),
        (response.els_10db, 0.1, "C3"),
    ):
        if np.isfinite(drop.um):
            axes.plot(drop.um, level, "o", color=colour)
            axes.annotate(f"{drop.um:.0f} um", (drop.um, level), (4, 5), textcoords="offset points", color=colour)
    for level, name in ((0.5, "3 dB"), (0.1, "10 dB")):
        axes.axhline(level, color="0.7", lw=0.8, zorder=0)
        axes.text(distance_um[-1], level, name, ha="right", va="bottom", color="0.4")
    axes.set(xlabel="distance from contact (um)", ylabel="signal, normalised in contact", ylim=(-0.05, 1.05))
    axes.set_title(f"Axial response; signal kept {100 * response.signal_kept:.1f} %")
    axes.legend()
    figure.savefig(path, dpi=120, format="png")
