"""Charts of what slit and offset do: drop-offs, signal kept, contrast to noise, clipped field, edge artefacts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from napari_elsplus.evaluation.sectioning import Choice, sharper_line_drop_offs
from napari_elsplus.figures.axial import plot_axial_response
from napari_elsplus.figures.comparison import COLOURS
from napari_elsplus.processing.sectioning import Mode
from napari_elsplus.simulation.axial_response import drop_offs, signal_kept

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from napari_elsplus.processing.axial import AxialResponse

PAPER_COLOUR: Final = "0.35"
NAMES: Final = {Mode.LS: "LS", Mode.ELS: "ELS+"}
PAPER_FITS: Final = {3: (58.0, 0.032), 10: (550.0, 0.0084)}
"""Limit (um) and rate (1/um) of the paper's ELS fits ``limit (1 - exp(-rate offset))``, by dB."""
PAPER_SLIT_FITS: Final = {
    ("ls", 3): (0.065, 0.084, 26.0),
    ("els", 3): (0.042, 0.83, 19.0),
    ("ls", 10): (0.44, -4.0, 270.0),
    ("els", 10): (0.034, 2.6, 170.0),
}
"""Quadratics in the slit width (um) that the paper prints, by curve and dB."""


def paper_drop_off(offset_um: float, decibel: int) -> float:
    """Drop-off distance (um) of ELS that the paper's printed fit gives at an offset.

    Examples
    --------
    >>> round(paper_drop_off(29.0, 3), 1), round(paper_drop_off(29.0, 10), 1)
    (35.1, 118.9)
    """
    limit, rate = PAPER_FITS[decibel]
    return float(limit * (1 - np.exp(-rate * offset_um)))


def drop_off_against_offset(measured: Mapping[float, AxialResponse]) -> Figure:
    """Drop-off distances against slit offset: closed form, raw frames, and the paper's fits."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    offsets_um = np.linspace(3, 90, 80)
    closed = np.array([drop_offs(offset_um=offset) for offset in offsets_um.tolist()])
    for axes, column, decibel, spread in zip(figure.subplots(1, 2), (0, 1), (3, 10), (3, 20), strict=True):
        limit, rate = PAPER_FITS[decibel]
        axes.plot(
            offsets_um, limit * (1 - np.exp(-rate * offsets_um)), "--", color=PAPER_COLOUR, label="ELS, paper's fit"
        )
        axes.axhspan(limit - spread, limit + spread, color=PAPER_COLOUR, alpha=0.2, lw=0, label="LS, paper")
        axes.plot(offsets_um, closed[:, column], color=COLOURS[Mode.ELS], label="ELS+, closed form")
        for mode, name in ((Mode.ELS, "els"), (Mode.LS, "ls")):
            drops = [getattr(response, f"{name}_{decibel}db").um for response in measured.values()]
            axes.plot(list(measured), drops, "o", color=COLOURS[mode], label=f"{NAMES[mode]}, raw frames")
        axes.set(xlabel="slit offset (um)", ylabel="distance (um)", title=f"{decibel} dB drop-off", ylim=(0, None))
        axes.legend(frameon=False)
    return figure


def drop_off_against_slit(measured: Mapping[float, AxialResponse]) -> Figure:
    """Drop-off distances against slit width at an offset of 77 um: the sharper line, and the paper's fits."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    slits_um = np.linspace(1, 12, 40)
    closed = sharper_line_drop_offs(slits_um)
    for axes, decibel in zip(figure.subplots(1, 2), (3, 10), strict=True):
        for name, mode in (("ls", Mode.LS), ("els", Mode.ELS)):
            column = 2 * (name == "els") + (decibel == 10)
            paper = np.polyval(PAPER_SLIT_FITS[name, decibel], slits_um)
            axes.plot(slits_um, paper, "--", color=COLOURS[mode], label=f"{NAMES[mode]}, paper's fit")
            axes.plot(slits_um, closed[:, column], color=COLOURS[mode], label=f"{NAMES[mode]}, closed form")
            drops = [getattr(response, f"{name}_{decibel}db").um for response in measured.values()]
            axes.plot(list(measured), drops, "o", color=COLOURS[mode], label=f"{NAMES[mode]}, raw frames")
        axes.set(xlabel="slit width (um)", ylabel="distance (um)", title=f"{decibel} dB drop-off", ylim=(0, None))
    axes.legend(frameon=False, fontsize="small")
    return figure


def kept_signal(measured: Mapping[float, AxialResponse]) -> Figure:
    """In-focus signal of ELS+ relative to LS against slit offset."""
    figure = Figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.add_subplot()
    offsets_um = np.linspace(0.5, 90, 120)
    kept = [100 * signal_kept(offset_um=offset) for offset in offsets_um.tolist()]
    axes.plot(offsets_um, kept, color=COLOURS[Mode.ELS], label="closed form")
    points = [100 * response.signal_kept for response in measured.values()]
    axes.plot(list(measured), points, "o", color=COLOURS[Mode.ELS], label="raw frames")
    axes.set(xlabel="slit offset (um)", ylabel="in-focus signal kept (%)", ylim=(0, 102))
    axes.legend(frameon=False)
    return figure


def the_choice(choices: list[Choice]) -> Figure:
    """Contrast to noise, clipped field and sectioning against slit offset: what a microscopist has to weigh."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    offsets_um = [choice.offset_um for choice in choices]
    panels: tuple[tuple[str, list[float]], ...] = (
        ("ELS+ 10 dB drop-off (um): lower is better", [choice.drop_10db_um for choice in choices]),
        ("contrast to noise in a pixel: higher is better", [choice.contrast_to_noise for choice in choices]),
        ("clipped field (%): lower is better", [100 * choice.clipped for choice in choices]),
    )
    for axes, (title, values) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.plot(offsets_um, values, "o-", color=COLOURS[Mode.ELS], ms=4)
        axes.axvspan(25, 40, color="0.5", alpha=0.15, lw=0)
        axes.set(xlabel="slit offset (um)", title=title, ylim=(0, None))
        axes.title.set_fontsize("medium")
    return figure


def edge_artefacts(images: Mapping[float, NDArray[np.float32]], um_per_px: float) -> Figure:
    """Averaged residual images at several offsets, smoothed over the cores, and their profiles down the middle."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    panels = figure.subplots(1, len(images) + 1)
    profiles: Axes = panels[-1]
    for axes, (offset_um, image) in zip(panels, images.items(), strict=False):
        middle = len(image) // 2
        scaled = gaussian_filter(image / image[middle - 50 : middle + 50, middle - 50 : middle + 50].mean(), 3)
        edge_um = middle * um_per_px
        axes.imshow(scaled, cmap="gray", vmin=0, vmax=1.3, extent=(-edge_um, edge_um, edge_um, -edge_um))
        axes.set(title=f"offset {abs(offset_um):.0f} um", xlabel="um")
        rows_um = (np.arange(len(image)) - middle) * um_per_px
        profiles.plot(rows_um, scaled[:, middle - 40 : middle + 40].mean(1), label=f"{abs(offset_um):.0f} um")
    profiles.set(xlabel="row from the bundle's centre (um)", title="residual over its centre", ylim=(0, 1.3))
    profiles.legend(title="offset", frameon=False, loc="lower center")
    return figure


def representative(response: AxialResponse) -> Figure:
    """Axial response at the paper's usual setting, as measured through raw frames."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    plot_axial_response(figure.add_subplot(), response)
    return figure
