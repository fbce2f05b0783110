"""Messages between the engine's process and its client."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeAlias

if TYPE_CHECKING:
    import sys
    from collections.abc import Mapping
    from multiprocessing.connection import Connection

    from napari_elsplus.instrument.calibration import Calibration

    if sys.platform == "win32":
        from multiprocessing.connection import PipeConnection

        Channel: TypeAlias = Connection[Any, Any] | PipeConnection[Any, Any]
    else:
        Channel: TypeAlias = Connection[Any, Any]

HEARTBEAT_S: Final = 0.5
"""Interval of heartbeats; chosen: a tenth of the default timeout."""
HEARTBEAT_TIMEOUT_S: Final = 5.0
"""Default time without a heartbeat until the galvo is parked; chosen: a window at work pauses for less."""
QUIT: Final = "quit"
"""Name of the request that ends the process; closing the connection ends it, too."""


@dataclass(frozen=True, slots=True)
class Request:
    """Execute a command of :mod:`napari_elsplus.acquisition.link.commands`."""

    number: int
    name: str
    arguments: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The client is alive."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Result or exception of a command."""

    number: int
    result: Any = None
    error: BaseException | None = None


@dataclass(frozen=True, slots=True)
class Activated:
    """The engine's active calibration has changed."""

    calibration: Calibration | None
