"""The virtual card behind nidaqmx's own gRPC client: the RPCs that a line scan uses, no more."""

from __future__ import annotations

import queue
import threading
from concurrent import futures
from typing import TYPE_CHECKING, Any, Final

import grpc
import numpy as np
from nidaqmx._stubs import nidaqmx_pb2 as pb
from session_pb2 import Session

from napari_elsplus.closing import ClosedOnExit
from napari_elsplus.hardware.virtual.card.tasks import CardError

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.virtual.card.card import VirtualCard

SERVICE: Final = "nidaqmx_grpc.NiDAQmx"
"""Name of NI's gRPC service."""
DRIVER_VERSION: Final = {0x1272: 25, 0x1923: 0, 0x2F22: 0}
"""Major, minor and update version by attribute."""
PRODUCT_NAME: Final = "virtual card"
"""Product type of the card."""


THREADS: Final = 4
"""Threads that serve calls; chosen: one that hangs leaves others, for the reset around it."""


class DaemonPool(futures.Executor):
    """Threads that do not keep the interpreter alive, and that still serve while it ends.

    So the galvo can be parked when the interpreter ends.
    """

    def __init__(self) -> None:
        self._work: queue.SimpleQueue[tuple[futures.Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        for _ in range(THREADS):
            threading.Thread(target=self._serve, name="simulated card", daemon=True).start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> futures.Future[Any]:
        """Queue a call; see :meth:`concurrent.futures.Executor.submit`."""
        future: futures.Future[Any] = futures.Future()
        self._work.put((future, lambda: fn(*args, **kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads after the queued calls, without waiting; see :meth:`concurrent.futures.Executor.shutdown`."""
        del wait, cancel_futures
        for _ in range(THREADS):
            self._work.put(None)

    def _serve(self) -> None:
        while (work := self._work.get()) is not None:
            future, call = work
            try:
                future.set_result(call())
            except BaseException as error:  # noqa: BLE001 - passed on through the future
                future.set_exception(error)


def answers(card: VirtualCard) -> dict[str, Callable[[Any], object]]:
    """Return what executes the request of each RPC; a dictionary that it returns has the fields of the response.

    Parameters
    ----------
    card : VirtualCard
        Executes them.
    """
    return {
        "CreateTask": lambda asked: {
            "task": Session(id=card.create_task(asked.session_name)), "new_session_initialized": True
        },
        "ClearTask": lambda asked: card.clear_task(asked.task.id),
        "StartTask": lambda asked: card.start_task(asked.task.id),
        "StopTask": lambda asked: card.stop_task(asked.task.id),
        "IsTaskDone": lambda asked: {"is_task_done": card.is_done(asked.task.id)},
        "CreateAOVoltageChan": lambda asked: card.add_output(
            asked.task.id, asked.physical_channel, asked.min_val, asked.max_val
        ),
        "CreateCOPulseChanFreq": lambda asked: card.add_counter(asked.task.id, asked.counter, asked.freq),
        "CreateAIVoltageChan": lambda asked: card.add_channel(asked.task.id, "input", asked.physical_channel),
        "CreateDOChan": lambda asked: card.add_channel(asked.task.id, "line", asked.lines),
        "CfgSampClkTiming": lambda asked: card.task(asked.task.id).time_by_clock(
            asked.source, asked.rate, _number(asked, "sample_mode"), asked.samps_per_chan
        ),
        "CfgImplicitTiming": lambda asked: card.task(asked.task.id).time_implicitly(
            _number(asked, "sample_mode"), asked.samps_per_chan
        ),
        "CfgDigEdgeStartTrig": lambda asked: card.task(asked.task.id).start_by_edge(
            asked.trigger_source, _number(asked, "trigger_edge")
        ),
        **dict.fromkeys(
            ("SetTrigAttributeBool", "SetChanAttributeBool", "SetWriteAttributeInt32"),
            lambda asked: card.task(asked.task.id).set_attribute(_number(asked, "attribute"), _number(asked, "value")),
        ),
        "WriteAnalogScalarF64": lambda asked: card.write(asked.task.id, np.array([asked.value]), asked.auto_start),
        "WriteAnalogF64": lambda asked: {
            "samps_per_chan_written": card.write(asked.task.id, np.array(asked.write_array), asked.auto_start)
        },
        "ReadAnalogScalarF64": lambda asked: {"value": card.read(asked.task.id)},
        "WriteDigitalLines": lambda asked: card.write_line(asked.task.id, bool(asked.write_array[0])),
        "GetWriteAttributeUInt32": lambda _: {"value": 1},  # channels of the task
        "GetWriteAttributeUInt64": lambda asked: {"value": card.samples_done(asked.task.id)},
        "GetSystemInfoAttributeUInt32": lambda asked: {"value": DRIVER_VERSION[_number(asked, "attribute")]},
        "GetSystemInfoAttributeString": lambda _: {"value": card.device},
        "GetDeviceAttributeString": lambda _: {"value": PRODUCT_NAME},
        "GetTaskAttributeString": lambda asked: {"value": card.task(asked.task.id).name},
        "ResetDevice": lambda asked: card.reset(asked.device_name),
    }  # fmt: skip


def _number(asked: Any, name: str) -> int:
    """Return a field of a request, which clients send as an enumeration's member or as its number."""
    return int(getattr(asked, f"{name}_raw", 0) or getattr(asked, name))


class CardServer(ClosedOnExit):
    """Serves a virtual card on a free port of this computer. A context manager.

    Parameters
    ----------
    card : VirtualCard
        The card.
    """

    def __init__(self, card: VirtualCard) -> None:
        self._pool = DaemonPool()
        self._server = grpc.server(self._pool)
        handlers = {name: self._handler(name, answer) for name, answer in answers(card).items()}
        self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        self.address = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        before = set(threading.enumerate())
        self._server.start()
        for thread in set(threading.enumerate()) - before:
            thread.name = "simulated card's server"  # started by gRPC, which does not name it

    def close(self) -> None:
        """Stop serving."""
        self._server.stop(None).wait()
        self._pool.shutdown()

    @staticmethod
    def _handler(name: str, answer: Callable[[Any], object]) -> grpc.RpcMethodHandler:
        request, response = getattr(pb, f"{name}Request"), getattr(pb, f"{name}Response")

        def respond(message: Any, context: grpc.ServicerContext) -> Any:
            try:
                found = answer(message)
            except CardError as error:
                context.set_trailing_metadata((("ni-error", str(error.code)),))
                context.abort(grpc.StatusCode.UNKNOWN, str(error))
            return response(**found) if isinstance(found, dict) else response()

        return grpc.unary_unary_rpc_method_handler(
            respond,
            request_deserializer=request.FromString,
            response_serializer=response.SerializeToString,
        )
