"""Python scripts that repeat the work of a panel, written in the public interface of the package."""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.errors import CalibrationError, InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from napari_elsplus.viewing.stack import Stack


def write_script(title: str, body: str, imports: Sequence[str] = (), standard: Sequence[str] = ()) -> str:
    """Return a script that has a title as its docstring, imports the package as ``elsplus``, and runs a body.

    Parameters
    ----------
    title : str
        One sentence.
    body : str
        Statements.
    imports : sequence of str
        Import statements for what the public interface lacks.
    standard : sequence of str
        Import statements for the standard library.
    """
    blocks = [f'"""{title}"""', "\n".join(standard), "\n".join(["import napari_elsplus as elsplus", *sorted(imports)])]
    return "\n\n".join(block for block in (*blocks, body.strip("\n")) if block) + "\n"


def recording_script(
    title: str, stack: Stack, calibration: Path | str | None, body: str, imports: Sequence[str] = ()
) -> str:
    """Return a script that opens a recording and its calibration, then runs a body.

    Parameters
    ----------
    title : str
        One sentence.
    stack : Stack
        Raw frames of a recording in a file.
    calibration : path-like or None
        Its calibration file.
    body : str
        Statements that use ``recording`` and ``calibration``.
    imports : sequence of str
        Import statements for what the public interface lacks.

    Raises
    ------
    InputError
        If the stack has no file.
    CalibrationError
        If the calibration has no file of its own.
    """
    if stack.recording is None:
        raise InputError(f"{stack.name} is simulated and has no file", "save its raw layer, and open that")
    if not calibration:
        raise CalibrationError("the calibration has no file of its own", "save it beside the recording")
    opening = (
        f"recording = elsplus.open_recording({str(stack.recording.path)!r})\n"
        f"calibration = elsplus.load_calibration({str(calibration)!r})\n"
    )
    return write_script(title, opening + body.strip("\n"), imports)
