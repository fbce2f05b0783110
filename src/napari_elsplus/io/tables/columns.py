"""CSV files: one column for the depths of an axial scan or the voltages of a sweep, several for curves."""

from __future__ import annotations

from itertools import zip_longest
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import replacing
from napari_elsplus.io.calibration_lookup import existing_beside
from napari_elsplus.io.text import read_lines

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

DEPTH: Final = "depth_um"
VOLTS: Final = "volts"
MAX_CSV_BYTES: Final = 64 << 20
"""Chosen: a million numbers have some 20 MB; a larger file is another one, named by mistake."""


def read_depths_um(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the depths of an axial scan: header ``depth_um``, a line per frame.

    Parameters
    ----------
    path : path-like
        CSV file.

    Returns
    -------
    numpy.ndarray, (T,)
        Micrometres.

    Raises
    ------
    InputError
        Naming the line and its value, if it is no such file.
    """
    return read_column(path, DEPTH)


def read_volts(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the voltages of a sweep: header ``volts``, a line per frame; see :func:`read_depths_um`."""
    return read_column(path, VOLTS)


def volts_beside(sweep: str | os.PathLike[str]) -> Path | None:
    """Return the table of voltages beside the recording of a sweep, ``NAME_volts.csv``; None if there is none."""
    return existing_beside(sweep, "_volts.csv")


def read_column(path: str | os.PathLike[str], header: str) -> NDArray[np.float64]:
    """Read a CSV file of one column under the header given; see :func:`read_depths_um`."""
    path = Path(path)
    lines = read_lines(path, "a CSV file of one column is expected", MAX_CSV_BYTES)
    if not lines or lines[0].strip().strip('"') != header:
        found = repr(lines[0][:40]) if lines else "nothing"
        raise InputError(
            f"{path.name}: line 1 is {found}", f"a header line `{header}` is expected, then a number per frame"
        )
    while lines[-1].strip() == "":
        lines.pop()
    values = [_number(path, number, line) for number, line in enumerate(lines[1:], start=2)]
    if not values:
        raise InputError(f"{path.name} holds no number below its header", "a number per frame is expected")
    return np.array(values)


def write_column(
    path: str | os.PathLike[str], header: str, values: Sequence[float] | NDArray[np.floating], force: bool = False
) -> None:
    """Write a CSV file of one column, as :func:`read_column` reads it, every digit kept."""
    write_table(path, {header: values}, force)


def write_table(
    path: str | os.PathLike[str], columns: Mapping[str, Sequence[float] | NDArray[np.floating]], force: bool = False
) -> None:
    """Write curves to a CSV file: a header, then a line per value, every digit kept; shorter columns end empty.

    Parameters
    ----------
    path : path-like
        The file.
    columns : mapping
        Name, with its unit, to values.
    force : bool
        Replace an existing file instead of refusing it.

    Raises
    ------
    InputError
        If the file exists and `force` is not given.
    """
    cells = [[repr(float(value)) for value in values] for values in columns.values()]
    lines = [",".join(row) for row in zip_longest(*cells, fillvalue="")]
    with replacing(path, force=force) as beside:
        beside.write_text("".join(f"{line}\n" for line in (",".join(columns), *lines)), encoding="utf-8")


def _number(path: Path, line_number: int, line: str) -> float:
    try:
        value = float("nan") if "_" in line else float(line)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise InputError(
            f"{path.name}: line {line_number} is {line[:40]!r}",
            "one finite number per line is expected, its decimals behind a point",
        )
    return value
