"""Errors that users can resolve: the problem with its value, and the remedy.

The command line prints such an error as one line, the widgets show it as one notification. Any other exception is a
defect of the software.
"""

from __future__ import annotations


class ElsPlusError(Exception):
    """Base of all errors that the user can resolve.

    Parameters
    ----------
    problem : str
        What is wrong, including the offending value.
    remedy : str
        What to do about it.

    Examples
    --------
    >>> str(ElsPlusError("two bundle images expected, 1 found (threshold 23)", "is the probe lit from the far end?"))
    'two bundle images expected, 1 found (threshold 23): is the probe lit from the far end?'
    """

    def __init__(self, problem: str, remedy: str) -> None:
        super().__init__(problem, remedy)
        self.problem = problem
        self.remedy = remedy

    def __str__(self) -> str:
        return " ".join(f"{self.problem}: {self.remedy}".split())


class InputError(ElsPlusError):
    """A file, array or option that cannot be used as it is."""


class CancelledError(InputError):
    """An operation that the user has cancelled."""


class CalibrationError(ElsPlusError):
    """A calibration that is broken, incomplete, or does not fit what it is applied to."""


class MeasurementError(ElsPlusError):
    """A measurement that the data do not support: no line, no bundle, no texture."""


class DeviceError(ElsPlusError):
    """A camera, card or rig that is absent, busy, or has failed."""


def error_message(error: ElsPlusError | OSError) -> str:
    """Return the problem and the remedy of an error, also of an operating system's, as one line.

    Examples
    --------
    >>> error_message(PermissionError(13, "Permission denied", "els.ome.tif"))
    'els.ome.tif: Permission denied: check the path, its permissions and the free space'
    """
    if isinstance(error, ElsPlusError):
        return str(error)
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}: check the path, its permissions and the free space"
