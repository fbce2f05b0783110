"""Which calibration applies to a recording: the one beside it, else the one in it, else the active one."""

from __future__ import annotations

import os
from pathlib import Path

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import FORMAT, Calibration
from napari_elsplus.io.atomic import real_path
from napari_elsplus.io.calibrations import MAX_JSON_BYTES, parse_calibration, read_calibration
from napari_elsplus.io.formats.registry import recording_stem
from napari_elsplus.io.settings import active_calibration


def beside(recording: str | os.PathLike[str], ending: str) -> Path:
    """Return the path of a file that belongs to a recording: its name without suffixes, then an ending.

    Parameters
    ----------
    recording : path-like
        File or folder.
    ending : str
        Replaces the recording's suffixes.

    Examples
    --------
    >>> beside("scan.ome.tif", ".depths.csv").name
    'scan.depths.csv'
    """
    path = Path(recording)
    path = path if path.name else real_path(path)  # "." has no name
    return path.with_name(recording_stem(path.name) + ending)


def existing_beside(recording: str | os.PathLike[str], ending: str) -> Path | None:
    """Return the file that belongs to a recording, if it exists; also under the recording's full name plus ending.

    Parameters
    ----------
    recording : path-like
        File or folder.
    ending : str
        As for :func:`beside`. Earlier versions appended it to the full name of recordings in .btf.
    """
    named = beside(recording, ending)
    candidates = (named, named.with_name(real_path(recording).name + ending))
    return next((path for path in candidates if os.path.isfile(path)), None)  # false of names that are too long


def is_calibration(path: str | os.PathLike[str]) -> bool:
    """Return True if the file at `path` declares itself a calibration; a broken one is refused when it is read."""
    path = Path(path)
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            return FORMAT.encode() in file.read(MAX_JSON_BYTES)
    except OSError:
        return False


def calibration_beside(recording: str | os.PathLike[str]) -> Path | None:
    """Return the calibration file that lies beside a recording, or None.

    In this order: NAME.calibration.json, NAME.json, in a folder its calibration.json, and calibration.json in the
    recording's folder. Files of another kind are passed over.

    Parameters
    ----------
    recording : path-like
        A recording, for example NAME.ome.tif.
    """
    recording = Path(recording)
    named = [existing_beside(recording, ending) for ending in (".calibration.json", ".json")]
    inside = [recording / "calibration.json"] if recording.is_dir() else []
    candidates = [*named, *inside, beside(recording, ".json").with_name("calibration.json")]
    return next(
        (path for path in candidates if path is not None and os.path.isfile(path) and is_calibration(path)), None
    )


def find_calibration(
    recording: Path, embedded: str | None = None, active: Path | None = None
) -> tuple[Calibration | None, Path | None]:
    """Return the calibration that applies to a recording and its file: beside the recording, in it, else the active.

    Parameters
    ----------
    recording : pathlib.Path
        File or folder.
    embedded : str, optional
        JSON text of the calibration in the recording; it has no background, no flat field and no file.
    active : pathlib.Path, optional
        File of the active calibration; None where only a calibration of its own is wanted.

    Raises
    ------
    CalibrationError
        If the one that applies is broken.
    """
    file = calibration_beside(recording)
    if file is None and embedded is not None:
        try:
            return parse_calibration(embedded, name=recording.name), None
        except CalibrationError as error:
            raise CalibrationError(f"calibration in {error.problem}", "name another with -c") from None
    file = file or active
    return (None, None) if file is None else (read_calibration(file), file)


def active_calibration_for_rig(rig: str | None) -> tuple[Calibration | None, Path | None]:
    """Return the active calibration and its file, unless it was acquired with another `rig`.

    Raises
    ------
    CalibrationError
        If it is broken.
    """
    file = active_calibration()
    if file is None:
        return None, None
    calibration = read_calibration(file)
    acquired = calibration.acquired_with
    return (calibration, file) if acquired is None or acquired.rig in (None, rig) else (None, None)
