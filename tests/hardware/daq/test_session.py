"""Sessions with a card elsewhere: every call has a time limit, and methods are made once."""

from __future__ import annotations

import subprocess
import sys
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


SERVERS_THAT_END = """
import time
from concurrent.futures import ThreadPoolExecutor

from napari_elsplus.hardware.daq.session import open_session
import grpc

for _ in range(30):
    server = grpc.server(ThreadPoolExecutor(1))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    session = open_session(f"127.0.0.1:{port}")
    channel = session._options.grpc_channel._channel
    grpc.channel_ready_future(channel).result(10)
    call = channel.unary_unary("/card/Read").future(b"")
    server.stop(0)
    time.sleep(0.05)
    session.close()
"""


def test_a_server_that_ends_writes_nothing_between_the_messages() -> None:
    """One in four wrote "Got goaway" with a date and the place in gRPC's source."""
    done = subprocess.run([sys.executable, "-c", SERVERS_THAT_END], capture_output=True, text=True, check=True)
    assert done.stderr == ""
