"""Track files: position of the probe in every frame, with its uncertainty."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import replacing
from napari_elsplus.io.text import read_lines

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable

STATES: Final = ("tracked", "predicted", "lost")


class TrackPoint(NamedTuple):
    """One line of a track file.

    Parameters
    ----------
    frame : int
        Index of the frame in the recording.
    time_s : float
        When it was taken.
    segment : int
        Frames of one segment share an origin; a new one starts after the probe was lost.
    row_px, col_px : float
        Position in the scene, full-resolution confocal camera pixels, when the bundle's middle row is read; NaN where
        lost.
    row_um, col_um : float
        The same in micrometres; NaN where the scale is unknown.
    score : float
        Correlation with the frame that this one was linked to.
    sigma_px : float
        Larger axis of the position's uncertainty relative to the frame of the segment that was tracked before, one
        standard deviation; NaN for its first.
    state : str
        ``tracked``, ``predicted`` or ``lost``.
    """

    frame: int
    time_s: float
    segment: int
    row_px: float
    col_px: float
    row_um: float
    col_um: float
    score: float
    sigma_px: float
    state: str


HEADER: Final = TrackPoint._fields


def write_track(path: str | os.PathLike[str], rows: Iterable[TrackPoint], force: bool = False) -> None:
    """Write a track file, a row for every frame, every digit kept.

    Parameters
    ----------
    path : path-like
        The CSV file.
    rows : iterable of TrackPoint
        In the order of frames.
    force : bool
        Replace an existing file instead of refusing it.

    Raises
    ------
    InputError
        If a row's state is none of the three, or the file exists and `force` is not given.
    """
    with replacing(path, force=force) as beside, beside.open("w", newline="", encoding="ascii") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(HEADER)
        for frame, time_s, segment, *numbers, state in rows:
            if state not in STATES:
                raise InputError(f"frame {frame} has state {state!r}", f"one of {', '.join(STATES)} is expected")
            table.writerow((int(frame), float(time_s), int(segment), *map(float, numbers), state))


def read_track(path: str | os.PathLike[str]) -> list[TrackPoint]:
    """Read a track file.

    Parameters
    ----------
    path : path-like
        The CSV file.

    Returns
    -------
    list of TrackPoint
        A point for every frame.

    Raises
    ------
    InputError
        Naming the line, if it is no track file.
    """
    path = Path(path)
    lines = read_lines(path, "a track file is expected")
    if not lines or tuple(lines[0].split(",")) != HEADER:
        raise InputError(
            f"{path.name} has the header {lines[0][:60] if lines else ''!r}", f"{','.join(HEADER)} is expected"
        )
    return [_point(path, number, line) for number, line in enumerate(lines[1:], start=2)]


def _point(path: Path, number: int, line: str) -> TrackPoint:
    cells = line.split(",")
    try:
        if len(cells) != len(HEADER) or cells[-1] not in STATES:
            raise ValueError(line)
        frame, time_s, segment, *numbers, state = cells
        return TrackPoint(int(frame), float(time_s), int(segment), *map(float, numbers), state=state)  # type: ignore[misc, arg-type]
    except ValueError:
        raise InputError(f"{path.name}: line {number} is {line[:60]!r}", f"{','.join(HEADER)} is expected") from None
