"""Tables and charts put into the documentation's pages, each between its two marks."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


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
    if not page.is_file():
        raise InputError(f"there is no {page.name} in {page.parent}", "name the folder of the documentation")
    text = page.read_text(encoding="utf-8")
    put = []
    for name, block in blocks.items():
        marks = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
        parts = marks.split(text)
        if len(parts) > 1:
            text = f"{parts[0]}{parts[1]}\n{block}\n\n{parts[2]}{parts[3]}"
            put.append(name)
    with replacing(page, force=True) as path:
        path.write_text(text, encoding="utf-8")
    return put
