"""Sessions with a card elsewhere: every call has a time limit, and methods are made once."""

from __future__ import annotations

from typing import Any

from napari_elsplus.hardware.daq.session import CALL_TIMEOUT_S, TimeLimitedChannel, open_session
from napari_elsplus.hardware.virtual.card.process import start_card


class Channel:
    """Notes which methods are made, and how they are called."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.calls: list[tuple[str, object, dict[str, Any]]] = []
        self.closed = False

    def unary_unary(self, method: str, **kwargs: Any) -> Any:
        del kwargs
        self.made.append(method)
        return lambda request, **options: self.calls.append((method, request, options))

    def close(self) -> None:
        self.closed = True


def test_every_call_has_a_time_limit_and_its_method_is_made_once() -> None:
    channel = Channel()
    limited = TimeLimitedChannel(channel)
    for request in ("first", "second"):
        limited.unary_unary("/card/Write", request_serializer=bytes)(request, metadata=None)
    limited.close()
    assert channel.made == ["/card/Write"]
    assert channel.calls == [
        ("/card/Write", request, {"metadata": None, "timeout": CALL_TIMEOUT_S}) for request in ("first", "second")
    ]
    assert channel.closed


def test_tasks_of_a_session_share_the_methods_of_its_card() -> None:
    with start_card() as card:
        session = open_session(card.address)
        first, second = session.task(), session.task()
        assert first._interpreter._client.ReadAnalogF64 is second._interpreter._client.ReadAnalogF64
        first.close()
        second.close()
        session.close()
