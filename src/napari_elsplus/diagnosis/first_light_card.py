"""Checks of the first hour on the card alone: the galvo stays parked, the laser is off."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq.errors import translate_daq_errors
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.daq.session import open_session
from napari_elsplus.hardware.scan.waveform import REARM_S, SAMPLE_RATE_HZ, GalvoLimits, Waveform
from napari_elsplus.instrument.optics import PRESETS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from napari_elsplus.hardware.daq.output import CardSettings
    from napari_elsplus.hardware.rig import Rig

DRY_RUN_S: Final = 1.0
"""Seconds in which ramps are counted; chosen: 240 of them."""


def parked_waveform(limits: GalvoLimits, park_v: float, period_s: float) -> Waveform:
    """Return ramps that fill a frame period and stay at the parking voltage.

    Parameters
    ----------
    limits : GalvoLimits
        Limits of the galvo, and samples that the card keeps.
    park_v : float
        Parking voltage.
    period_s : float
        Frame period in seconds.
    """
    samples = min(int((period_s - REARM_S) * SAMPLE_RATE_HZ), limits.card_samples)
    return Waveform(np.full(samples, park_v), 1, SAMPLE_RATE_HZ, period_s)


def dry_run(card: CardSettings, limits: GalvoLimits) -> Iterator[str]:
    """Run the scan's tasks of each preset without a camera: the card's other counter takes the place of the strobe.

    On a card that NI's own driver simulates, the driver judges every task and route, but nothing is timed.

    Parameters
    ----------
    card : CardSettings
        Card and wiring of a rig's file.
    limits : GalvoLimits
        Limits of the galvo.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    DeviceError
        If the card refuses a task, or fails.
    """
    from nidaqmx.constants import AcquisitionType

    counter = "ctr0" if card.counter != "ctr0" else "ctr1"
    wired = replace(card, strobe=f"{counter.capitalize()}InternalOutput")
    with DaqScanner(wired, limits) as scanner, closing(open_session(card.address)) as session:
        yield _parked(scanner)
        for chosen in PRESETS.values():
            rate_hz = chosen.optics.frame_rate_hz
            with translate_daq_errors(card.device), session.task() as pulses:
                pulses.co_channels.add_co_pulse_chan_freq(f"{card.device}/{counter}", freq=rate_hz)
                pulses.timing.cfg_implicit_timing(AcquisitionType.CONTINUOUS)
                pulses.start()
                scanner.scan(parked_waveform(limits, card.park_v, 1 / rate_hz))
                first = _ramps(scanner)
                time.sleep(DRY_RUN_S)
                last = _ramps(scanner)
                scanner.check()
                scanner.park()
            ramps = last.begun - first.begun
            least, most = (last.before_s - first.after_s) * rate_hz, (last.after_s - first.before_s) * rate_hz
            pulses_of = f"{(least + most) / 2:.1f} pulses of {counter}"
            yield f"{chosen.name}: {ramps} ramps in {(least + most) / 2 / rate_hz:.3f} s, {pulses_of}"
            if not ramps:
                yield "the count of samples stands: the card does not count what it repeats by itself; report it"
            elif least - 2 <= ramps <= most + 2:  # between the counts passed some time from the least to the most
                yield "one ramp for every pulse, and its samples are counted while the card repeats them by itself"
            else:
                yield "not every pulse starts a ramp: the counter needs longer to arm, run at a lower frame rate"


def parking(rig: Rig) -> Iterator[str]:
    """Park, read the output back, and report what a reset of the card does to it. The laser has to be off.

    Parameters
    ----------
    rig : Rig
        Open rig, its galvo on a National Instruments card.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    InputError
        If its scanner is another driver.
    DeviceError
        If the card fails, or does not confirm.
    """
    scanner = rig.scanner
    if not isinstance(scanner, DaqScanner):
        raise InputError(f"the scanner of {rig.name} is no National Instruments card", "park it by its own driver")
    scanner.park()
    yield _parked(scanner)
    reset = scanner.try_reset()
    where = "an unknown voltage" if reset.volts is None else f"{reset.volts:.3f} V"
    yield (
        f"a reset took {reset.reset_s * 1e3:.0f} ms and left the output at {where}; "
        f"parked after {reset.parked_s * 1e3:.0f} ms"
    )
    yield f"laser line: {scanner.card.laser_line or 'none; a shutter or laser enable on a digital line is recommended'}"


class _Ramps(NamedTuple):
    """Ramps that the card had begun at some time between two."""

    begun: int
    before_s: float
    after_s: float


def _ramps(scanner: DaqScanner) -> _Ramps:
    before_s = time.perf_counter()
    return _Ramps(scanner.ramps_begun, before_s, time.perf_counter())


def _parked(scanner: DaqScanner) -> str:
    measured_v = scanner.park_state.read_back_v
    confirmed = "the card cannot measure its output: use a multimeter"
    return f"parked at {scanner.park_v:.3f} V; {confirmed if measured_v is None else f'read back {measured_v:.3f} V'}"
