"""Offset from the laser line in the confocal view to the same line in the residual one."""

from __future__ import annotations

from typing import Final, NamedTuple


class ViewOffset(NamedTuple):
    """Where a line of the confocal view lies in the residual one.

    Parameters
    ----------
    rows, columns : float
        From the line's middle in the confocal view to that in the residual one.
    slope : float
        Of the line in the residual view less that in the confocal one, rows per column.
    stretch : float
        Rows across the line in the residual view over those in the confocal one.
    """

    rows: float
    columns: float
    slope: float
    stretch: float = 1.0


IN_PLACE: Final = ViewOffset(0.0, 0.0, 0.0)
"""Offset of a line from itself."""
