"""Park the galvo from another process, after the one that drove it died."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.daq.errors import translate_daq_errors
from napari_elsplus.hardware.daq.output import CardSettings, Output
from napari_elsplus.hardware.daq.session import open_session
from napari_elsplus.hardware.parking import Parking, ParkStage, ParkState, call_each
from napari_elsplus.hardware.scan.waveform import GalvoLimits

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.daq.scanner import DaqScanner

VIRTUAL_LIFE_S: Final = 5.0
"""Seconds without success after which a virtual card has ended with its program; chosen: longer than it lingers."""


@dataclass(frozen=True, slots=True)
class CardOrder:
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
    laser_line : str
        Digital line of shutter or laser; empty: none.
    laser_on_high : bool
        Level of that line at which the laser is on.
    virtual : bool
        The card is a virtual one, which may end: parking is given up then.
    """

    device: str
    output: str
    volts: float
    min_v: float
    max_v: float
    address: str = ""
    laser_line: str = ""
    laser_on_high: bool = True
    virtual: bool = False

    @classmethod
    def of(cls, scanner: DaqScanner, *, virtual: bool = False) -> CardOrder:
        """Return the order that parks the galvo of a scanner, on a real or a `virtual` card."""
        card, limits = scanner.card, scanner.limits
        return cls(
            card.device,
            card.output,
            scanner.park_v,
            limits.min_v,
            limits.max_v,
            card.address,
            card.laser_line,
            card.laser_on_high,
            virtual,
        )

    def preload(self) -> None:
        """Load all modules that parking needs, and call the driver once, so that it is fast later.

        Raises
        ------
        DeviceError
            If the driver cannot be reached.
        """
        import nidaqmx.stream_readers
        import nidaqmx.stream_writers  # noqa: F401 - for later

        session = open_session(self.address)
        with translate_daq_errors(self.device):
            _ = session.system().driver_version

    def take_over(self, report: Callable[[ParkState], None] = lambda _: None) -> ParkState:
        """Take the output over and park: a card goes on regenerating its waveform after its program died.

        Tried until the card confirms, without end; on a virtual card until it has ended.

        Parameters
        ----------
        report : callable
            Called with the state whenever its stage changes; one that fails does not stop parking.

        Returns
        -------
        ParkState
            The last state.
        """
        settings = CardSettings(
            self.volts,
            device=self.device,
            output=self.output,
            laser_line=self.laser_line,
            laser_on_high=self.laser_on_high,
            address=self.address,
        )
        output = Output(settings, GalvoLimits(min_v=self.min_v, max_v=self.max_v))
        parking, begun_s = Parking(output, self.volts), time.monotonic()
        stage = ParkStage.UNKNOWN
        while True:
            state = parking.attempt()
            if state.stage is not stage:
                stage = state.stage
                call_each((report,), state)
            if state.parked or (self.virtual and time.monotonic() - begun_s > VIRTUAL_LIFE_S):
                break
            time.sleep(state.retry_s)
        output.release()
        return state
