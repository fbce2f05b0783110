"""Parking the mirror from outside: what has to be known, and how it is done when whoever drove it is dead."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.errors import told_by_the_card
from napari_elsplus.hardware.daq.output import CardSettings, Output, open_options
from napari_elsplus.hardware.scan.waveform import GalvoLimits

if TYPE_CHECKING:
    from nidaqmx.system import System

    from napari_elsplus.hardware.daq.scanner import DaqScanner

RETRY_S: Final = 0.02


@dataclass(frozen=True, slots=True)
class ParkOrder:
    """All that is needed to park the mirror from another process.

    Parameters
    ----------
    device, output : str
        The card and its output.
    volts : float
        Where to park.
    min_v, max_v : float
        The output's range.
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
    """Say what parks a scanner's mirror."""
    card, limits = scanner.card, scanner.limits
    return ParkOrder(card.device, card.output, scanner.park_v, limits.min_v, limits.max_v, card.address)


def carry_out(order: ParkOrder, patience_s: float = 2.0) -> None:
    """Take the output over and park: a card goes on repeating its waveform after its program died.

    Parameters
    ----------
    order : ParkOrder
        What to do.
    patience_s : float
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
    until = time.monotonic() + patience_s
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
    """Load all that `carry_out` needs, and reach the driver once, so that it is quick when it matters.

    Raises
    ------
    DeviceError
        If the driver cannot be reached.
    """
    import nidaqmx.stream_writers  # noqa: F401 - for later

    with told_by_the_card(order.device):
        _ = _system(order).driver_version


def _abort_what_runs(order: ParkOrder) -> None:
    with suppress(DeviceError), told_by_the_card(order.device):  # tried again until the patience ends
        _system(order).devices[order.device].reset_device()


def _system(order: ParkOrder) -> System:
    from nidaqmx.system import System

    options = open_options(order.address)
    return System.remote(options) if options else System.local()
