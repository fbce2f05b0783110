"""What the metadata of a layer contain of its origin: key, and reading it back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

PROVENANCE: Final = "elsplus"
"""Key in the metadata of a layer; its value is a dictionary with ``kind``, ``calibration``, ``stack``, ..."""
GIVES_WAY: Final = "gives_way"
"""Key in the provenance of layers that lie side by side under titles, and are hidden where a recording is opened."""


def provenance_of(metadata: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return the origin of a layer by its `metadata`; empty for layers of other software.

    Examples
    --------
    >>> provenance_of({"elsplus": {"kind": "raw"}}), provenance_of({"elsplus": "a name"}), provenance_of(None)
    ({'kind': 'raw'}, {}, {})
    """
    noted = (metadata or {}).get(PROVENANCE)
    return noted if isinstance(noted, dict) else {}
