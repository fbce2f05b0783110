"""Checks for the first hour at a real rig: ``python -m napari_elsplus.diagnosis.first_light CHECK``.

Each settles a question that no virtual device can answer; but for ``phase`` and ``step`` without light on the bundle,
the galvo parked throughout. How to use the results: docs/first-light.md.
"""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import ExitStack
from datetime import datetime
from itertools import chain
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np

from napari_elsplus._program import run_program
from napari_elsplus.diagnosis.first_light_card import dry_run, parked_waveform, parking
from napari_elsplus.diagnosis.first_light_scan import configure, lit_rig, mirror_step, strobe_phase
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.drivers import features_of
from napari_elsplus.hardware.rig_files import U3V_KINDS, CameraTable, RigSettings, rig_settings
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.u3v import flea3
from napari_elsplus.hardware.u3v.camera import Features, U3vCamera
from napari_elsplus.hardware.u3v.control import Control, RegisterError
from napari_elsplus.hardware.u3v.discovery import choose_camera, endpoints
from napari_elsplus.hardware.u3v.flea3 import BASE
from napari_elsplus.instrument.optics import PRESETS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from usb.core import Device

    from napari_elsplus.hardware.rig import Rig

MODULE: Final = "napari_elsplus.diagnosis.first_light"
"""This module's name; ``__name__`` is another where it runs as a program."""
SHARES: Final = (1.0, 0.5)
"""Shares of the sensor's rows in the two regions whose shortest frame periods give the line period."""
SLIT_ROWS: Final = 3
"""Slit width in rows, as in the paper."""
WARM_UP_FRAMES: Final = 10
"""Frames before the measurement; chosen."""
STREAMING: Final = "streaming"
"""First word of the finding by which frames have come."""
MIN_FRAMES: Final = 8
"""Frames of a measurement; chosen: four at the beginning and four at the end."""


def examine_camera(device: Device, kind: str = "flea3") -> Iterator[str]:
    """Report USB ids, endpoints, sensor and clock of a camera, its line period, and registers of uncertain meaning.

    Parameters
    ----------
    device : usb.core.Device
        A USB3 Vision camera.
    kind : str
        ``flea3``, or ``genicam`` for a camera of any make by its own description.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    DeviceError
        If it cannot be opened.
    """
    ends = endpoints(device)
    yield f"USB ids {device.idVendor:04x}:{device.idProduct:04x}, speed {device.speed} (4 and more: USB 3)"
    yield f"endpoints: control {ends.control_out:#04x} and {ends.control_in:#04x}, stream {ends.stream_in:#04x}"
    probe: list[Control] = []

    def features(control: Control) -> Features:
        probe.append(control)
        return features_of(CameraTable(kind=kind))(control)

    with U3vCamera(device, features) as camera:
        control, sensor = probe[0], camera.sensor
        yield f"model {camera.model}, serial {camera.serial}"
        yield f"sensor {sensor.rows} x {sensor.cols}, in steps of {sensor.row_step} x {sensor.col_step}"
        yield f"timestamps in units of {camera.tick_s * 1e9:.6g} ns (1 by the standard)"
        yield from _registers(control) if kind == "flea3" else ()
        rows, shortest_s = [], []
        for share in SHARES:
            region = sensor.region(share)
            camera.configure(region, slit_rows=SLIT_ROWS, frame_rate_hz=camera.frame_rate_limits_hz[0])
            rows.append(region.rows)
            shortest_s.append(1 / camera.frame_rate_limits_hz[1])
            yield f"{region.rows} rows: at most {1 / shortest_s[-1]:.4f} frames/s"
        line_s = (shortest_s[0] - shortest_s[1]) / (rows[0] - rows[1])
        yield f"line period from these two: {line_s * 1e6:.4f} us, {1 / line_s:.1f} rows/s; the driver uses " + (
            f"{camera.line_period_s * 1e6:.4f} us"
        )


def _registers(control: Control) -> Iterator[str]:
    """Report the Flea3's registers of uncertain meaning."""
    for name, address in (
        ("line frequency (1AF4)", BASE + flea3.LINE_FREQUENCY),
        ("strobe offset (48C)", BASE + flea3.STROBE_OFFSET),
    ):
        try:
            yield f"{name}: {control.read_number(address):#010x}"
        except RegisterError as error:
            yield f"{name}: {error.problem}"


def stream(rig: Rig, preset_name: str, seconds: float) -> Iterator[str]:
    """Stream a preset, and report rate, lost frames and processor time.

    Parameters
    ----------
    rig : Rig
        Open rig.
    preset_name : str
        Region and frame rate.
    seconds : float
        Duration.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    DeviceError
        If the camera fails.
    """
    frames = _configure(rig, preset_name, seconds)
    buffer = np.empty(rig.camera.frame_shape, np.uint8)
    rig.camera.start()
    for _ in range(WARM_UP_FRAMES):
        rig.camera.read_into(buffer, 5.0)
    yield f"{STREAMING} {preset_name} for {seconds:g} s"
    before = dict(rig.camera.dropped)
    begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
    infos = [rig.camera.read_into(buffer, 5.0) for _ in range(frames)]
    took_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - begin_cpu_s
    lost = {cause: count - before.get(cause, 0) for cause, count in rig.camera.dropped.items()}
    rig.camera.stop()
    arrivals = np.diff([info.received_s for info in infos]) * 1e3
    megabytes = frames * buffer.size / 1e6
    yield f"{frames} frames in {took_s:.2f} s: {frames / took_s:.2f} frames/s, {megabytes / took_s:.0f} MB/s"
    yield f"lost: {({cause: count for cause, count in lost.items() if count}) or 'none'}"
    yield f"processor time: {cpu_s / frames * 1e3:.2f} ms a frame, {100 * cpu_s / took_s:.0f} % of one core"
    yield f"between frames: median {np.median(arrivals):.2f} ms, longest {arrivals.max():.2f} ms"
    spacing = np.diff([info.readout_start_s for info in infos]) / np.diff([info.frame_number for info in infos])
    yield f"frame period on the camera's clock: {spacing.mean() * 1e3:.5f} ms, spread {spacing.std() * 1e6:.2f} us"


def reopen(name: str, preset_name: str) -> Iterator[str]:
    """Kill a program that streams from a rig, open the rig again, and report when frames come.

    Parameters
    ----------
    name : str
        Name of the rig.
    preset_name : str
        Region and frame rate.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    InputError
        If there is no such rig.
    DeviceError
        If the rig does not open, or no frame comes.
    """
    rig_settings(name)  # a name that is wrong is refused here, and once
    command = [sys.executable, "-m", MODULE, "stream", "--rig", name, "--preset", preset_name, "--seconds", "3600"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        began = any(line.startswith(STREAMING) for line in program.stdout)
        program.kill()
    yield "a program that streamed was killed" if began else "the program that should stream ended by itself"
    begin_s = time.perf_counter()
    with open_rig(name) as rig:
        _configure(rig, preset_name, 1.0)
        buffer = np.empty(rig.camera.frame_shape, np.uint8)
        rig.camera.start()
        numbers = [rig.camera.read_into(buffer, 5.0).frame_number for _ in range(MIN_FRAMES)]
        took_s = time.perf_counter() - begin_s
        yield f"frames {numbers[0]} to {numbers[-1]} came {took_s:.2f} s after the rig was opened again"
        yield f"lost: {({cause: count for cause, count in rig.camera.dropped.items() if count}) or 'none'}"


def strobe(rig: Rig, preset_name: str, seconds: float) -> Iterator[str]:
    """Count ramps against frames, with a ramp that never leaves the parking voltage.

    Parameters
    ----------
    rig : Rig
        Open rig.
    preset_name : str
        Region and frame rate.
    seconds : float
        Duration.

    Yields
    ------
    str
        One finding each.

    Raises
    ------
    DeviceError
        If camera or card fail, or no strobe comes.
    """
    frames = _configure(rig, preset_name, seconds)
    period_s = rig.camera.line_periods_per_frame * rig.camera.line_period_s
    rig.check_guarded()
    rig.scanner.scan(parked_waveform(rig.limits, rig.scanner.park_v, period_s))
    buffer = np.empty(rig.camera.frame_shape, np.uint8)
    rig.camera.start()
    reads: list[tuple[float, ...]] = []
    for _ in range(frames):
        info = rig.camera.read_into(buffer, 5.0)
        time.sleep(period_s / 2)  # where a frame ends the next may begin: ramps are counted between two strobes
        ramps, now_s = rig.scanner.ramps_begun, time.perf_counter()
        reads.append((ramps, now_s, info.frame_number, info.received_s, info.readout_start_s))
    rig.scanner.check()
    rig.camera.stop()
    rig.scanner.park()
    leads = np.concatenate([_leads(part) for part in (reads[: frames // 2], reads[frames // 2 :])])
    first, last = (float(np.median(part)) for part in (leads[: frames // 4], leads[-frames // 4 :]))
    yield f"{frames} frames; ramps begun minus frames: at first {first:.1f}, at last {last:.1f}"
    if (more := round(last - first)) < 0:
        yield f"{-more} strobe(s) started no ramp: try a longer frame, the other edge (falling), another counter"
    elif more > 0:
        yield f"{more} ramp(s) without a frame: the strobe bounces, or another signal is on its terminal"
    else:
        yield "one ramp for every frame: the card is started anew by every strobe"


def _leads(reads: list[tuple[float, ...]]) -> NDArray[np.float64]:
    """Return the ramps begun at each time, less the frames that the camera had ended by then, read or not."""
    ramps, now_s, numbers, received_s, camera_s = np.array(reads).T
    period_s = (camera_s[-1] - camera_s[0]) / (numbers[-1] - numbers[0])
    frame_zero_s = np.min(received_s - numbers * period_s)  # by the frame that came least late
    leads: NDArray[np.float64] = ramps - (now_s - frame_zero_s) / period_s
    return leads


def _configure(rig: Rig, preset_name: str, seconds: float) -> int:
    """Set the camera to a preset at the highest rate that it takes, and return how many frames that are."""
    rate_hz = configure(rig.camera, preset_name, SLIT_ROWS)
    if not MIN_FRAMES <= seconds * rate_hz < inf:
        raise InputError(f"{seconds} s", "take at least a tenth of a second")
    return round(seconds * rate_hz)


RIG = click.option("--rig", "name", default="simulated", show_default=True, help="Name of the rig.")
PRESET = click.option("--preset", "mode", type=click.Choice(list(PRESETS)), default="240hz", show_default=True)
SLOW_PRESET = click.option(
    "--preset", "mode", type=click.Choice(list(PRESETS)), default="120hz", show_default=True, help="Camera region."
)
CALIBRATION = click.option(
    "-c", "--calibration", "file", type=click.Path(path_type=Path), help="With galvo and bundle; for a real rig."
)
SECONDS = click.option("--seconds", default=10.0, show_default=True)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--report", type=click.Path(path_type=Path), help="File to which the findings are appended, with date.")
@click.pass_context
def first_light(context: click.Context, report: Path | None) -> None:
    """Check a rig; the galvo stays parked but for `phase` and `step`."""
    context.obj = report


@first_light.command("camera")
@click.option("--serial", default="", help="Serial number, where several cameras are connected.")
@click.option("--kind", type=click.Choice(U3V_KINDS), default="flea3", show_default=True, help="As in a rig file.")
def _camera(serial: str, kind: str) -> None:
    """Report the camera's identity, sensor and clock, and its line period."""
    _print(examine_camera(choose_camera(serial), kind))


@first_light.command("reopen")
@RIG
@PRESET
def _reopen(name: str, mode: str) -> None:
    """Kill a program that streams, and report how long the camera takes to stream again."""
    _print(reopen(name, mode))


@first_light.command("stream")
@RIG
@PRESET
@SECONDS
def _stream(name: str, mode: str, seconds: float) -> None:
    """Report if the computer keeps up with the camera."""
    with open_rig(name) as rig:
        _print(stream(rig, mode, seconds))


@first_light.command("strobe")
@RIG
@PRESET
@SECONDS
def _strobe(name: str, mode: str, seconds: float) -> None:
    """Report if the strobe reaches the card and starts every ramp."""
    with open_rig(name) as rig:
        _print(strobe(rig, mode, seconds))


@first_light.command("phase")
@RIG
@CALIBRATION
@SLOW_PRESET
def _phase(name: str, file: Path | None, mode: str) -> None:
    """Report which event the strobe marks; light is on, the target evenly fluorescent."""
    with lit_rig(name, file, mode) as (rig, calibration):
        _print(strobe_phase(rig, calibration, mode))


@first_light.command("step")
@RIG
@CALIBRATION
@SLOW_PRESET
def _step(name: str, file: Path | None, mode: str) -> None:
    """Report the galvo's response to a step; light is on, the target evenly fluorescent."""
    with lit_rig(name, file, mode) as (rig, calibration):
        _print(mirror_step(rig, calibration, mode))


@first_light.command("card")
@click.option("--rig", "name", required=True, help="Name of a rig with a file.")
def _card(name: str) -> None:
    """Run the scan's tasks without a camera; also for a card that NI's driver simulates."""
    settings = rig_settings(name)
    if not isinstance(settings, RigSettings):
        raise InputError(f"the rig {name} is simulated", "name one whose file has a card")
    _print(dry_run(settings.card, settings.mirror))


@first_light.command("parking")
@RIG
def _parking(name: str) -> None:
    """Park, and report what a reset of the card does; the laser has to be off."""
    with open_rig(name) as rig:
        _print(parking(rig))


def _print(findings: Iterator[str]) -> None:
    """Print findings as they come, and append them to the report if there is one: also those before an error."""
    context = click.get_current_context()
    with ExitStack() as held:
        file = held.enter_context(context.obj.open("a", encoding="utf-8")) if context.obj else None
        for line in chain([f"{context.info_name}, {datetime.now().astimezone():%Y-%m-%d %H:%M:%S %z}"], findings):
            if file is not None:
                file.write(f"{line}\n")
                file.flush()
            click.echo(line)


def main() -> None:
    """Run a check; an error, also Ctrl-C, is one line."""
    run_program(first_light, "first_light")


if __name__ == "__main__":
    main()
