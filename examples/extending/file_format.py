"""Add a file format: raw frames in ``NAME.bin`` (uint8, row by row), described by a text header ``NAME.hdr``.

``NAME.hdr`` has a line ``key = value`` for each of rows, cols and, optionally, frame_rate_hz and um_per_px::

    rows = 320
    cols = 640
    frame_rate_hz = 240

Run it with the name of such a recording: ``python file_format.py scan.bin``.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io import FileFormat, FrameSource, open_recording, register_format

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class RawBinary(FrameSource):
    """Frames of a headerless file of uint8, mapped; the base class checks their shape and type.

    Raises
    ------
    InputError
        If the header is missing or wrong, or the file does not hold whole frames.
    """

    def __init__(self, path: Path) -> None:
        header = read_header(path.with_suffix(".hdr"))
        rows, cols = int(header["rows"]), int(header["cols"])
        count, rest = divmod(path.stat().st_size, rows * cols)
        if rest:
            raise InputError(f"{path.name} holds {count} frames and {rest} bytes", "copy or record it again")
        metadata: dict[str, Any] = {"settings": header}
        if "frame_rate_hz" in header:
            metadata["frame_period_s"] = 1 / header["frame_rate_hz"]
        if "um_per_px" in header:
            metadata["um_per_px"] = header["um_per_px"]
        super().__init__(path, (count, rows, cols), np.dtype(np.uint8), metadata)
        self._frames = np.memmap(path, np.uint8, "r", shape=self.shape)

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols); it is called from any thread."""
        return self._frames[index]


def read_header(path: Path) -> dict[str, float]:
    """Return the positive numbers of a header file at `path`."""
    header = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        key, _, value = line.partition("=")
        try:
            header[key.strip()] = float(value)
        except ValueError:
            raise InputError(f"{path.name}: line {number} is {line!r}", "`key = number` is expected") from None
    if not all(header.get(name, 0) >= 1 for name in ("rows", "cols")) or min(header.values()) <= 0:
        raise InputError(f"{path.name} gives {header}", "positive rows and cols are expected")
    return header


FORMAT = register_format(FileFormat("raw binary", (".bin",), RawBinary))

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python file_format.py NAME.bin")
    try:
        with open_recording(sys.argv[1]) as recording:
            print(f"{recording}, {recording.metadata}")
    except InputError as error:
        sys.exit(str(error))
