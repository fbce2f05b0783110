"""Photographs through real fibre bundles: whether each is located, and loses its honeycomb over the flat field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import tifffile

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import BundleSection, Calibration
from napari_elsplus.processing.calibration.bundle.location import Disc, locate_bundle
from napari_elsplus.processing.calibration.measurements import measure_flat_field
from napari_elsplus.processing.images.sectioning import Sectioner, disc

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

PHOTOGRAPHS: Final = {"bundle1": None, "tissue_paper": "tissue_paper_back", "usaf1": "usaf1_background"}
"""Names of photographs, and of the flat fields that were taken with them."""
_FINE_PX: Final = 4.0
"""Scale of the core pattern, px."""


@dataclass(frozen=True, slots=True)
class Photograph:
    """Result on one photograph.

    Parameters
    ----------
    name : str
        Of the file.
    found : Disc
        The bundle.
    flat : Disc, optional
        The bundle as its evenly lit photograph shows it.
    honeycomb, flattened : float
        Fine contrast in the 90 % disc, as a fraction of the mean: as taken, and over the flat field.
    """

    name: str
    found: Disc
    flat: Disc | None
    honeycomb: float
    flattened: float

    @property
    def moved_px(self) -> float:
        """Distance of the centre from where the evenly lit photograph shows it; NaN without one."""
        return float("nan") if self.flat is None else float(np.hypot(*np.subtract(self.found.centre, self.flat.centre)))


def look_at(folder: Path) -> list[Photograph]:
    """Locate the bundle in each photograph of a folder, and lay the flat field under it.

    Raises
    ------
    InputError
        If the folder lacks one of the photographs.
    """
    return [_look(folder, name, flat) for name, flat in PHOTOGRAPHS.items()]


def _look(folder: Path, name: str, flat_name: str | None) -> Photograph:
    image, found = _located(folder, name)
    honeycomb, flattened, flat = _fine_contrast(image, found), float("nan"), None
    if flat_name is not None:
        even, flat = _located(folder, flat_name)
        # These are photographs of one bundle, so the residual view is that same bundle.
        section = BundleSection(
            confocal_centre=flat.centre,
            residual_centre=flat.centre,
            diameter_px=flat.diameter_px,
            residual_to_confocal=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        )
        known = Calibration(bundle=section)
        field = measure_flat_field([even], known)
        flattened = _fine_contrast(
            np.divide(Sectioner(known, image.shape).ls(image), np.maximum(field, 0.1), dtype=np.float32)
        )
    return Photograph(name, found, flat, honeycomb, flattened)


def photograph(folder: Path, name: str) -> Image:
    """Return a photograph of a folder, (rows, cols) float32.

    Raises
    ------
    InputError
        If the folder lacks it.
    """
    path = folder / f"{name}.tif"
    if not path.exists():
        raise InputError(f"{folder} has no {path.name}", "give the folder of PyFibreBundle's photographs")
    return np.asarray(tifffile.imread(path), np.float32)


def _located(folder: Path, name: str) -> tuple[Image, Disc]:
    image = photograph(folder, name)
    return image, locate_bundle(image)


def _fine_contrast(image: Image, found: Disc | None = None) -> float:
    if found is None:
        inside = disc(len(image), 0.9 * len(image))
    else:
        rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
        inside = np.hypot(rows - found.centre[0], cols - found.centre[1]) < 0.45 * found.diameter_px
    fine = image - cv2.GaussianBlur(image, (0, 0), _FINE_PX)
    return float(fine[inside].std() / image[inside].mean())
