"""What passes between the engine's process and its client."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

QUIT: Final = "quit"
"""Asks the process to end; hanging up does, too."""


@dataclass(frozen=True, slots=True)
class Command:
    """Call a method."""

    number: int
    name: str
    arguments: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Reply:
    """What a command returned or raised."""

    number: int
    result: Any = None
    error: BaseException | None = None
