"""A folder of TIFF files, one frame each, in natural order: frame2 comes before frame10."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource
from napari_elsplus.io.formats.tiff import TIFF, read_image

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class TiffFolder(FrameSource):
    """Frames of a folder, (rows, cols) each; a file is opened when its frame is read."""

    def __init__(self, path: Path) -> None:
        self.files = sorted(
            (
                file
                for file in path.iterdir()
                if file.name.lower().endswith(TIFF.suffixes) and not file.name.startswith(".")
            ),
            key=natural_order,
        )
        if not self.files:
            raise InputError(
                f"the folder {path.name} holds no TIFF files", f"name a folder of {' or '.join(TIFF.suffixes)} files"
            )
        first = read_image(self.files[0])
        super().__init__(path, (len(self.files), *first.shape), first.dtype)

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored."""
        image = read_image(self.files[index])
        if image.dtype != self.dtype:
            raise InputError(
                f"{self.files[index].name} holds {image.dtype} pixels, the first file {self.dtype}",
                "keep one recording per folder",
            )
        if image.shape != self.shape[1:]:
            raise InputError(
                f"{self.files[index].name} has shape {image.shape}, the first file {self.shape[1:]}",
                "keep one recording per folder",
            )
        return image


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Return a sort key of `path` by which numbers in file names compare as numbers.

    Examples
    --------
    >>> from pathlib import Path
    >>> [p.name for p in sorted(map(Path, ["f10.tif", "f2.tif"]), key=natural_order)]
    ['f2.tif', 'f10.tif']
    """
    parts = re.split(r"([0-9]+)", path.name.lower())
    return [(int(part), "") if part.isdecimal() and part.isascii() else (-1, part) for part in parts]


TIFF_FOLDER: Final = FileFormat("folder of TIFFs", (), TiffFolder, folder_markers=())
