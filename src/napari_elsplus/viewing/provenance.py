"""What the metadata of a layer contain of its origin: key, and reading it back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

PROVENANCE: Final = "elsplus"
"""Key in the metadata of a layer; its value is a dictionary with ``kind``, ``calibration``, ``stack``, ..."""
GIVES_WAY: Final = "gives_way"
"""Key in the provenance of layers that lie side by side under titles, and are hidden where a recording is opened."""

LAYER: Final = "layer"
"""Key in the provenance of a layer that a panel uses again: its unique id, which a copy of it does not have."""


def provenance_of(metadata: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return the origin of a layer by its `metadata`; empty for layers of other software.

    Examples
    --------
    >>> provenance_of({"elsplus": {"kind": "raw"}}), provenance_of({"elsplus": "a name"}), provenance_of(None)
    ({'kind': 'raw'}, {}, {})
    """
    noted = (metadata or {}).get(PROVENANCE)
    return noted if isinstance(noted, dict) else {}


def reused_layers(layers: Iterable[Any]) -> list[tuple[Mapping[str, Any], Any]]:
    """Return origin and layer of those `layers` that panels made to use them again; copies of them are the user's."""
    noted = [(provenance_of(layer.metadata), layer) for layer in layers]
    return [(facts, layer) for facts, layer in noted if facts.get(LAYER) == layer.unique_id]
