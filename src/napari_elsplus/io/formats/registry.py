"""The registry of file formats: names, suffixes, openers and writers, for every part that reads or writes images.

The napari reader and writers, :func:`napari_elsplus.io.open_recording`, the command line's help, the file dialogs and
the names of files beside a recording all use it. Another package adds a format with :func:`register_format`, or names
a :class:`FileFormat` in its entry points of the group ``napari_elsplus.file_formats``.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import refuse_suffix

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io.formats.source import FrameSource

    Images = Iterable[NDArray[Any]]
    """Images (rows, cols) of one shape and type, each contiguous in memory."""

ENTRY_POINTS: Final = "napari_elsplus.file_formats"
"""Group of the entry points by which installed packages add formats."""


@dataclass(frozen=True, kw_only=True)
class ImageMetadata:
    """Pixel size, frame interval, settings and calibration of finished images, written beside their pixels.

    Parameters
    ----------
    um_per_px : float, optional
        Pixel size, micrometres; the calibration's by default.
    frame_period_s : float, optional
        Time from one image to the next, seconds; the calibration's by default.
    times_s : tuple of float, optional
        (T,) time of each image, seconds, where the period alone does not give them.
    depth_scan : bool
        True for images at successive depths; by default their first axis is time.
    settings : mapping
        Anything else to keep; must be fit for JSON.
    calibration : Calibration, optional
        Kept in the file, without its arrays.
    name : str
        Of the images, where the format keeps one; that of their file by default.

    Examples
    --------
    >>> ImageMetadata(um_per_px=0.96, settings={"mode": "els"}).settings["mode"]
    'els'
    """

    um_per_px: float | None = None
    frame_period_s: float | None = None
    times_s: tuple[float, ...] | None = None
    depth_scan: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    calibration: Calibration | None = None
    name: str = ""

    def __post_init__(self) -> None:
        for name in ("um_per_px", "frame_period_s") if self.calibration is not None else ():
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(self.calibration, name))


@dataclass(frozen=True)
class FileFormat:
    """One format of files.

    Parameters
    ----------
    name : str
        Unique; used in messages and file dialogs.
    suffixes : tuple of str
        Lower case, each with its dot. ``.ome`` before a suffix belongs to it in any format.
    opener : callable, optional
        Path to :class:`~napari_elsplus.io.formats.source.FrameSource`; None where frames cannot be read. Heavy
        decoders are imported in it, so that the registry stays cheap to import.
    writer : callable, optional
        ``writer(path, images, metadata)`` writes all images of a file from first to last and returns their number.
    allocator, filler : callable, optional
        In place of `writer`: ``allocator(path, (T, rows, cols), dtype, metadata)`` creates a file of zeros, and
        ``filler(path, first, images)`` writes images into it from an index on and returns their number; it is called
        in any order, and by several processes.
    pyramid_writer : callable, optional
        ``pyramid_writer(path, image, metadata)`` writes a mosaic (rows, cols) with its halved levels; by default it is
        written as a stack of one image.
    written_suffixes : tuple of str
        Suffixes that are written, the usual one first; none where images cannot be written.
    folder_markers : tuple of str, optional
        The format is a folder that contains one of these files, or any folder if empty; None for a single file.
    signatures : tuple of bytes
        First bytes of a file; they identify a file whose suffix is unknown.
    """

    name: str
    suffixes: tuple[str, ...]
    opener: Callable[[Path], FrameSource] | None = None
    writer: Callable[[Path, Images, ImageMetadata], int] | None = None
    allocator: Callable[[Path, tuple[int, int, int], np.dtype[Any], ImageMetadata], object] | None = None
    filler: Callable[[Path, int, Images], int] | None = None
    pyramid_writer: Callable[[Path, NDArray[Any], ImageMetadata], object] | None = None
    written_suffixes: tuple[str, ...] = ()
    folder_markers: tuple[str, ...] | None = None
    signatures: tuple[bytes, ...] = ()

    @property
    def is_folder(self) -> bool:
        """True if a recording of this format is a folder."""
        return self.folder_markers is not None

    def contains_marker(self, folder: Path) -> bool:
        """Return True if a folder contains one of the format's marker files."""
        return any((folder / marker).is_file() for marker in self.folder_markers or ())


CALIBRATION: Final = FileFormat("Calibration", (".json",))
PICTURE: Final = FileFormat("Picture", (".png",))
TABLE: Final = FileFormat("Table", (".csv",))
AXIAL_RESPONSES: Final = FileFormat("Scans", (".json",))

_registered: dict[str, FileFormat] = {}


def register_format(new: FileFormat) -> FileFormat:
    """Add a format of recordings or images to the registry and return it.

    Parameters
    ----------
    new : FileFormat
        With an opener, a writer, or both.

    Raises
    ------
    ValueError
        If its name or one of its suffixes belongs to another format, or a suffix is not lower case with its dot.
    """
    for suffix in (*new.suffixes, *new.written_suffixes):
        if not suffix.startswith(".") or suffix != suffix.lower():
            raise ValueError(f"suffix {suffix!r} of the format {new.name}: lower case with its dot is expected")
    for other in _registered.values():
        if other != new and (other.name == new.name or set(other.suffixes) & set(new.suffixes)):
            raise ValueError(f"the format {new.name} {new.suffixes} conflicts with {other.name} {other.suffixes}")
    _registered[new.name] = new
    return new


def file_formats() -> tuple[FileFormat, ...]:
    """Return all registered formats, those of installed packages included."""
    _load_entry_points()
    return tuple(_registered.values())


def format_of_name(path: Path) -> FileFormat | None:
    """Return the format whose suffix a path has, or None."""
    name = path.name.lower()
    return next((one for one in file_formats() if name.endswith(one.suffixes)), None)


def format_to_read(path: Path) -> FileFormat:
    """Return the format of an existing recording: a folder's by its contents, a file's by suffix, then first bytes.

    Parameters
    ----------
    path : pathlib.Path
        File or folder.

    Raises
    ------
    InputError
        If no format reads it, or it is empty, a device or a pipe.
    OSError
        If there is no such file, or it cannot be read.
    """
    readable = [one for one in file_formats() if one.opener is not None]
    if path.is_dir():
        marked = next((one for one in readable if one.contains_marker(path)), None)
        return marked or next(one for one in readable if one.folder_markers == ())
    if path.stat().st_size == 0 and path.is_file():  # a missing file is reported before an unknown format
        raise InputError(f"{path.name} is empty", "copy or record it again")
    if not path.is_file():
        raise InputError(f"{path.name} is a device or a pipe", "name a file")
    files = [one for one in readable if not one.is_folder]
    named = next((one for one in files if path.name.lower().endswith(one.suffixes)), None)
    if named is not None:
        return named
    with path.open("rb") as file:
        first_bytes = file.read(16)
    found = next((one for one in files if one.signatures and first_bytes.startswith(one.signatures)), None)
    if found is None:
        raise InputError(f"{path.name} is in no known format", f"name one of: {supported_recordings()}")
    return found


def format_to_write(path: Path) -> FileFormat:
    """Return the format that writes a path's suffix.

    Raises
    ------
    InputError
        If no format writes it.
    """
    name = path.name.lower()
    refuse_suffix(path, *(suffix for one in file_formats() for suffix in one.written_suffixes))
    return next(one for one in file_formats() if name.endswith(one.written_suffixes))


def supported_recordings() -> str:
    """Return the readable formats with their suffixes, in one line of help.

    Examples
    --------
    >>> supported_recordings().split(", ")[0]
    'TIFF (.tif .tiff .btf)'
    """
    readable = (one for one in file_formats() if one.opener is not None)
    return ", ".join(f"{one.name} ({' '.join(one.suffixes)})" if one.suffixes else one.name for one in readable)


def foreign_file(path: Path) -> InputError:
    """Return the error that the file at a path is no recording and no calibration."""
    return InputError(
        f"{path.name} is neither a recording nor a calibration", f"recordings are {supported_recordings()}"
    )


def recording_stem(name: str) -> str:
    """Return the file name of a recording without its suffixes and without ``.ome``.

    Examples
    --------
    >>> [recording_stem(name) for name in ("scan.ome.tif", "scan.btf", "scan.2.npy", "scans")]
    ['scan', 'scan', 'scan.2', 'scans']
    """
    suffixes = sorted({suffix for one in file_formats() for suffix in one.suffixes}, key=len, reverse=True)
    stem = name
    for suffix in (*suffixes, ".ome"):
        if stem.lower().endswith(suffix) and len(stem) > len(suffix):
            stem = stem[: -len(suffix)]
    return stem


def dialog_filter(*formats: FileFormat, writing: bool = False) -> str:
    """Return a file dialog's filter (Qt's spelling), one line for each format.

    Parameters
    ----------
    *formats : FileFormat
        What the user may choose.
    writing : bool
        Only the usual suffix that each format's writer writes.

    Examples
    --------
    >>> dialog_filter(PICTURE, TABLE)
    'Picture (*.png);;Table (*.csv)'
    """
    return ";;".join(
        f"{one.name} ({_patterns(one.written_suffixes[:1] if writing else one.suffixes)})" for one in formats
    )


def recordings_filter() -> str:
    """Return the file dialog's filter for recordings that are single files."""
    suffixes = [suffix for one in file_formats() if one.opener and not one.is_folder for suffix in one.suffixes]
    return f"Recordings ({_patterns(suffixes)});;All files (*)"


def _patterns(suffixes: Iterable[str]) -> str:
    return " ".join(f"*{suffix}" for suffix in suffixes)


@cache
def _load_entry_points() -> None:
    """Register what installed packages offer; a package that fails costs its format and a warning."""
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            register_format(entry.load())
        except Exception as error:  # noqa: BLE001 - another package's import may raise anything
            warnings.warn(f"the file format {entry.value} is not available: {error!s:.200}", stacklevel=3)
