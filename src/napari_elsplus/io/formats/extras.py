"""Decoders that not every user needs: optional dependencies, named when they are missing."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def extra_needed(extra: str, files: str) -> Iterator[None]:
    """Name the extra of this package that installs what an import within the context does not find.

    Parameters
    ----------
    extra : str
        Name of the extra in ``pyproject.toml``.
    files : str
        The files that need it, as the first word of the message.

    Raises
    ------
    InputError
        If a module is not installed.

    Examples
    --------
    >>> with extra_needed("video", "AVI files"):
    ...     import no_such_decoder
    Traceback (most recent call last):
    napari_elsplus.errors.InputError: AVI files need the extra `video`: pip install "napari-elsplus[video]"
    """
    try:
        yield
    except ModuleNotFoundError:
        raise InputError(f"{files} need the extra `{extra}`", f'pip install "napari-elsplus[{extra}]"') from None
