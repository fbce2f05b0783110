"""LS, ELSA and ELS+ of one moment side by side, with a line profile: the paper's lens-paper figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.errors import InputError
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER, contrast, white_level
from napari_elsplus.processing.images.sectioning import Frames, Mode, Sectioner, disc
from napari_elsplus.workflows.pictures.files import save_figure
from napari_elsplus.workflows.pictures.mosaic_picture import bar_length

if TYPE_CHECKING:
    import os

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.analysis.image_quality import Contrast

TITLES: Final = {Mode.LS: "LS", Mode.ELSA: "ELSA", Mode.ELS: "ELS+"}
COLOURS: Final = {Mode.LS: "#0072b2", Mode.ELSA: "#e69f00", Mode.ELS: "#009e73"}
"""Of Okabe and Ito's palette, distinguishable with colour-vision deficiency."""
_PROFILE_WIDTH_PX: Final = 5
_BAR_SHARE: Final = 0.25


@dataclass(frozen=True)
class ComparisonFigure:
    """LS, ELSA and ELS+ images of one raw frame, scaled as in the paper.

    Attributes
    ----------
    images : dict
        Mode to (n, n) float32, 1 is white. LS and ELS+ are scaled to 0.01 % saturation each, ELSA by the factor of
        ELS+.
    inside : numpy.ndarray
        (n, n) bool: the disc of 90 % of the bundle, in which they are scaled and displayed.
    profile_row : int
        Row of the line profile.
    um_per_px : float or None
        Micrometres per pixel; None without a scale in the calibration.
    """

    images: dict[Mode, NDArray[np.float32]]
    inside: NDArray[np.bool_]
    profile_row: int
    um_per_px: float | None = None

    def profile(self, mode: Mode) -> NDArray[np.float32]:
        """Return the mean of five rows about the profile row in one mode's image: (n,), NaN outside of the disc."""
        half = _PROFILE_WIDTH_PX // 2
        rows = slice(self.profile_row - half, self.profile_row + half + 1)
        mean: NDArray[np.float32] = self.images[mode][rows].mean(axis=0)
        return np.where(self.inside[self.profile_row], mean, np.float32(np.nan))

    def contrast(self, mode: Mode | str) -> Contrast:
        """Return the contrast and the background of one mode's image, both in the 90 % disc."""
        return contrast(self.images[Mode(mode)], self.inside)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Draw the three images with their profiles and save the figure.

        Parameters
        ----------
        path : path-like
            File of the figure; its suffix names the format.
        force : bool
            Overwrite an existing file.

        Raises
        ------
        InputError
            If the format is unknown, or the file exists and `force` is not given.
        """
        save_figure(draw_comparison(self), Path(path), force=force)


def compare(raw: Frames, calibration: Calibration, frame: int = 0) -> ComparisonFigure:
    """Return LS, ELSA and ELS+ images of one raw frame; ELSA takes its residual from the next frame.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols).
    calibration : Calibration
        Of the rig that made them.
    frame : int
        Index of the frame; not the last, since ELSA needs the one after it.

    Raises
    ------
    InputError
        If the frame, or the one after it, does not exist.
    CalibrationError
        If the calibration does not fit the recording.
    """
    if not 0 <= frame < len(raw) - 1:
        raise InputError(
            f"frame {frame} and the one after it are needed, the recording has {len(raw)} frames",
            f"choose a frame from 0 to {len(raw) - 2}" if len(raw) > 1 else "record at least two",
        )
    rows, cols = raw[frame].shape
    sectioner = Sectioner(calibration, (rows, cols))
    images = {
        Mode.LS: sectioner.ls(raw[frame]),
        Mode.ELSA: sectioner.elsa(raw[frame], raw[frame + 1]),
        Mode.ELS: sectioner.els(raw[frame]),
    }
    inside = disc(sectioner.side, USED_DIAMETER * sectioner.diameter_px)
    white = {mode: white_level(images[mode], inside) for mode in (Mode.LS, Mode.ELS)}
    white[Mode.ELSA] = white[Mode.ELS]
    scaled = {mode: image / np.float32(white[mode]) for mode, image in images.items()}
    return ComparisonFigure(scaled, inside, sectioner.side // 2, calibration.um_per_px)


def draw_comparison(comparison: ComparisonFigure) -> Figure:
    """Draw the three images and their profiles along one line.

    Parameters
    ----------
    comparison : ComparisonFigure
        Of :func:`compare`; without its scale there is no scale bar, and the profile's axis is in pixels.

    Returns
    -------
    matplotlib.figure.Figure
        Without a window; :func:`save_figure` saves it.
    """
    um_per_px = comparison.um_per_px
    figure = Figure(figsize=(12, 7), layout="constrained")
    axes = figure.subplot_mosaic([[mode.value for mode in TITLES], ["profile"] * 3], height_ratios=[2, 1])
    for mode, title in TITLES.items():
        shown = np.where(comparison.inside, comparison.images[mode], 0)
        axes[mode.value].imshow(shown, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axes[mode.value].axhline(comparison.profile_row, color=COLOURS[mode], linewidth=0.8, linestyle=(0, (6, 6)))
        levels = comparison.contrast(mode)
        axes[mode.value].set_title(f"{title}: background {100 * levels.background:.1f} % of white")
        axes[mode.value].set_axis_off()
        if um_per_px is not None:
            _draw_scale_bar(axes[mode.value], len(shown), um_per_px)
    _draw_profiles(axes["profile"], comparison, um_per_px)
    return figure


def _draw_profiles(axes: Axes, comparison: ComparisonFigure, um_per_px: float | None) -> None:
    side = len(comparison.inside)
    position = (np.arange(side) - (side - 1) / 2) * (um_per_px or 1)
    for mode, title in TITLES.items():
        axes.plot(position, comparison.profile(mode), color=COLOURS[mode], label=title, linewidth=1)
    axes.axhline(0, color="0.7", linewidth=0.8)
    axes.set_xlabel("position along the line / " + ("px" if um_per_px is None else "\N{MICRO SIGN}m"))
    axes.set_ylabel("intensity / white")
    axes.legend(loc="upper right", ncols=3, frameon=False)
    axes.margins(x=0)


def _draw_scale_bar(axes: Axes, side: int, um_per_px: float) -> None:
    length_um = bar_length(_BAR_SHARE * side * um_per_px)
    length_px = length_um / um_per_px
    axes.plot([side * 0.97 - length_px, side * 0.97], [side * 0.97] * 2, color="white", linewidth=3)
    label = f"{length_um:g} \N{MICRO SIGN}m"
    axes.text(side * 0.97 - length_px / 2, side * 0.955, label, color="white", ha="center", va="bottom")
