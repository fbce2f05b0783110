"""Charts of what slit and offset do: drop-offs, signal kept, contrast to noise, clipped field, edge artefacts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from benchmarks.studies import printed
from benchmarks.studies.sectioning import sharper_line_drop_offs
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_drop_offs, signal_kept
from napari_elsplus.workflows.pictures.comparison import COLOURS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from napari_elsplus.processing.axial.axial_response import AxialResponse
    from napari_elsplus.workflows.sectioning_performance import SectioningPerformance

PAPER_COLOUR: Final = "0.35"
NAMES: Final = {Mode.LS: "LS", Mode.ELS: "ELS+"}


def drop_off_against_offset(measured: Mapping[float, AxialResponse]) -> Figure:
    """Drop-off distances against slit offset: closed form, raw frames, and the paper's fits."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    offsets_um = np.linspace(3, 90, 80)
    closed = np.array([model_drop_offs(offset_um=offset) for offset in offsets_um.tolist()])
    for axes, column, decibel in zip(figure.subplots(1, 2), (0, 1), (3, 10), strict=True):
        fit = [printed.els_drop_off_um(offset, decibel) for offset in offsets_um.tolist()]
        axes.plot(offsets_um, fit, "--", color=PAPER_COLOUR, label="ELS, paper's fit")
        ls_um, spread_um = printed.LS_UM[decibel]
        axes.axhspan(ls_um - spread_um, ls_um + spread_um, color=PAPER_COLOUR, alpha=0.2, lw=0, label="LS, paper")
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
            paper = np.polyval(printed.SLIT_FITS[name, decibel], slits_um)
            axes.plot(slits_um, paper, "--", color=COLOURS[mode], label=f"{NAMES[mode]}, paper's fit")
            axes.plot(slits_um, closed[:, column], color=COLOURS[mode], label=f"{NAMES[mode]}, closed form")
            drops = [getattr(response, f"{name}_{decibel}db").um for response in measured.values()]
            axes.plot(list(measured), drops, "o", color=COLOURS[mode], label=f"{NAMES[mode]}, raw frames")
        axes.set(xlabel="slit width (um)", ylabel="distance (um)", title=f"{decibel} dB drop-off", ylim=(0, None))
    axes.legend(frameon=False, fontsize="small")
    return figure


def kept_signal(by_offset: Mapping[float, AxialResponse], by_slit: Mapping[float, AxialResponse]) -> Figure:
    """In-focus signal of ELS+ relative to LS against slit offset, and against slit width at an offset of 77 um.

    Parameters
    ----------
    by_offset : mapping
        Offset (um) to the response measured there, slit 2.9 um, line a.
    by_slit : mapping
        Slit width (um) to the response measured there, the sharper line.
    """
    figure = Figure(figsize=(10, 4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    offsets_um, slits_um = np.linspace(0.5, 90, 120), np.linspace(1, 12, 40)
    curves = (
        (offsets_um, [100 * signal_kept(offset_um=offset) for offset in offsets_um.tolist()]),
        (
            slits_um,
            [100 * signal_kept(offset_um=77, slit_um=slit, line=LINE_MODELS["b"]) for slit in slits_um.tolist()],
        ),
    )
    titles = ("slit 2.9 um", "offset 77 um, sharper line of panels (c, d)")
    for axes, curve, measured, title in zip(panels, curves, (by_offset, by_slit), titles, strict=True):
        axes.plot(*curve, color=COLOURS[Mode.ELS], label="closed form")
        points = [100 * response.signal_kept for response in measured.values()]
        axes.plot(list(measured), points, "o", color=COLOURS[Mode.ELS], label="raw frames")
        axes.set(title=title, ylim=(0, 102))
    panels[0].set(xlabel="slit offset (um)", ylabel="in-focus signal kept (%)")
    panels[1].set(xlabel="slit width (um)")
    panels[0].legend(frameon=False)
    return figure


def the_choice(trades: Mapping[float, SectioningPerformance]) -> Figure:
    """Contrast to noise, clipped field and sectioning against slit offset: what a microscopist has to weigh."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    panels: tuple[tuple[str, list[float]], ...] = (
        ("ELS+ 10 dB drop-off (um): lower is better", [trade.drop_10db_um for trade in trades.values()]),
        ("contrast to noise in a pixel: higher is better", [trade.contrast_to_noise for trade in trades.values()]),
        ("clipped field (%): lower is better", [100 * trade.clipped for trade in trades.values()]),
    )
    for axes, (title, values) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.plot(list(trades), values, "o-", color=COLOURS[Mode.ELS], ms=4)
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
