"""Common axes of layers with and without a calibration, so that scale bar and sliders stay those of the calibrated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.processing.images.modes import Mode
from napari_elsplus.viewing.provenance import PROVENANCE, provenance_of
from napari_elsplus.viewing.stack import TIME

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

ADOPTED: Final = "axes_adopted"
"""Key in the metadata of a layer that has axes of another layer, not measured: for each axis, True if it is one."""
PIXEL: Final = "pixel"
_NAMES: Final = {"s": "second", "um": "micrometer"}


def reference_axes(layers: Sequence[Any]) -> tuple[tuple[float, ...], tuple[str, ...]] | None:
    """Return scale and units of the first stack (T, rows, cols) whose axes are all known; None if there is none.

    Parameters
    ----------
    layers : sequence of napari layers
        Those of a viewer.
    """
    for layer in layers:
        units = tuple(map(unit_name, layer.units))
        known = layer.ndim == 3 and PIXEL not in units and ADOPTED not in provenance_of(layer.metadata)
        if known and PROVENANCE in layer.metadata:
            return tuple(float(step) for step in layer.scale), units
    return None


def frames_per_image(kind: str | None) -> int:
    """Return the number of raw frames of an image of a layer, by its kind: a mode, or another."""
    return Mode(kind).frames_per_image if kind in list(Mode) else 1


def unit_name(unit: object) -> str:
    """Return the name of a unit that layers are given by name, symbol, or as an object of napari's."""
    return _NAMES.get(str(unit), str(unit))


def adopted_axes(metadata: Mapping[str, Any] | None, ndim: int) -> tuple[bool, ...]:
    """Return for each axis of a layer True if it is that of another layer: its scale is not to be measured by.

    Parameters
    ----------
    metadata : mapping or None
        The layer's.
    ndim : int
        Number of its axes.

    Examples
    --------
    >>> adopted_axes({"elsplus": {ADOPTED: (False, True, True)}}, 3), adopted_axes({}, 2)
    ((False, True, True), (False, False))
    """
    return ((False,) * ndim + tuple(provenance_of(metadata).get(ADOPTED, ())))[-ndim:]


def plane_axes(um_per_px: float | None, layers: Sequence[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the axes of an image: micrometres, else those of calibrated layers beside it, else pixels.

    Parameters
    ----------
    um_per_px : float or None
        Its scale; None if unknown.
    layers : sequence of napari layers
        Those of a viewer, which has a scale bar only if all units agree.

    Returns
    -------
    axes : dict
        ``scale`` and ``units`` of the layer.
    adopted : dict
        For its provenance: :data:`ADOPTED`, if the axes are those of another layer.
    """
    reference = None if um_per_px else reference_axes(layers)
    if reference is None:
        return {"scale": (um_per_px or 1.0,) * 2, "units": ("um" if um_per_px else PIXEL,) * 2}, {}
    steps, units = reference
    return {"scale": steps[-2:], "units": units[-2:]}, {ADOPTED: (True, True)}


def adopt_axes(
    words: dict[str, Any], reference: tuple[tuple[float, ...], tuple[str, ...]] | None
) -> tuple[dict[str, Any], bool]:
    """Return a layer's attributes with unknown axes replaced by those of a reference, and True if it is uncalibrated.

    A first axis of another kind is replaced, too: depth beside time, or time beside depth.

    Parameters
    ----------
    words : dict
        Attributes of a layer (T, rows, cols): ``scale``, ``units``, ``translate`` and ``metadata``, and where it may be
        an axial scan ``axis_labels``.
    reference : tuple or None
        From :func:`reference_axes`.

    Notes
    -----
    The frame index and pixels then coincide with those of the other layers. Measurements take scale and timing from
    the recording and its calibration, and remain in pixels.
    """
    units = [unit_name(unit) for unit in words.get("units", ())]
    if reference is None or len(units) != 3:
        return words, False
    unknown, scale, translate = [unit == PIXEL for unit in units], list(words["scale"]), list(words["translate"])
    adopts = [unknown[0] or units[0] != reference[1][0], *unknown[1:]]
    if not any(adopts):
        return words, False
    kind = words["metadata"][PROVENANCE]["kind"]
    for axis, (step, unit) in enumerate(zip(*reference, strict=True)):
        if adopts[axis]:
            translate[axis] *= step / scale[axis] if axis else 0.0
            scale[axis], units[axis] = step * (1 if axis else frames_per_image(kind)), unit
    facts = {**words["metadata"][PROVENANCE], ADOPTED: tuple(adopts)}
    adopted = {"scale": tuple(scale), "translate": tuple(translate), "units": tuple(units)}
    scan = words.get("axis_labels", (TIME,))[0] != TIME
    uncalibrated = any(unknown[1:] if scan else unknown)  # depths in uneven steps have no unit either
    return {**words, **adopted, "metadata": {**words["metadata"], PROVENANCE: facts}}, uncalibrated
