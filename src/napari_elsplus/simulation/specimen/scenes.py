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
    """A thin plane of tissue.

    Parameters
    ----------
    texture : Texture
        Its brightness over the plane.
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
    """What lies before the probe.

    Parameters
    ----------
    planes : tuple of Plane
        Tissue, nearest first; none: a dark tube.
    transmission : bool
        Lit from the far end, the laser off: both views see the same, and nothing is sectioned.
    """

    planes: tuple[Plane, ...] = ()
    transmission: bool = False

    def in_focus(self) -> Scene:
        """Return only what touches the probe: what perfect sectioning would show."""
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
    """Lens tissue over a fluorescent ground: fibres in focus, others behind them, the ground far off."""
    return Scene(
        (
            Plane(Fibres(seed=seed)),
            Plane(Fibres(per_mm2=60, seed=seed + 1), depth_um=60, brightness=0.8),
            Plane(Mottle(seed=seed), depth_um=200, brightness=1.5),
        )
    )


def sparse(seed: int = 0) -> Scene:
    """Few fibres over the same ground: little to register on."""
    return Scene(
        (
            Plane(Fibres(per_mm2=10, seed=seed)),
            Plane(Fibres(per_mm2=10, seed=seed + 1), depth_um=60, brightness=0.8),
            Plane(Mottle(seed=seed), depth_um=200, brightness=1.0),
        )
    )


def nuclei(seed: int = 0) -> Scene:
    """Acriflavine-stained epithelium: a layer of nuclei, a deeper layer, and stroma."""
    return Scene(
        (
            Plane(Nuclei(seed=seed), brightness=1.2),
            Plane(Nuclei(seed=seed + 10), depth_um=40, brightness=0.8),
            Plane(Mottle(scale_um=80, seed=seed), depth_um=150, brightness=0.8),
        )
    )


def paper(seed: int = 0) -> Scene:
    """Cover the field with stained paper: its uneven surface in contact, and what shines through from below."""
    return Scene(
        (Plane(Mottle(scale_um=40, seed=seed)), Plane(Mottle(scale_um=80, seed=seed + 1), depth_um=60, brightness=0.5))
    )


def usaf(seed: int = 0) -> Scene:
    """USAF 1951 target, lit from behind."""
    del seed  # there is only one
    return Scene((Plane(usaf_1951()),), transmission=True)


def uniform(seed: int = 0) -> Scene:
    """Put a uniform plane in contact."""
    del seed
    return plate(0.0)


def plate(depth_um: float, brightness: float = 1.0) -> Scene:
    """Uniform stained metal plate at a depth, as seen from the probe's face."""
    return Scene((Plane(Uniform(), depth_um, brightness),))


def empty(seed: int = 0) -> Scene:
    """Put the probe into a dark tube: only the bundle's own fluorescence is left."""
    del seed
    return Scene()


def distal_light() -> Scene:
    """Light the far end evenly, as for locating the pair of images."""
    return Scene((Plane(Uniform()),), transmission=True)


def picture(image: NDArray[np.generic], um_per_px: float) -> Scene:
    """Any grey image in contact with the probe, over an even ground 200 um away."""
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
"""Scenes by name, each made from a seed; ``plate`` and ``picture`` take what they need instead."""


def scene(name: str, seed: int = 0) -> Scene:
    """Return the scene of that name; ``plate:DEPTH`` is a plate at a depth in micrometres.

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
