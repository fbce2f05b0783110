"""Atomic writing of files: written beside the target, flushed to the disk, then renamed onto it."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

ZARR_MARKERS = ("zarr.json", ".zgroup", ".zarray", ".zattrs")
"""Files by which a folder is a Zarr group or array."""

MAX_NAME_BYTES = 255
"""Bytes of a file's name; of the file systems of Linux, macOS and Windows."""


def real_path(path: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a file without links; also of links in a circle, at which `Path.resolve` fails.

    Parameters
    ----------
    path : path-like
        File or folder; it need not exist.
    """
    return Path(os.path.realpath(path))


def refuse_existing(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Raise an error if a target must not be written, before any work is done for it.

    Parameters
    ----------
    path : path-like
        The file that will be written.
    force : bool
        Replace an existing file instead of refusing it.

    Raises
    ------
    InputError
        If its name is too long, it exists and `force` is not given, is a folder or a device, or lies in a folder that
        does not exist or cannot be written.
    """
    path = Path(path)
    if (size := len(os.fsencode(path.name))) > MAX_NAME_BYTES:
        raise InputError(f"{path.name} is a name of {size} bytes", f"give one of at most {MAX_NAME_BYTES}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}", "create it, or name another output")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {path.parent} may not be written", "name another output")
    if os.path.lexists(path) and not force:
        raise InputError(f"{path} exists", "give --force to replace it, or name another output")
    if path.is_dir() and not (path.suffix == ".zarr" and (path.is_symlink() or _is_zarr(path))):
        raise InputError(f"{path} is a folder, and no Zarr that could be replaced", "name another output")
    if path.exists() and not path.is_dir() and not path.is_file():
        raise InputError(f"{path} is a device or a pipe", "name a file")


def refuse_suffix(path: str | os.PathLike[str], *suffixes: str) -> None:
    """Raise an error if the name of a file that is to be written ends in none of some suffixes.

    Parameters
    ----------
    path : path-like
        The file that will be written.
    *suffixes : str
        In small letters, with their point.

    Raises
    ------
    InputError
        If it has another one, or none.

    Examples
    --------
    >>> refuse_suffix("axial.txt", ".json")
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.InputError: axial.txt has a suffix that cannot be written: let it end in .json
    """
    name = Path(path).name
    if not name.lower().endswith(suffixes):
        raise InputError(f"{name} has a suffix that cannot be written", f"let it end in {', '.join(suffixes)}")


@contextmanager
def replacing(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Write a file beside its target and rename it at the end.

    On any error, Ctrl-C included, what was written is removed and the target stays as it was, unless it was replaced
    already. A link is replaced by what was written, and the file or folder that it names stays: it may be an earlier
    result under its own name.

    Parameters
    ----------
    path : path-like
        The target.
    force : bool
        Replace an existing target instead of refusing it.

    Yields
    ------
    pathlib.Path
        Where to write; in the target's folder, with the target's suffixes.

    Raises
    ------
    InputError
        At once, if the target exists and `force` is not given, or its folder does not exist.
    OSError
        Of the disk; one that names no file, or the one beside the target, names the target.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with replacing(folder / "offset.txt") as beside:
    ...     _ = beside.write_text("-12.03")
    >>> (folder / "offset.txt").read_text(), len(list(folder.iterdir()))
    ('-12.03', 1)
    """
    target = Path(path)
    refuse_existing(target, force=force)
    beside, replaced = (target.with_name(f".{token_hex(4)}.{_ending(target.name)}") for _ in range(2))
    try:
        yield beside
        put_in_place(beside, target, replaced)
    except OSError as error:
        named = error.filename
        if named is not None and beside not in (Path(str(named)), *Path(str(named)).parents):
            raise
        problem = error.strerror or "not all of it could be written"
        raise OSError(error.errno, problem, str(target)) from error
    finally:
        _remove(beside)
        _remove(replaced)


@contextmanager
def in_folder(folder: Path) -> Iterator[None]:
    """Make a folder, if it does not exist, for files that are written within the context; on an error without any, not.

    Parameters
    ----------
    folder : pathlib.Path
        Its parents are made, too.

    Raises
    ------
    InputError
        If it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file", "name a folder")
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for made in missing:
            with suppress(OSError):  # it is not empty
                made.rmdir()


def put_in_place(finished: Path, target: Path, replaced: Path) -> None:
    """Flush a finished file or folder to the disk and rename it onto its target, in place of the one or link there.

    Parameters
    ----------
    finished : pathlib.Path
        On the file system of the target.
    target : pathlib.Path
        Its new path.
    replaced : pathlib.Path
        On that file system, too: what a folder replaces, or what replaces one, is moved there, and left to be removed.
    """
    flush(finished)
    if target.is_dir() or finished.is_dir():  # a file takes the place of a file or link only
        with suppress(FileNotFoundError):
            target.replace(replaced)
    try:
        finished.replace(target)
    except BaseException:
        if os.path.lexists(replaced):
            replaced.replace(target)
        raise
    _flush_folder(target.parent)


def remove_unfinished(*targets: Path) -> None:
    """Remove what processes that were killed have left beside the targets; files of other targets stay."""
    for target in targets:
        for unfinished in target.parent.glob(f".????????.{escape(_ending(target.name))}"):
            _remove(unfinished)


def flush(path: Path) -> None:
    """Write a file, or a folder and everything in it, from the system's memory to the disk.

    Parameters
    ----------
    path : pathlib.Path
        The file or folder.
    """
    if path.is_file():
        with path.open("rb+") as file:
            os.fsync(file.fileno())
    elif path.is_dir():
        for inside in path.iterdir():
            flush(inside)
        _flush_folder(path)


def _ending(name: str) -> str:
    """Return the end of a name that has room behind a random beginning: all of it, unless it is nearly too long."""
    return os.fsencode(name)[-MAX_NAME_BYTES + len(".????????.") :].decode(errors="ignore")


def _flush_folder(folder: Path) -> None:
    if os.name != "posix":  # other systems cannot open a folder
        return
    with suppress(OSError):  # of a folder that is not to be read, or a network; the rename itself has succeeded
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _is_zarr(folder: Path) -> bool:
    return any((folder / marker).is_file() for marker in ZARR_MARKERS)


def _remove(path: Path) -> None:
    """Remove a file, a folder, or a link but not what it names."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
