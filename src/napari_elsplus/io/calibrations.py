"""Calibration files: NAME.json for the numbers, NAME.npz beside it for arrays."""

from __future__ import annotations

import json
import math
import warnings
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.arguments import require_calibration, require_path
from napari_elsplus.instrument.calibration import ARRAYS, ARRAYS_KEY, DISTORTION_SHAPE, Calibration
from napari_elsplus.io.atomic import refuse_existing, refuse_suffix, replacing

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable

    from numpy.typing import NDArray

MAX_JSON_BYTES: Final = 4 << 20
"""Chosen: a calibration has some kilobytes; a larger file is another one, named by mistake."""
MAX_ARRAYS_BYTES: Final = 1 << 30
"""Chosen: the background of a 20-megapixel camera unpacks to 80 MB; more is a forged or foreign archive."""
_HEADER_READERS: Final = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""Readers of the headers of .npy arrays, by the format's version."""


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration, with its arrays (background, flat field, ...) where they lie beside it.

    Parameters
    ----------
    path : path-like
        NAME.json; NAME.npz is read too if it exists. It is never unpickled.

    Returns
    -------
    Calibration
        Validated; keys that this version does not know are kept.

    Raises
    ------
    CalibrationError
        If the file is missing, broken, of another kind or of a newer version, or holds NaN or an impossible number; if
        an array is absent without which it is wrong.

    Warns
    -----
    UserWarning
        If another array is absent that was saved with it.
    """
    require_path(path)
    path = Path(path)
    text = _read_text(path)
    calibration = parse_calibration(text, name=path.name)
    arrays = _read_arrays(path.with_suffix(".npz"), calibration)
    calibration = calibration.model_copy(update=arrays)
    missing = calibration.missing_array()
    if missing is not None:
        raise CalibrationError(
            f"{path.name} needs the {missing.replace('_', ' ')} in {path.with_suffix('.npz').name}, which is absent",
            "put that file beside it, or calibrate again",
        )
    absent = [name.replace("_", " ") for name in _listed_arrays(text) if name not in arrays]
    if absent:
        warnings.warn(
            f"{path.name} was saved with {' and '.join(absent)}, which {path.with_suffix('.npz').name} lacks: put the "
            "file that was saved with it beside it, or calibrate again",
            stacklevel=2,
        )
    return calibration


def write_calibration(path: str | os.PathLike[str], calibration: Calibration, force: bool = False) -> Path:
    """Write a calibration as NAME.json and, if it has arrays, NAME.npz beside it.

    Parameters
    ----------
    path : path-like
        NAME.json.
    calibration : Calibration
        The record and its arrays.
    force : bool
        Replace existing files; arrays that no longer belong to the record are then removed.

    Returns
    -------
    pathlib.Path
        The JSON file.

    Raises
    ------
    InputError
        If a file exists and `force` is not given, the folder does not exist, or `path` does not end in .json.
    CalibrationError
        If the record cannot be written as JSON.
    """
    require_path(path)
    require_calibration(calibration)
    path = Path(path)
    refuse_suffix(path, ".json")
    beside = path.with_suffix(".npz")
    arrays = {name: value for name in ARRAYS if (value := getattr(calibration, name)) is not None}
    refuse_existing(beside, force=force)
    text = format_calibration(calibration, indent=1, arrays=arrays)
    with replacing(path, force=force) as json_path:
        json_path.write_text(text + "\n", encoding="utf-8")
        if arrays:
            with replacing(beside, force=force) as npz_path, npz_path.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)
    if not arrays:
        beside.unlink(missing_ok=True)
    return path


def parse_calibration(text: str, *, name: str = "calibration") -> Calibration:
    """Parse the JSON `text` of a calibration.

    Parameters
    ----------
    text : str
        As :func:`format_calibration` returns it.
    name : str
        Of the file that it comes from, for messages.

    Raises
    ------
    CalibrationError
        As :func:`read_calibration`.
    """
    try:
        content = json.loads(text, parse_constant=_refuse_constant, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{name} is no calibration ({error!s:.80})", "calibrate again") from None
    try:
        return Calibration.parse(content)
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error.problem}", error.remedy) from None


def format_calibration(calibration: Calibration, indent: int | None = None, arrays: Iterable[str] = ()) -> str:
    """Return a calibration as JSON text, without its arrays.

    Parameters
    ----------
    calibration : Calibration
        What to write.
    indent : int, optional
        Spaces for each level; one line by default.
    arrays : iterable of str
        Names of the arrays that are saved beside it; none by default.

    Raises
    ------
    CalibrationError
        If an unknown key holds NaN or anything else that JSON cannot represent.
    """
    listed = {ARRAYS_KEY: names} if (names := list(arrays)) else {}
    try:
        return json.dumps(calibration.content() | listed, indent=indent, allow_nan=False)
    except (ValueError, TypeError, RecursionError) as error:
        raise CalibrationError(f"the calibration cannot be written ({error!s:.80})", "calibrate again") from None


def _read_text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise CalibrationError(f"{path.name} is no file", "name the .json file that `calibrate` wrote")
        if size > MAX_JSON_BYTES:
            raise CalibrationError(f"{path.name} has {size} bytes", "name the .json file that `calibrate` wrote")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise CalibrationError(f"there is no file {path}", "name the .json file that `calibrate` wrote") from None
    except UnicodeDecodeError:
        raise CalibrationError(f"{path.name} is no text", "name the .json file that `calibrate` wrote") from None
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path} cannot be read ({error!s:.80})", "check the path and its permissions") from None


def _listed_arrays(text: str) -> list[str]:
    """Return the names of the arrays that were saved with a record; files of earlier versions have none."""
    listed = json.loads(text).get(ARRAYS_KEY)
    return [name for name in ARRAYS if name in listed] if isinstance(listed, list) else []


def _read_arrays(path: Path, calibration: Calibration) -> dict[str, NDArray[np.float32]]:
    if not path.exists():
        return {}
    try:
        if not zipfile.is_zipfile(path):
            raise CalibrationError(f"{path.name} holds no named arrays", "calibrate again")
        with np.load(path, allow_pickle=False) as file:
            unpacked = sum(member.file_size for member in file.zip.infolist())
            if unpacked > MAX_ARRAYS_BYTES:
                raise CalibrationError(f"{path.name} unpacks to {unpacked} bytes", "calibrate again")
            present = [name for name in ARRAYS if name in file]
            for name in present:
                _refuse_forged_header(file.zip, f"{name}.npy")
            arrays = {name: _checked(path, name, file[name]) for name in present}
    except CalibrationError:
        raise
    except Exception as error:  # noqa: BLE001 - of a spoilt archive zipfile, zlib, tokenize and numpy raise their own
        raise CalibrationError(f"{path.name} cannot be read ({error!s:.80})", "calibrate again") from None
    frame, background = calibration.frame, arrays.get("background")
    if frame is not None and background is not None and background.shape != frame.shape:
        raise CalibrationError(
            f"{path.name}: the background is {background.shape}, the frame {frame.shape}",
            "it belongs to another calibration: calibrate again",
        )
    correction = arrays.get("scan_correction")
    if frame is not None and correction is not None and len(correction) != frame.shape[0]:
        raise CalibrationError(
            f"{path.name}: the scan correction has {len(correction)} rows, the frame {frame.shape[0]}",
            "it belongs to another calibration: calibrate again",
        )
    return arrays


def _refuse_forged_header(archive: zipfile.ZipFile, member: str) -> None:
    """Raise ValueError if an array's header declares other than the archive holds: numpy allocates what it declares."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADER_READERS:
            raise ValueError(f"{member} has version {version}")
        shape, _, dtype = _HEADER_READERS[version](file)
        held = archive.getinfo(member).file_size - file.tell()
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != held:
        raise ValueError(f"{member} declares {shape} of {dtype}, and holds {held} bytes")


def _checked(path: Path, name: str, array: NDArray[Any]) -> NDArray[np.float32]:
    if array.ndim != ARRAYS[name] or array.size == 0 or array.dtype.kind not in "uif":
        raise CalibrationError(
            f"{path.name}: the {name} has shape {array.shape} and type {array.dtype}", "calibrate again"
        )
    with np.errstate(over="ignore"):
        image = np.ascontiguousarray(array, np.float32)
    if name == "distortion" and image.shape != DISTORTION_SHAPE:
        raise CalibrationError(f"{path.name}: the distortion has shape {image.shape}, not (2, 10)", "calibrate again")
    if not np.isfinite(image).all():
        raise CalibrationError(f"{path.name}: the {name} holds NaN or infinity", "calibrate again")
    return image


def _refuse_constant(token: str) -> float:
    raise ValueError(f"it holds {token}, which is no number")


def _finite(token: str) -> float:
    value = float(token)
    if not math.isfinite(value):
        raise ValueError(f"{token} is out of range")
    return value
