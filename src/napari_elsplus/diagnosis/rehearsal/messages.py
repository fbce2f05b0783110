"""Connections between the rehearsal and the processes that it starts."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from multiprocessing.connection import Client
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from napari_elsplus.acquisition.link.messages import Channel

ADDRESS: Final = "ELSPLUS_REHEARSAL"
"""Environment variable with port and key of the rehearsal's listener, as JSON."""


class Exposures(NamedTuple):
    """Frames of the virtual camera since it was last started."""

    frame: int
    """The newest frame."""
    read_out_s: float
    """When its last row is read."""
    period_s: float
    first_read_out_s: float
    """When the last row of the first frame was read."""


class Answer(NamedTuple):
    """Result of a request, and when it was answered on the clock of the bench."""

    result: Any
    answered_s: float


def report_to_rehearsal(role: str, **facts: Any) -> Channel:
    """Connect a process to the rehearsal that started it.

    Parameters
    ----------
    role : str
        ``window`` or ``engine``.
    **facts
        What the rehearsal needs of it.
    """
    place = json.loads(os.environ[ADDRESS])
    connection = Client(("127.0.0.1", place["port"]), authkey=bytes.fromhex(place["key"]))
    connection.send((role, {"pid": os.getpid(), **facts}))
    return connection


def answer_requests(connection: Channel, target: object) -> None:
    """Call methods of a `target` as the rehearsal requests, until the `connection` ends.

    Each answer is the result, the error instead, and the time of the answer.
    """
    with connection, suppress(EOFError, OSError):
        while True:
            name, arguments, options = connection.recv()
            result, failed = None, None
            try:
                result = getattr(target, name)(*arguments, **options)
            except Exception as error:  # noqa: BLE001 - the rehearsal judges it
                failed = error
            connection.send((result, failed, time.perf_counter()))


def request(connection: Channel, role: str, timeout_s: float, name: str, *arguments: Any, **options: Any) -> Answer:
    """Request a call of a process.

    Parameters
    ----------
    connection : Channel
        To :func:`answer_requests` in the process.
    role : str
        ``window`` or ``engine``, for the message.
    timeout_s : float
        Seconds in which it has to answer.
    name : str
        Name of the method.
    *arguments, **options
        Of the method.

    Returns
    -------
    Answer

    Raises
    ------
    DeviceError
        If the process does not answer.
    """
    connection.send((name, arguments, options))
    if not connection.poll(timeout_s):
        raise DeviceError(f"the {role}'s process did not answer to {name}", "report this")
    result, failed, answered_s = connection.recv()
    if failed is not None:
        raise failed
    return Answer(result, answered_s)
