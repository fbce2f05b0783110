"""Context managers that close what they hold."""

from __future__ import annotations

from typing import Self


class ClosedOnExit:
    """Base of classes with a method ``close``: a context manager that calls it on every way out."""

    def close(self) -> None:
        """Release what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()
