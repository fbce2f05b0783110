"""Sessions with a card: the driver on this computer, or a gRPC device server, whose calls have a time limit."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from nidaqmx import GrpcSessionOptions, Task
    from nidaqmx.system import System

CALL_TIMEOUT_S: Final = 2.0
"""Seconds for one call to a card elsewhere; chosen: a hundred times a call's time on a busy computer."""


class CardSession:
    """Makes tasks on a card.

    Parameters
    ----------
    options : GrpcSessionOptions, optional
        Of a card elsewhere; None: the driver on this computer.
    """

    def __init__(self, options: GrpcSessionOptions | None) -> None:
        self._options = options

    def task(self) -> Task:
        """Return a new task."""
        from nidaqmx import Task

        return Task(grpc_options=self._options) if self._options else Task()

    def system(self) -> System:
        """Return the driver's system."""
        from nidaqmx.system import System

        return System.remote(self._options) if self._options else System.local()

    def close(self) -> None:
        """Close the channel to a card elsewhere."""
        if self._options is not None:
            self._options.grpc_channel.close()


def open_session(address: str) -> CardSession:
    """Return the session with a card.

    Parameters
    ----------
    address : str
        ``host:port`` of a gRPC device server; empty: the driver on this computer.
    """
    if not address:
        return CardSession(None)
    import grpc
    from nidaqmx import GrpcSessionOptions

    return CardSession(GrpcSessionOptions(TimeLimitedChannel(grpc.insecure_channel(address)), ""))


class TimeLimitedChannel:
    """Channel to a card elsewhere whose calls have a time limit; nidaqmx gives none.

    Each method is made once: nidaqmx asks for all of them, some nine hundred, with every task.

    Parameters
    ----------
    channel : grpc.Channel
        To the gRPC device server.
    """

    def __init__(self, channel: Any) -> None:
        self._channel = channel
        self._methods: dict[str, Callable[..., Any]] = {}

    def unary_unary(self, method: str, *args: Any, **kwargs: Any) -> Callable[..., Any]:
        """Return a method of the server by its name; see `grpc.Channel`."""
        if method not in self._methods:
            unlimited = self._channel.unary_unary(method, *args, **kwargs)
            self._methods[method] = partial(unlimited, timeout=CALL_TIMEOUT_S)
        return self._methods[method]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)
