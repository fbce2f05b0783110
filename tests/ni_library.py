"""The virtual card behind nidaqmx's production interpreter: functions in place of NI's C library.

They check every argument against the types that nidaqmx declares, as ctypes would, and are answered by the same
virtual card as the gRPC server.
"""

from __future__ import annotations

import ctypes
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from nidaqmx._lib import DaqFunctionImporter, lib_importer

from napari_elsplus.hardware.virtual.card.tasks import MESSAGES, CardError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from napari_elsplus.hardware.virtual.card.card import VirtualCard

DRIVER_VERSION: Final = {0x1272: 25, 0x1923: 0, 0x2F22: 0}
"""Major, minor and update version by attribute."""
DEVICE_NAMES, SAMPLES_DONE = 0x193B, 0x192B
"""Attribute codes of NIDAQmx.h."""
PRODUCT: Final = b"virtual card"
"""Product type of the card."""


class Function:
    """A function of the library: returns a status code; results go into the caller's memory."""

    def __init__(self, answer: Callable[..., int | None]) -> None:
        self._answer = answer
        self.argtypes: list[Any] | None = None
        self.arg_lock = threading.Lock()
        self.last_error = 0

    def __call__(self, *arguments: Any) -> int:
        """Check and unpack the arguments, and call the card."""
        for kind, argument in zip(self.argtypes or [], arguments, strict=False):
            kind.from_param(argument)
        try:
            return self._answer(*map(_plain, arguments)) or 0
        except CardError as error:
            return error.code


def _plain(argument: Any) -> Any:
    """Unpack what ctypes would unpack: a number from its box, the box from a reference."""
    if hasattr(argument, "_obj"):
        return argument._obj
    if isinstance(argument, ctypes.Array) or not hasattr(argument, "value"):
        return argument
    return argument.value


class VirtualLibrary:
    """NI-DAQmx's C library, as far as a line scan needs it.

    Parameters
    ----------
    card : VirtualCard
        The card.
    """

    def __init__(self, card: VirtualCard) -> None:
        self._card = card
        self._last_error = 0
        self._functions: dict[str, Function] = {}

    def __getattr__(self, name: str) -> Function:
        """Return the function of that name; an absent one raises, as in a library."""
        if name not in self._functions:
            answer = getattr(type(self), "_" + name.removeprefix("DAQmx"), None)
            if not name.startswith("DAQmx") or answer is None:
                raise AttributeError(name)
            self._functions[name] = Function(self._remembering(answer))
        return self._functions[name]

    def _remembering(self, answer: Callable[..., int | None]) -> Callable[..., int | None]:
        def call(*arguments: Any) -> int | None:
            try:
                return answer(self, *arguments)
            except CardError as error:
                self._last_error = error.code
                raise

        return call

    def _SetRuntimeEnvironment(self, *_: object) -> None:
        """Do nothing."""

    def _GetSystemInfoAttribute(self, attribute: int, out: Any, size: int = -1) -> int:
        if attribute == DEVICE_NAMES:
            return _give_text(self._card.device.encode(), out, size)
        out.value = DRIVER_VERSION[attribute]
        return 0

    def _GetDevProductType(self, _: str, out: Any, size: int) -> int:
        return _give_text(PRODUCT, out, size)

    def _GetDeviceAttribute(self, _: str, __: int, out: Any, size: int) -> int:
        return _give_text(PRODUCT, out, size)

    def _GetExtendedErrorInfo(self, out: Any, _: int) -> None:
        out.value = MESSAGES.get(self._last_error, "").encode()

    def _CreateTask(self, name: str, handle: Any) -> None:
        handle.value = self._card.create_task(name)

    def _ClearTask(self, handle: int) -> None:
        self._card.clear_task(handle)

    def _StartTask(self, handle: int) -> None:
        self._card.start_task(handle)

    def _StopTask(self, handle: int) -> None:
        self._card.stop_task(handle)

    def _IsTaskDone(self, handle: int, done: Any) -> None:
        done.value = self._card.is_done(handle)

    def _CreateAOVoltageChan(self, handle: int, channel: str, _: str, low: float, high: float, *__: object) -> None:
        self._card.add_output(handle, channel, low, high)

    def _CreateAIVoltageChan(self, handle: int, channel: str, *_: object) -> None:
        self._card.add_channel(handle, "input", channel)

    def _CreateDOChan(self, handle: int, line: str, *_: object) -> None:
        self._card.add_channel(handle, "line", line)

    def _CreateCOPulseChanFreq(
        self, handle: int, counter: str, _: str, __: int, ___: int, ____: float, freq: float, *_____: object
    ) -> None:
        self._card.add_counter(handle, counter, freq)

    def _CfgSampClkTiming(self, handle: int, source: str, rate: float, _: int, mode: int, samples: int) -> None:
        self._card.task(handle).time_by_clock(source, rate, mode, samples)

    def _CfgImplicitTiming(self, handle: int, mode: int, samples: int) -> None:
        self._card.task(handle).time_implicitly(mode, samples)

    def _CfgDigEdgeStartTrig(self, handle: int, source: str, edge: int) -> None:
        self._card.task(handle).start_by_edge(source, edge)

    def _SetTrigAttribute(self, handle: int, attribute: int, value: int) -> None:
        self._card.task(handle).set_attribute(attribute, value)

    def _SetChanAttribute(self, handle: int, _: str, attribute: int, value: int) -> None:
        self._card.task(handle).set_attribute(attribute, value)

    def _SetWriteAttribute(self, handle: int, attribute: int, value: int) -> None:
        self._card.task(handle).set_attribute(attribute, value)

    def _GetWriteAttribute(self, handle: int, attribute: int, out: Any) -> None:
        out.value = self._card.samples_done(handle) if attribute == SAMPLES_DONE else 1

    def _GetTaskAttribute(self, handle: int, _: int, out: Any, size: int) -> int:
        return _give_text(self._card.task(handle).name.encode(), out, size)

    def _WriteAnalogScalarF64(self, handle: int, start: int, _: float, value: float, *__: object) -> None:
        self._card.write(handle, np.array([value]), bool(start))

    def _WriteAnalogF64(
        self, handle: int, _: int, start: int, __: float, ___: int, volts: Any, written: Any, *____: object
    ) -> None:
        written.value = self._card.write(handle, volts, bool(start))

    def _ReadAnalogScalarF64(self, handle: int, _: float, out: Any, *__: object) -> None:
        out.value = self._card.read(handle)

    def _WriteDigitalLines(
        self, handle: int, _: int, __: int, ___: float, ____: int, levels: Any, written: Any, *_____: object
    ) -> None:
        self._card.write_line(handle, bool(levels[0]))
        written.value = 1

    def _ResetDevice(self, device: str) -> None:
        self._card.reset(device)


def _give_text(text: bytes, out: Any, size: int) -> int:
    """Return the length of a text if `size` is 0, else copy it."""
    if not size:
        return len(text) + 1
    out.value = text
    return 0


@contextmanager
def replacing_ni_library(card: VirtualCard) -> Iterator[None]:
    """Let nidaqmx find a library that drives the virtual card instead of NI's."""
    names = ("_windll", "_cdll", "_encoding")
    before = {name: getattr(lib_importer, name) for name in names}
    library = DaqFunctionImporter(VirtualLibrary(card))
    for name, value in zip(names, (library, library, "utf-8"), strict=True):
        setattr(lib_importer, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(lib_importer, name, value)
