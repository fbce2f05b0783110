"""Scenes: planes of tissue at depths, or a target lit from the far end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.specimen.pictures import ImageTexture, usaf_1951
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle, Nuclei, Texture, Uniform

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Plane:
    """Thin plane of tissue.

    Parameters
    ----------
    texture : Texture
        Brightness over the plane.
    depth_um : float
        Distance from the probe's face.
    brightness : float
        Factor on the texture.
    """

    texture: Texture
    depth_um: float = 0.0
    brightness: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.depth_um <= 5000:
            raise InputError(f"a plane at a depth of {self.depth_um} um", "give 0 to 5000 um")
        if not 0 <= self.brightness < 1e6:
            raise InputError(f"a plane of brightness {self.brightness}", "it must be zero or more")


@dataclass(frozen=True, slots=True)
class Scene:
    """Specimen: planes of tissue, or a target in transmission.

    Parameters
    ----------
    planes : tuple of Plane
        Planes, nearest first; none: a dark tube.
    transmission : bool
        True if lit from the distal end with the laser off: both views show the same, without sectioning.
    """

    planes: tuple[Plane, ...] = ()
    transmission: bool = False

    def in_focus(self) -> Scene:
        """Return the planes in contact with the probe: the result of perfect sectioning."""
        return Scene(tuple(plane for plane in self.planes if plane.depth_um == 0), self.transmission)

    @property
    def bounds_um(self) -> tuple[float, float, float, float] | None:
        """Edges (first row, first col, last row, last col) that all finite planes share; None where there is none."""
        edges = [plane.texture.bounds_um for plane in self.planes if plane.texture.bounds_um is not None]
        if not edges:
            return None
        top, left, bottom, right = zip(*edges, strict=True)
        return max(top), max(left), min(bottom), min(right)


def fibres(seed: int = 0) -> Scene:
    """Return lens tissue from a seed: fibres in focus, fibres at 60 um, a fluorescent ground at 200 um."""
    return Scene(
        (
            Plane(Fibres(seed=seed)),
            Plane(Fibres(per_mm2=60, seed=seed + 1), depth_um=60, brightness=0.8),
            Plane(Mottle(seed=seed), depth_um=200, brightness=1.5),
        )
    )


def sparse(seed: int = 0) -> Scene:
    """Return low-texture tissue from a seed: few fibres over the same ground."""
    return Scene(
        (
            Plane(Fibres(per_mm2=10, seed=seed)),
            Plane(Fibres(per_mm2=10, seed=seed + 1), depth_um=60, brightness=0.8),
            Plane(Mottle(seed=seed), depth_um=200, brightness=1.0),
        )
    )


def nuclei(seed: int = 0) -> Scene:
    """Return acriflavine-stained epithelium from a seed: nuclei in focus and at 40 um, stroma at 150 um."""
    return Scene(
        (
            Plane(Nuclei(seed=seed), brightness=1.2),
            Plane(Nuclei(seed=seed + 10), depth_um=40, brightness=0.8),
            Plane(Mottle(scale_um=80, seed=seed), depth_um=150, brightness=0.8),
        )
    )


def paper(seed: int = 0) -> Scene:
    """Return stained paper from a seed: an uneven surface in contact, and light from 60 um below."""
    return Scene(
        (Plane(Mottle(scale_um=40, seed=seed)), Plane(Mottle(scale_um=80, seed=seed + 1), depth_um=60, brightness=0.5))
    )


def usaf(_seed: int = 0) -> Scene:
    """Return a USAF 1951 target in transmission; the seed has no effect."""
    return Scene((Plane(usaf_1951()),), transmission=True)


def uniform(_seed: int = 0) -> Scene:
    """Return a uniform plane in contact; the seed has no effect."""
    return plate(0.0)


def plate(depth_um: float) -> Scene:
    """Return a uniform stained plate at a depth from the probe's face, um."""
    return Scene((Plane(Uniform(), depth_um),))


def empty(_seed: int = 0) -> Scene:
    """Return a dark tube, in which only the bundle's autofluorescence is seen; the seed has no effect."""
    return Scene()


def distal_light() -> Scene:
    """Return even light from the distal end, for locating the two views."""
    return Scene((Plane(Uniform()),), transmission=True)


def picture(image: NDArray[np.generic], um_per_px: float) -> Scene:
    """Return a grey image (rows, cols) in contact with the probe, at `um_per_px`, over an even ground at 200 um."""
    return Scene((Plane(ImageTexture(image, um_per_px)), Plane(Uniform(), depth_um=200, brightness=0.5)))


SCENES: Final[dict[str, Callable[[int], Scene]]] = {
    "fibres": fibres,
    "sparse": sparse,
    "nuclei": nuclei,
    "paper": paper,
    "usaf": usaf,
    "uniform": uniform,
    "empty": empty,
}
"""Functions from a seed to a scene, by name; ``plate`` and ``picture`` have other arguments."""


def scene(name: str, seed: int = 0) -> Scene:
    """Return the scene of this name, from a seed; ``plate:DEPTH`` is a plate at a depth in micrometres.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> scene("plate:50").planes[0].depth_um
    50.0
    """
    kind, _, depth = name.partition(":")
    if kind == "plate":
        try:
            return plate(float(depth or 0))
        except ValueError:
            raise InputError(f"the plate's depth is {depth!r}", "give micrometres, as in plate:50") from None
    if name not in SCENES:
        raise InputError(
            f"there is no scene {name!r}", f"choose one of {', '.join(SCENES)}, plate:DEPTH or an image file"
        )
    return SCENES[name](seed)
