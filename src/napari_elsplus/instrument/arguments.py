"""What public functions take: raw frames, a calibration, a path, a choice; anything else is refused with the remedy."""

from __future__ import annotations

import os
from enum import StrEnum
from typing import Any

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration


class Choice(StrEnum):
    """An option with a few values; ``Choice(value)`` raises an InputError with all of them where there is none."""

    @classmethod
    def _missing_(cls, value: object) -> Any:
        names = ", ".join(repr(member.value) for member in cls)
        raise InputError(f"{value!r:.60} is no {_words(cls.__name__)}", f"choose one of {names}")


def require_frames(frames: object) -> None:
    """Refuse `frames` that are no sequence of raw frames (rows, cols); recordings and lazy sequences are not read.

    Raises
    ------
    InputError
        If they are a name, a single frame, or something else.
    """
    if isinstance(frames, str | os.PathLike):
        name = os.fspath(frames)
        remedy = f"give `open_recording({name!r:.60})`, which reads them"
        raise InputError(f"frames are expected, {name!r:.60} is a name", remedy)
    if isinstance(frames, Calibration) or not (hasattr(frames, "__len__") and hasattr(frames, "__getitem__")):
        raise InputError(
            f"frames are expected, {_described(frames)} was given",
            "give an array (T, rows, cols), a list of arrays (rows, cols), or an open recording",
        )
    dimensions = getattr(frames, "ndim", 3)
    if isinstance(frames, list | tuple) and frames:
        dimensions = 1 + getattr(frames[0], "ndim", 0)
    if dimensions != 3:
        remedy = "give frames[np.newaxis] for a single frame" if dimensions == 2 else "give a series of (rows, cols)"
        raise InputError(f"frames (T, rows, cols) have 3 dimensions, these {dimensions}", remedy)


def require_calibration(calibration: object) -> None:
    """Refuse a `calibration` that is none.

    Raises
    ------
    InputError
        If it is absent, the name of its file, the draft that contains it, or something else.
    """
    if isinstance(calibration, Calibration):
        return
    if isinstance(calibration, str | os.PathLike):
        name = os.fspath(calibration)
        raise InputError(
            f"a calibration is expected, {name!r:.60} is a name",
            f"give `load_calibration({name!r:.60})`, which reads it",
        )
    if calibration is None:
        raise InputError("there is no calibration", "give `recording.calibration`, or that of `load_calibration(path)`")
    held = "its attribute `calibration`" if isinstance(getattr(calibration, "calibration", None), Calibration) else ""
    raise InputError(
        f"a calibration is expected, {_described(calibration)} was given",
        f"give {held or '`load_calibration(path)` or `recording.calibration`'}",
    )


def require_path(path: object) -> None:
    """Refuse a `path` that is no path.

    Raises
    ------
    InputError
        If it is neither text nor path-like.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"a path is expected, {_described(path)} was given", "give the name of a file or folder")


def _described(value: object) -> str:
    """Return the type of a value, and its value if it is a number."""
    kind = type(value).__name__
    return f"the number {value}" if isinstance(value, int | float) else f"a value of type {kind}"


def _words(name: str) -> str:
    """Return the name of a class in words."""
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in name).strip()
