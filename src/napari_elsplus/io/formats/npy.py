"""NumPy files (.npy): one stack, mapped into memory and never unpickled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource
from napari_elsplus.io.mapped_frames import MappedFrames

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class NumpyFile(FrameSource):
    """Frames of a .npy file, mapped."""

    def __init__(self, path: Path) -> None:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.memmap):
            array.close()
            raise InputError(f"{path.name} is an archive of arrays", "save one stack with numpy.save")
        super().__init__(path, array.shape, array.dtype)
        strides = array.reshape(self.shape).strides
        self._mapped = MappedFrames(path, self.shape, array.dtype, array.offset, strides)

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), a read-only view of the file."""
        return self._mapped.frame(index)

    def close(self) -> None:
        """Release the file."""
        self._mapped.close()


NPY: Final = FileFormat("NumPy", (".npy",), NumpyFile, signatures=(b"\x93NUMPY",))
