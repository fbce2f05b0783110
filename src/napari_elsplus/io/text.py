"""Lines of text files that a user names, with one message for each reason why they cannot be read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
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
