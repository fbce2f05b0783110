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


class DaemonPool(futures.Executor):
    """Threads that do not keep the interpreter alive, and that still serve while it ends.

    So the galvo can be parked when the interpreter ends.
    """

    def __init__(self, threads: int = 4) -> None:
        self._work: queue.SimpleQueue[tuple[futures.Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        self._threads = threads
        for _ in range(threads):
            threading.Thread(target=self._serve, name="simulated card", daemon=True).start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> futures.Future[Any]:
        """Queue a call; see :meth:`concurrent.futures.Executor.submit`."""
        future: futures.Future[Any] = futures.Future()
        self._work.put((future, lambda: fn(*args, **kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads after the queued calls, without waiting; see :meth:`concurrent.futures.Executor.shutdown`."""
        del wait, cancel_futures
        for _ in range(self._threads):
            self._work.put(None)

    def _serve(self) -> None:
        while (work := self._work.get()) is not None:
            future, call = work
            try:
                future.set_result(call())
            except BaseException as error:  # noqa: BLE001 - passed on through the future
                future.set_exception(error)


def answers(card: VirtualCard) -> dict[str, tuple[type, Callable[[Any], Any]]]:
    """Return the RPCs by name, each with its request and the function of the card that answers it."""

    def create_task(request: Any) -> Any:
        handle = card.create_task(request.session_name)
        return pb.CreateTaskResponse(task=Session(id=handle), new_session_initialized=True)

    def clear_task(request: Any) -> Any:
        card.clear_task(request.task.id)
        return pb.ClearTaskResponse()

    def start_task(request: Any) -> Any:
        card.start_task(request.task.id)
        return pb.StartTaskResponse()

    def stop_task(request: Any) -> Any:
        card.stop_task(request.task.id)
        return pb.StopTaskResponse()

    def is_task_done(request: Any) -> Any:
        return pb.IsTaskDoneResponse(is_task_done=card.is_done(request.task.id))

    def add_output(request: Any) -> Any:
        card.add_output(request.task.id, request.physical_channel, request.min_val, request.max_val)
        return pb.CreateAOVoltageChanResponse()

    def add_counter(request: Any) -> Any:
        card.add_counter(request.task.id, request.counter, request.freq)
        return pb.CreateCOPulseChanFreqResponse()

    def add_input(request: Any) -> Any:
        card.add_channel(request.task.id, "input", request.physical_channel)
        return pb.CreateAIVoltageChanResponse()

    def add_line(request: Any) -> Any:
        card.add_channel(request.task.id, "line", request.lines)
        return pb.CreateDOChanResponse()

    def sample_clock(request: Any) -> Any:
        mode = request.sample_mode_raw or request.sample_mode
        card.task(request.task.id).time_by_clock(request.source, request.rate, mode, request.samps_per_chan)
        return pb.CfgSampClkTimingResponse()

    def implicit_timing(request: Any) -> Any:
        mode = request.sample_mode_raw or request.sample_mode
        card.task(request.task.id).time_implicitly(mode, request.samps_per_chan)
        return pb.CfgImplicitTimingResponse()

    def start_trigger(request: Any) -> Any:
        edge = request.trigger_edge_raw or request.trigger_edge
        card.task(request.task.id).start_by_edge(request.trigger_source, edge)
        return pb.CfgDigEdgeStartTrigResponse()

    def trigger_bool(request: Any) -> Any:
        card.task(request.task.id).set_attribute(request.attribute_raw or request.attribute, request.value)
        return pb.SetTrigAttributeBoolResponse()

    def channel_bool(request: Any) -> Any:
        card.task(request.task.id).set_attribute(request.attribute_raw or request.attribute, request.value)
        return pb.SetChanAttributeBoolResponse()

    def write_number(request: Any) -> Any:
        value = request.value_raw or request.value
        card.task(request.task.id).set_attribute(request.attribute_raw or request.attribute, value)
        return pb.SetWriteAttributeInt32Response()

    def write_scalar(request: Any) -> Any:
        card.write(request.task.id, np.array([request.value]), request.auto_start)
        return pb.WriteAnalogScalarF64Response()

    def write_many(request: Any) -> Any:
        volts = np.array(request.write_array)
        return pb.WriteAnalogF64Response(samps_per_chan_written=card.write(request.task.id, volts, request.auto_start))

    def read_scalar(request: Any) -> Any:
        return pb.ReadAnalogScalarF64Response(value=card.read(request.task.id))

    def write_line(request: Any) -> Any:
        card.write_line(request.task.id, bool(request.write_array[0]))
        return pb.WriteDigitalLinesResponse(samps_per_chan_written=1)

    def generated(request: Any) -> Any:
        return pb.GetWriteAttributeUInt64Response(value=card.samples_done(request.task.id))

    def channels(_: Any) -> Any:
        return pb.GetWriteAttributeUInt32Response(value=1)

    def system_number(request: Any) -> Any:
        number = request.attribute_raw or request.attribute
        return pb.GetSystemInfoAttributeUInt32Response(value=DRIVER_VERSION[number])

    def system_text(_: Any) -> Any:
        return pb.GetSystemInfoAttributeStringResponse(value=card.device)

    def device_text(_: Any) -> Any:
        return pb.GetDeviceAttributeStringResponse(value=PRODUCT_NAME)

    def task_text(request: Any) -> Any:
        return pb.GetTaskAttributeStringResponse(value=card.task(request.task.id).name)

    def reset(request: Any) -> Any:
        card.reset(request.device_name)
        return pb.ResetDeviceResponse()

    return {
        "CreateTask": (pb.CreateTaskRequest, create_task),
        "ClearTask": (pb.ClearTaskRequest, clear_task),
        "StartTask": (pb.StartTaskRequest, start_task),
        "StopTask": (pb.StopTaskRequest, stop_task),
        "IsTaskDone": (pb.IsTaskDoneRequest, is_task_done),
        "CreateAOVoltageChan": (pb.CreateAOVoltageChanRequest, add_output),
        "CreateCOPulseChanFreq": (pb.CreateCOPulseChanFreqRequest, add_counter),
        "CreateAIVoltageChan": (pb.CreateAIVoltageChanRequest, add_input),
        "CreateDOChan": (pb.CreateDOChanRequest, add_line),
        "CfgSampClkTiming": (pb.CfgSampClkTimingRequest, sample_clock),
        "CfgImplicitTiming": (pb.CfgImplicitTimingRequest, implicit_timing),
        "CfgDigEdgeStartTrig": (pb.CfgDigEdgeStartTrigRequest, start_trigger),
        "SetTrigAttributeBool": (pb.SetTrigAttributeBoolRequest, trigger_bool),
        "SetChanAttributeBool": (pb.SetChanAttributeBoolRequest, channel_bool),
        "SetWriteAttributeInt32": (pb.SetWriteAttributeInt32Request, write_number),
        "WriteAnalogScalarF64": (pb.WriteAnalogScalarF64Request, write_scalar),
        "WriteAnalogF64": (pb.WriteAnalogF64Request, write_many),
        "ReadAnalogScalarF64": (pb.ReadAnalogScalarF64Request, read_scalar),
        "WriteDigitalLines": (pb.WriteDigitalLinesRequest, write_line),
        "GetWriteAttributeUInt32": (pb.GetWriteAttributeUInt32Request, channels),
        "GetWriteAttributeUInt64": (pb.GetWriteAttributeUInt64Request, generated),
        "GetSystemInfoAttributeUInt32": (pb.GetSystemInfoAttributeUInt32Request, system_number),
        "GetSystemInfoAttributeString": (pb.GetSystemInfoAttributeStringRequest, system_text),
        "GetDeviceAttributeString": (pb.GetDeviceAttributeStringRequest, device_text),
        "GetTaskAttributeString": (pb.GetTaskAttributeStringRequest, task_text),
        "ResetDevice": (pb.ResetDeviceRequest, reset),
    }


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
        handlers = {name: self._handler(*answer) for name, answer in answers(card).items()}
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
    def _handler(request: Any, answer: Callable[[Any], Any]) -> grpc.RpcMethodHandler:
        def respond(message: Any, context: grpc.ServicerContext) -> Any:
            try:
                return answer(message)
            except CardError as error:
                context.set_trailing_metadata((("ni-error", str(error.code)),))
                context.abort(grpc.StatusCode.UNKNOWN, str(error))

        return grpc.unary_unary_rpc_method_handler(
            respond,
            request_deserializer=request.FromString,
            response_serializer=lambda response: response.SerializeToString(),
        )
