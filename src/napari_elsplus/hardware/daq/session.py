"""Sessions with a card: the driver on this computer, or a gRPC device server, whose calls have a time limit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from nidaqmx import GrpcSessionOptions, Task
    from nidaqmx.system import System

CALL_TIMEOUT_S: Final = 2.0
"""Seconds for one call to a card elsewhere; chosen: a hundred times a call's time on a busy computer."""


class Session:
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


def open_session(address: str) -> Session:
    """Return the session with a card.

    Parameters
    ----------
    address : str
        ``host:port`` of a gRPC device server; empty: the driver on this computer.
    """
    if not address:
        return Session(None)
    import grpc
    from nidaqmx import GrpcSessionOptions

    class TimeLimit(grpc.UnaryUnaryClientInterceptor):  # type: ignore[misc] # grpc has no types
        """Gives every call a time limit; nidaqmx gives none."""

        def intercept_unary_unary(self, continuation: Any, details: Any, request: Any) -> Any:
            limited = _Details(details.method, CALL_TIMEOUT_S, details.metadata, details.credentials)
            return continuation(limited, request)

    class _Details(grpc.ClientCallDetails):  # type: ignore[misc] # grpc has no types
        def __init__(self, method: Any, timeout: float, metadata: Any, credentials: Any) -> None:
            self.method, self.timeout, self.metadata, self.credentials = method, timeout, metadata, credentials

    channel = grpc.intercept_channel(grpc.insecure_channel(address), TimeLimit())
    return Session(GrpcSessionOptions(channel, ""))
