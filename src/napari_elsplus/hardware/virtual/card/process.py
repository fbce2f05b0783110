"""The virtual card in a process of its own, which outlives the one that drives it, as a real card does.

Run as ``python -m napari_elsplus.hardware.virtual.card.process``; it prints its address as one line of JSON.
"""

from __future__ import annotations

import json
import secrets
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Client, Connection, Listener
from typing import Any, Final, cast

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.detached import DETACHED
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.card.grpc_server import CardServer
from napari_elsplus.hardware.virtual.timeline import Program, StrobeTrain

LINGER_S: Final = 3.0
"""Seconds without a holder after which the card ends; chosen: longer than a guardian takes to come."""
START_S: Final = 30.0
"""Seconds in which the first holder must come; chosen for a busy computer."""
Place = dict[str, Any]
"""Address of the gRPC server, port and key of the bench's connection."""


class RemoteCard(ClosedOnExit):
    """A virtual card in another process, as the bench uses it.

    Parameters
    ----------
    place : dict
        Its address, as it was printed.
    """

    def __init__(self, place: Place) -> None:
        self.place, self.address = place, str(place["grpc"])
        self._lock = threading.Lock()
        self._connect = partial(Client, ("127.0.0.1", place["port"]), authkey=bytes.fromhex(place["key"]))
        self._wire, self._interrupted = self._connect(), False
        self._version, self._programs = -1, list[Program]()

    @property
    def last_volts(self) -> float:
        """Voltage on the output now."""
        return float(self._request("last_volts"))

    @property
    def laser_on(self) -> bool:
        """Level of the digital line to the laser."""
        return bool(self._request("laser_on"))

    def strobe(self, train: StrobeTrain | None) -> None:
        """Wire a train of edges to the strobe's terminal."""
        self._request("strobe", train)

    def programs(self) -> list[Program]:
        """Return the last programs of the output; transferred only if they changed."""
        version, programs = self._request("programs", self._version)
        if programs is not None:
            self._version, self._programs = version, programs
        return self._programs

    def break_with(self, code: int) -> None:
        """Inject a fault; see :meth:`napari_elsplus.hardware.virtual.card.card.VirtualCard.break_with`."""
        self._request("break_with", code)

    def inject(self, refuse_s: float = 0.0, **changes: Any) -> None:
        """Change the faults; see :meth:`napari_elsplus.hardware.virtual.card.card.VirtualCard.inject`."""
        self._request("inject", {"refuse_s": refuse_s, **changes})

    def close(self) -> None:
        """Release the card, which ends when it has no holder."""
        self._wire.close()

    def _request(self, what: str, argument: object = None) -> Any:
        with self._lock:
            try:
                if self._interrupted and not self._wire.closed:
                    before, self._wire = self._wire, self._connect()
                    before.close()  # what came first through it would answer the call before
                self._interrupted = True
                self._wire.send((what, argument))
                answer = self._wire.recv()
                self._interrupted = False
                return answer
            except (OSError, EOFError) as error:
                raise DeviceError("the virtual card's process has ended", "open the rig again") from error


def start_card() -> RemoteCard:
    """Start a card in a process of its own.

    Raises
    ------
    DeviceError
        If it does not start.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, **DETACHED
    )
    assert process.stdout is not None
    with process.stdout:
        line = process.stdout.readline()
    if not line:
        raise DeviceError("the virtual card did not start", "see the messages above")
    card = RemoteCard(json.loads(line))
    threading.Thread(target=process.wait, name="simulated card's end", daemon=True).start()  # no zombie is left
    return card


def serve() -> None:
    """Serve a card until it has no holder."""
    key = secrets.token_bytes(16)
    card = VirtualCard()
    held = _Holders()
    with CardServer(card) as server, Listener(("127.0.0.1", 0), authkey=key) as listener:
        place = {"grpc": server.address, "port": cast("tuple[str, int]", listener.address)[1], "key": key.hex()}
        sys.stdout.write(json.dumps(place) + "\n")
        sys.stdout.flush()
        threading.Thread(target=_accept, args=(listener, card, held), daemon=True).start()
        held.wait_until_none()


class _Holders:
    """Number of connections that hold the card, and the time since there is none."""

    def __init__(self) -> None:
        self._count, self._changed_s = 0, time.monotonic() + START_S - LINGER_S
        self._lock = threading.Lock()

    def change(self, by: int) -> None:
        with self._lock:
            self._count, self._changed_s = self._count + by, time.monotonic()

    def wait_until_none(self) -> None:
        while self._count or time.monotonic() - self._changed_s < LINGER_S:
            time.sleep(0.1)


def _accept(listener: Listener, card: VirtualCard, held: _Holders) -> None:
    while True:
        with suppress(OSError, EOFError):  # a caller without the key, or one that went away
            wire = listener.accept()
            threading.Thread(target=_answer, args=(wire, card, held), daemon=True).start()


def _answer(wire: Connection[Any, Any], card: VirtualCard, held: _Holders) -> None:
    held.change(1)
    try:
        with wire, suppress(OSError, EOFError):  # the caller went away
            while True:
                what, argument = wire.recv()
                wire.send(_reply(card, what, argument))
    finally:
        held.change(-1)


def _reply(card: VirtualCard, what: str, argument: Any) -> Any:
    if what == "programs":
        return card.version, None if card.version == argument else card.programs()
    asked = getattr(card, what)
    if what == "inject":
        return asked(**argument)
    return asked(argument) if callable(asked) else asked


if __name__ == "__main__":
    serve()
