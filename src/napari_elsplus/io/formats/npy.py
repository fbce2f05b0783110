"""NumPy files (.npy): one stack, mapped into memory and never unpickled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource
from napari_elsplus.io.stored_frames import StoredFrames

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class NumpyFile(FrameSource):
    """Frames of a .npy file; in Fortran's order, in which each is spread over the file, they are mapped."""

    def __init__(self, path: Path) -> None:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.memmap):
            array.close()
            raise InputError(f"{path.name} is an archive of arrays", "save one stack with numpy.save")
        super().__init__(path, array.shape, array.dtype)
        in_order = array.flags.c_contiguous
        self._mapped = None if in_order else array.reshape(self.shape)
        self._stored = StoredFrames(path, self.shape[1:], array.dtype, array.offset) if in_order else None

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored."""
        if self._stored is not None:
            return self._stored.frame(index)
        assert self._mapped is not None
        return np.asarray(self._mapped[index])

    def close(self) -> None:
        """Release the file."""
        self._mapped = None
        if self._stored is not None:
            self._stored.close()


NPY: Final = FileFormat("NumPy", (".npy",), NumpyFile, signatures=(b"\x93NUMPY",))
