"""Connections between the rehearsal and the processes that it starts."""

from __future__ import annotations

import json
import os
from multiprocessing.connection import Client
from typing import TYPE_CHECKING, Any, Final, NamedTuple

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
