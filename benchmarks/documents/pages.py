"""Tables and charts put into the documentation's pages, each between its two marks."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path


def require_marks(page: Path, names: Iterable[str]) -> None:
    """Make sure, before anything is measured for it, that a page has a place for each block.

    Parameters
    ----------
    page : pathlib.Path
        A markdown file.
    names : iterable of str
        The blocks that :func:`fill` will be given.

    Raises
    ------
    InputError
        If there is no such page, or it does not mark one of the blocks.
    """
    text = _read(page)
    for name in names:
        if not _marks(name).search(text):
            raise InputError(f"{page.name} has no place for {name!r}", f"mark it <!-- {name} --> <!-- end -->")


def fill(page: Path, blocks: Mapping[str, str]) -> list[str]:
    r"""Put blocks of markdown between their marks, ``<!-- NAME -->`` and ``<!-- end -->``; leave the text around them.

    Parameters
    ----------
    page : pathlib.Path
        A markdown file.
    blocks : mapping
        Name to markdown; names that the page does not mark are left out.

    Returns
    -------
    list of str
        The names that were put.

    Raises
    ------
    InputError
        If there is no such page.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> page = Path(tempfile.mkdtemp()) / "speed.md"
    >>> _ = page.write_text("Before.\n<!-- line -->\nold\n<!-- end -->\n")
    >>> fill(page, {"line": "new", "cores": "nowhere"})
    ['line']
    >>> print(page.read_text())
    Before.
    <!-- line -->
    <BLANKLINE>
    new
    <BLANKLINE>
    <!-- end -->
    <BLANKLINE>
    """
    text = _read(page)
    put = []
    for name, block in blocks.items():
        parts = _marks(name).split(text)
        if len(parts) > 1:
            text = f"{parts[0]}{parts[1]}\n{block}\n\n{parts[2]}{parts[3]}"
            put.append(name)
    with replacing(page, force=True) as path:
        path.write_text(text, encoding="utf-8")
    return put


def _read(page: Path) -> str:
    if not page.is_file():
        raise InputError(f"there is no {page.name} in {page.parent}", "name the folder of the documentation")
    return page.read_text(encoding="utf-8")


def _marks(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
