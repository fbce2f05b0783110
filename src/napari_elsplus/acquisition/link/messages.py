"""What passes between the engine's process and its client."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.instrument.calibration import Calibration

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
class Reply:
    """What a command returned or raised."""

    number: int
    result: Any = None
    error: BaseException | None = None


@dataclass(frozen=True, slots=True)
class Activated:
    """The engine's active calibration has changed."""

    calibration: Calibration | None
