"""Park the galvo from another process, after the one that drove it died."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.errors import translate_daq_errors
from napari_elsplus.hardware.daq.output import CardSettings, Output, open_options
from napari_elsplus.hardware.scan.waveform import GalvoLimits

if TYPE_CHECKING:
    from nidaqmx.system import System

    from napari_elsplus.hardware.daq.scanner import DaqScanner

RETRY_S: Final = 0.02
"""Seconds between two attempts; chosen: some task set-up times of the driver."""


@dataclass(frozen=True, slots=True)
class ParkOrder:
    """Output and voltage by which another process parks the galvo.

    Parameters
    ----------
    device, output : str
        The card and its output.
    volts : float
        Parking voltage.
    min_v, max_v : float
        Range of the output in volts.
    address : str
        ``host:port`` of a gRPC device server; empty: the driver on this computer.
    """

    device: str
    output: str
    volts: float
    min_v: float
    max_v: float
    address: str = ""


def park_order(scanner: DaqScanner) -> ParkOrder:
    """Return the order that parks the galvo of a scanner."""
    card, limits = scanner.card, scanner.limits
    return ParkOrder(card.device, card.output, scanner.park_v, limits.min_v, limits.max_v, card.address)


def carry_out(order: ParkOrder, timeout_s: float = 2.0) -> None:
    """Take the output over and park: a card goes on repeating its waveform after its program died.

    Parameters
    ----------
    order : ParkOrder
        What to do.
    timeout_s : float
        How long to try.

    Raises
    ------
    DeviceError
        If it could not be done in that time.
    """
    output = Output(
        CardSettings(order.volts, device=order.device, output=order.output, address=order.address),
        GalvoLimits(min_v=order.min_v, max_v=order.max_v),
    )
    until = time.monotonic() + timeout_s
    while True:
        try:
            output.put(order.volts)
        except DeviceError:
            if time.monotonic() > until:
                raise
            _abort_what_runs(order)
            time.sleep(RETRY_S)
        else:
            output.close()
            return


def rehearse(order: ParkOrder) -> None:
    """Load all modules that parking by an `order` needs, and call the driver once, so that it is fast later."""
    import nidaqmx.stream_writers  # noqa: F401 - for later

    with translate_daq_errors(order.device):
        _ = _system(order).driver_version


def _abort_what_runs(order: ParkOrder) -> None:
    with suppress(DeviceError), translate_daq_errors(order.device):  # tried again until the patience ends
        _system(order).devices[order.device].reset_device()


def _system(order: ParkOrder) -> System:
    from nidaqmx.system import System

    options = open_options(order.address)
    return System.remote(options) if options else System.local()
