"""Edits of the package's source in a copy of the checkout: mistakes that tests must notice, rules that are left out."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT: Final = Path(__file__).resolve().parents[2]
PACKAGE: Final = Path("src/napari_elsplus")


@dataclass(frozen=True)
class Edit:
    """Text of a module, and what replaces it.

    Parameters
    ----------
    module : str
        Module below the package's folder, with slashes and without suffix.
    old, new : str
        Text that occurs once, and its replacement.
    """

    module: str
    old: str
    new: str

    def apply(self, checkout: Path) -> None:
        """Edit a copy of the checkout.

        Raises
        ------
        ValueError
            If the text does not occur exactly once.
        """
        path = checkout / PACKAGE / f"{self.module}.py"
        text = path.read_text("utf-8")
        if text.count(self.old) != 1:
            raise ValueError(f"{self.old!r} occurs {text.count(self.old)} times in {self.module}")
        path.write_text(text.replace(self.old, self.new), "utf-8")


@contextmanager
def copied_checkout(folder: Path, *parts: str, without: str = ".*") -> Iterator[Path]:
    """Copy parts of the checkout into a folder, for the time of the context.

    Parameters
    ----------
    folder : pathlib.Path
        Is made, and removed in the end.
    parts : str
        Folders and files of the checkout.
    without : str
        Pattern of file names that are not copied.
    """
    for part in parts:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns(without))
        else:
            shutil.copy(ROOT / part, folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder)
