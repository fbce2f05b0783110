"""Text files: lines of those that a user names, and JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import replacing

if TYPE_CHECKING:
    import os
    from pathlib import Path


def read_lines(path: Path, remedy: str, max_bytes: int | None = None) -> list[str]:
    """Return the lines of a text file.

    Parameters
    ----------
    path : pathlib.Path
        UTF-8, with or without a byte order mark.
    remedy : str
        What to name instead, where the file is of another kind.
    max_bytes : int, optional
        Size beyond which it is one; any size by default.

    Raises
    ------
    InputError
        If it does not exist, cannot be read, is no text, or larger.
    """
    try:
        size = path.stat().st_size
        if max_bytes is not None and size > max_bytes:
            raise InputError(f"{path.name} has {size} bytes", remedy)
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(f"there is no file {path}", "check the path") from None
    except ValueError:
        raise InputError(f"{path.name} is no text", remedy) from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})", "check the path and its permissions") from None


def read_json(path: Path, remedy: str) -> Any:
    """Return the content of a JSON file; parameters and errors as of :func:`read_lines`, also for what is no JSON."""
    try:
        return json.loads("\n".join(read_lines(path, remedy)))
    except (ValueError, RecursionError):
        raise InputError(f"{path.name} is no JSON file", remedy) from None


def write_json(
    path: str | os.PathLike[str],
    content: Any,
    *,
    indent: int | None = None,
    allow_nan: bool = True,
    force: bool = False,
) -> None:
    """Write content fit for JSON to a file, beside it first.

    Parameters
    ----------
    path : path-like
        The file.
    content : object
        Numbers, strings, lists and dicts.
    indent : int, optional
        Spaces for each level; one line by default.
    allow_nan : bool
        Write NaN as Python reads it; otherwise raise a ValueError.
    force : bool
        Replace an existing file instead of refusing it.
    """
    with replacing(path, force=force) as beside:
        beside.write_text(json.dumps(content, indent=indent, allow_nan=allow_nan) + "\n", encoding="utf-8")
