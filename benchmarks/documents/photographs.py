"""Picture of real photographs through bundles, by each way to show one frame: ``python3 run.py bench photographs``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness.methods import Absent
from benchmarks.harness.peers import peer
from benchmarks.rigs.photographs import PHOTOGRAPHS, photograph
from napari_elsplus.processing.mosaicing.cores.canvas import SampleCanvas
from napari_elsplus.processing.mosaicing.cores.reading import SPOT_PITCHES
from napari_elsplus.processing.mosaicing.cores.reconstruction import canvas_smoothness, reconstruct_canvas
from napari_elsplus.workflows.core_mosaicing.pipeline import CELLS_PER_PITCH
from napari_elsplus.workflows.core_mosaicing.views import FinishedBundle

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

_SHOWN: Final = 70.0
"""Side of the part that is drawn, core pitches."""


def draw_photographs(folder: Path) -> Figure:
    """Draw the photographs of structured targets in a folder: as taken, filtered, interpolated, core by core.

    Parameters
    ----------
    folder : pathlib.Path
        Photographs and their flat fields, by the names in :data:`benchmarks.rigs.photographs.PHOTOGRAPHS`.
    """
    targets = {name: flat for name, flat in PHOTOGRAPHS.items() if flat is not None}
    shown = {name: _pictures(photograph(folder, name), photograph(folder, flat)) for name, flat in targets.items()}
    columns = max(len(pictures) for pictures in shown.values())
    figure = Figure(figsize=(3.6 * columns, 3.9 * len(shown)), layout="constrained")
    for row, (name, pictures) in zip(figure.subplots(len(shown), columns, squeeze=False), shown.items(), strict=True):
        for axes, (title, part) in zip(row, pictures.items(), strict=True):
            axes.imshow(part, cmap="gray", vmin=0, vmax=np.percentile(part, 99.5))
            axes.set_title(f"{name}: {title}", fontsize=9)
            axes.set_axis_off()
    return figure


def _pictures(image: Image, flat: Image) -> dict[str, Image]:
    """Return the middle of a photograph by each way to show it, by the way's name."""
    bundle = FinishedBundle([image], flat)
    seen, even = (np.ascontiguousarray(bundle.view.image(one, one)) for one in (image, flat))
    centre, pitch_px = bundle.view.centre, bundle.view.cores.pitch_px
    pictures = {
        "as taken": _middle(seen, centre, pitch_px),
        "median 3x3": _middle(cv2.medianBlur(seen, 3), centre, pitch_px),
        "interpolated between cores": _middle(bundle[0], centre, pitch_px),
    }
    radius = min(*centre, *np.subtract(seen.shape, centre))
    try:
        other = peer("PyFibreBundle")
        other("calibrate_interpolation", flat=even, pitch=pitch_px, centre=centre[0], radius=radius, side=len(seen))
        theirs, _ = other("interpolate", image=seen)
        scale = len(theirs) / (2 * radius)
        middle = (len(theirs) / 2, len(theirs) / 2)
        pictures["PyFibreBundle, interpolated"] = _middle(np.asarray(theirs, np.float32), middle, pitch_px * scale)
    except Absent:
        pass
    pictures["core by core"] = _core_by_core(bundle, seen)
    return pictures


def _core_by_core(bundle: FinishedBundle, seen: Image) -> Image:
    """Return the reconstruction of the cores of one frame, the middle of it."""
    cores = bundle.view.cores
    places = (cores.positions - bundle.view.centre) * (CELLS_PER_PITCH / cores.pitch_px)
    samples = SampleCanvas(CELLS_PER_PITCH / 2)
    samples.add(places, cores.read(seen), cores.weights)
    aperture = SPOT_PITCHES * CELLS_PER_PITCH
    image, _ = reconstruct_canvas(samples, aperture, canvas_smoothness(samples, aperture)).read()
    assert samples.extent is not None
    return _middle(image, (-samples.extent.top, -samples.extent.left), CELLS_PER_PITCH)


def _middle(image: Image, centre: tuple[float, float], per_pitch: float) -> Image:
    half = int(0.5 * _SHOWN * per_pitch)
    row, col = (int(c) for c in centre)
    return image[max(row - half, 0) : row + half, max(col - half, 0) : col + half]
