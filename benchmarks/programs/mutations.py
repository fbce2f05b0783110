"""Deliberate mistakes in the drivers, and how many of them the tests let pass: ``python3 run.py bench mutations``.

Each mistake is applied to a copy of the package, in which the tests of the module run until one fails. By hand:
``python -m benchmarks.programs.mutations [WORD ...]``, with words of the modules or mistakes to try.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from benchmarks.harness.edits import Edit, copied_checkout

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TIMEOUT_S: Final = 300
"""Seconds after which a mistake counts as noticed, since the tests hang; chosen: far above their time."""
CAMERA: Final = ("test_strict_camera.py", "test_camera.py", "test_hostile_devices.py")
CARD: Final = ("daq/test_scanner.py", "daq/test_parking_card.py")
TESTS: Final = {
    "hardware/u3v/packets": CAMERA,
    "hardware/u3v/control": CAMERA,
    "hardware/u3v/transfers": CAMERA,
    "hardware/u3v/stream": CAMERA,
    "hardware/u3v/camera": CAMERA,
    "hardware/u3v/flea3": CAMERA,
    "hardware/u3v/discovery": CAMERA,
    "hardware/u3v/genapi": CAMERA,
    "hardware/micro_manager/camera": ("test_micro_manager.py",),
    "hardware/micro_manager/frame_count": ("test_micro_manager.py",),
    "hardware/daq/output": CARD,
    "hardware/daq/scanner": CARD,
    "hardware/daq/interlock": ("daq/test_interlock.py", *CARD),
    "hardware/daq/errors": CARD,
    "hardware/scan/waveform": ("scan/test_waveform.py", "test_bench.py"),
    "hardware/scan/path": ("scan/test_waveform.py", "test_bench.py"),
    "hardware/scan/timing": ("scan/test_waveform.py", "test_bench.py"),
    "hardware/parking": ("test_parking.py", *CARD),
}
"""Tests of each module, the quick ones first."""


@dataclass(frozen=True)
class Mistake(Edit):
    """A mistake in a driver."""

    @property
    def label(self) -> str:
        """Module and change in one line."""
        return f"{self.module}: {' '.join(self.old.split())!r} -> {' '.join(self.new.split())!r}"


MISTAKES: Final = tuple(
    Mistake(f"hardware/{module}", right, wrong)
    for module, changes in {
        "u3v/packets": (
            (
                'COMMAND_MAGIC, LEADER_MAGIC, TRAILER_MAGIC = b"U3VC"',
                'COMMAND_MAGIC, LEADER_MAGIC, TRAILER_MAGIC = b"CV3U"',
            ),
            ('b"U3VL", b"U3VT"', 'b"U3VT", b"U3VL"'),
            ("REQUEST_ACK: Final = 0x4000", "REQUEST_ACK: Final = 0x8000"),
            ("MONO8: Final = 0x01080001", "MONO8: Final = 0x01100003"),
            ('READ: Final = struct.Struct("<QHH")', 'READ: Final = struct.Struct(">QHH")'),
            ("READ.pack(address, 0, count)", "READ.pack(address, count, 0)"),
            ("READ = 0x0800", "READ = 0x0804"),
            ("PENDING_ACK = 0x0805", "PENDING_ACK = 0x0807"),
            (
                "kind, time, pixel, cols, rows, col, row, padding_x",
                "kind, time, pixel, rows, cols, col, row, padding_x",
            ),
            ("_, _, _, block, status, _, valid, _ = TRAILER", "_, _, _, block, _, status, valid, _ = TRAILER"),
        ),
        "u3v/control": (
            (
                "MANIFEST, SBRM = 0x0044, 0x0144, 0x01CC, 0x01D0, 0x01D8",
                "MANIFEST, SBRM = 0x0044, 0x0144, 0x01CC, 0x01D8, 0x01D0",
            ),
            (
                "MODEL, SERIAL, MAX_RESPONSE_MS, MANIFEST, SBRM = 0x0044, 0x0144",
                "MODEL, SERIAL, MAX_RESPONSE_MS, MANIFEST, SBRM = 0x0084, 0x0144",
            ),
            ("MAX_COMMAND, MAX_ACK, SIRM = 0x14, 0x18, 0x20", "MAX_COMMAND, MAX_ACK, SIRM = 0x14, 0x18, 0x2C"),
            ("if ack.request_id != self._request_id:", "if False:"),
            ("elif ack.status == BUSY and", "elif False and"),
            ("self._timeout_ms = TIMEOUT_MS + response_ms", "self._timeout_ms = TIMEOUT_MS"),
            ("if error.errno != errno.EPIPE:", "if error.errno:"),
            ("self._request_id = time.monotonic_ns() & 0xFFFF", "self._request_id = 0"),
            ("MAX_ATTEMPTS: Final = 3", "MAX_ATTEMPTS: Final = 1"),
        ),
        "u3v/transfers": (
            (
                "TRANSFER_BYTES, TRANSFER_COUNT, FINAL_1, FINAL_2, MAX_TRAILER = 0x18, 0x1C, 0x20",
                "TRANSFER_BYTES, TRANSFER_COUNT, FINAL_1, FINAL_2, MAX_TRAILER = 0x18, 0x20, 0x1C",
            ),
            ("INFO, ENABLE, PAYLOAD_BYTES", "ENABLE, INFO, PAYLOAD_BYTES"),
            ("0x24, 0x28, 0x2C", "0x28, 0x24, 0x2C"),
            ("return -(-payload // unit) * unit, 1, 0", "return largest, 0, -(-payload // unit) * unit"),
            ("unit = 1 << min(control.read_number(sirm + INFO) >> 24, 16)", "unit = 1"),
            ("largest = held", "return [size] * count + ([final] if final else [])"),
            ("return largest, count, -(-rest // unit) * unit", "return largest, count, 0"),
        ),
        "u3v/stream": (
            ("count = self._read_rest(transfer, count)", "count += 0"),
            ("self._device.clear_halt(self._endpoint)", "pass"),
            ("if self.padding_x:", "if False:"),
            ("if cause is None and self._skip:", "if False:"),
            ("missing = max(number - last - 1, 0)", "missing = 0"),
            ("or trailer.status:", "or False:"),
            ("leader.block_id * self._period_s", "0.0"),
        ),
        "u3v/camera": (
            ("TIMESTAMP, LATCH, INCREMENT = 0x01F0, 0x01F8", "TIMESTAMP, LATCH, INCREMENT = 0x01F8, 0x01F0"),
            ("self._control.write_number(LATCH, 1)", "self._control.write_number(LATCH, 2)"),
            ("return max(before_s - ticks", "return min(before_s - ticks"),
            (
                "            if near:\n                return near[0]\n        return tick_s",
                "        return NANOSECOND",
            ),
            (
                "self._control.write_number(self._control.sirm + ENABLE, 0)\n        with",
                "with",
            ),
            ("        self._features.reset()\n", ""),
        ),
        "u3v/flea3": (
            ("BASE: Final = 0xFFFF_F0F0_0000", "BASE: Final = 0xFFFF_F000_0000"),
            (
                "EXPOSURE_MIN, EXPOSURE_MAX, EXPOSURE = 0x910, 0x914, 0x918",
                "EXPOSURE_MIN, EXPOSURE_MAX, EXPOSURE = 0x910, 0x914, 0x91C",
            ),
            (
                "MAX_SIZE, UNIT_SIZE, OFFSET, SIZE = 0xA00, 0xA04, 0xA08, 0xA0C",
                "MAX_SIZE, UNIT_SIZE, SIZE, OFFSET = 0xA00, 0xA04, 0xA08, 0xA0C",
            ),
            ("region.cols << 16 | region.rows", "region.rows << 16 | region.cols"),
            (
                "AUTO, ON, ACQUIRE, STROBE_ON, GPIO_STROBE = 1 << 24, 1 << 25",
                "AUTO, ON, ACQUIRE, STROBE_ON, GPIO_STROBE = 1 << 25, 1 << 24",
            ),
            ("0x10 * self._strobe_line, GPIO_STROBE", "0x10 * (self._strobe_line + 1), GPIO_STROBE"),
            ("control.write_number(strobe + STROBE_TIMES, 0)", "pass"),
        ),
        "u3v/discovery": (
            ("if device.speed is not None and device.speed < SPEED_SUPER:", "if False:"),
            ("if serial not in numbers:", "if False:"),
        ),
        "u3v/genapi": (
            ("((4, 4), (8, 8), (16, 8))", "((4, 4), (16, 8), (8, 8))"),
            ('self._set(region.cols, "Width")', 'self._set(region.rows, "Width")'),
            ('self._set(exposure_s * 1e6, "ExposureTime"', 'self._set(exposure_s * 1e3, "ExposureTime"'),
            ('        self._set(exposure.min, "ExposureTime", "ExposureTimeAbs")  # a long one limits the rate\n', ""),
            ('self._set_if_there(1, "TLParamsLocked")', 'self._set_if_there(0, "TLParamsLocked")'),
            ('    "TriggerMode": "Off",\n', ""),
            ('f"Line{self._strobe_line}"', 'f"Line{self._strobe_line + 1}"'),
            ('        self._set("ExposureActive", "LineSource")\n', ""),
        ),
        "micro_manager/camera": (
            (
                "(region.col, region.row, region.cols, region.rows)",
                "(region.row, region.col, region.rows, region.cols)",
            ),
            ("if (held := tuple(self._core.getROI())) != wanted:", "if not (held := tuple(self._core.getROI())):"),
            ("self._core.setExposure(wanted_s * 1e3)", "self._core.setExposure(wanted_s * 1e6)"),
            ("if abs(held - value) > MAX_ROUNDING * abs(value):", "if False:"),
            ("ceil(DEPTH * rows * cols / (1 << 20))", "1"),
            ("            elif not runs:", "            elif False:"),
            ("        if bits != 8:", "        if False:"),
        ),
        "micro_manager/frame_count": (
            ("float(tags[ELAPSED_MS]) * 1e-3", "float(tags[ELAPSED_MS])"),
            (
                "discarded, missing = in_core - self.in_core, number",
                "discarded, missing = in_core - self.in_core + 1, number",
            ),
            ('("gap", missing - discarded)', '("gap", missing)'),
            ("self._rate_hz) - waiting", "self._rate_hz)"),
            ("max(1, by_time if own is None", "max(1, 1 if own is None"),
            ("        elif in_core < self.in_core:", "        elif False:"),
        ),
        "daq/output": (
            ("Edge.FALLING if card.falling else Edge.RISING", "Edge.RISING if card.falling else Edge.FALLING"),
            ('f"/{card.device}/{card.strobe}", edge', 'f"/{card.device}/PFI1", edge'),
            ("{card.counter.capitalize()}InternalOutput", "Ctr1InternalOutput"),
            ("start_trigger.retriggerable = True", "start_trigger.retriggerable = False"),
            (
                "cfg_implicit_timing(AcquisitionType.FINITE, waveform.samples_per_ramp)",
                "cfg_implicit_timing(AcquisitionType.CONTINUOUS, waveform.samples_per_ramp)",
            ),
            ("sample_mode=AcquisitionType.CONTINUOUS, samps", "sample_mode=AcquisitionType.FINITE, samps"),
            ("RegenerationMode.ALLOW_REGENERATION\n", "RegenerationMode.DONT_ALLOW_REGENERATION\n"),
            ("channel.ao_use_only_on_brd_mem = True", "channel.ao_use_only_on_brd_mem = False"),
            ("level = on == self.card.laser_on_high", "level = on"),
            ("if measured is not None and not abs(measured - volts) <= READ_BACK_TOLERANCE_V:", "if False:"),
        ),
        "daq/interlock": (
            ("if late_s > limit_s:", "if late_s > 100 * limit_s:"),
            ("if now_s - self._held_since_s <= limit_s:", "if True:"),
        ),
        "scan/waveform": (
            (
                "times = (np.arange(count)[:, None] * period + middles).ravel() + lag_s - carried",
                "times = (np.arange(count)[:, None] * period + middles).ravel() - lag_s - carried",
            ),
            ("carried = 2 * (galvo.damping", "carried = (galvo.damping"),
            ("drive = where + (carried * speed + acceleration / natural**2 if natural else 0.0)", "drive = where"),
            ("timing.time_s(rows[1] + 0.5 * timing.slit_rows)", "timing.time_s(rows[1] - 50 * timing.slit_rows)"),
            ("samples = floor((period - REARM_S) * rate + 1e-9)", "samples = floor(period * rate + 1e-9)"),
            ('limits.check(volts, "the scan")\n    ends', "ends"),
        ),
        "scan/timing": (
            (
                "return (time_s - self.row_zero_s) / self.line_period_s + self.slit_rows / 2",
                "return (time_s - self.row_zero_s) / self.line_period_s - self.slit_rows / 2",
            ),
            (
                "self.slit_rows * self.line_period_s if self.strobe is StrobePhase.EXPOSURE",
                "self.slit_rows * self.line_period_s if self.strobe is StrobePhase.READOUT",
            ),
        ),
        "parking": (
            ('laser, problem = "" if stuck else self._try(self.output.laser_off), ""', 'laser, problem = "", ""'),
            ("read_back_v = self.output.confirm(volts)", "read_back_v = None"),
            ("RESET_AFTER: Final = 2", "RESET_AFTER: Final = 2000"),
        ),
    }.items()
    for right, wrong in changes
)


def try_all(mistakes: Sequence[Mistake]) -> Iterator[tuple[Mistake, str, float]]:
    """Make each mistake in turn; yield it, the test that noticed it (empty: none), and the seconds that this took.

    Raises
    ------
    RuntimeError
        If the tests of the unchanged package fail, so that nothing could be learnt from them.
    """
    _import_what_the_tests_need()
    with tempfile.TemporaryDirectory(prefix="mutations-") as name:
        for tests in {TESTS[mistake.module] for mistake in mistakes}:
            with copied_checkout(Path(name) / "copy", "src", "tests", "pyproject.toml") as folder:
                if failure := _run_tests(folder, tests):
                    log = (folder / "log.txt").read_text("utf-8")
                    raise RuntimeError(f"the tests of the unchanged package fail: {failure}\n{log[-3000:]}")
        for mistake in mistakes:
            begin_s = time.monotonic()
            with copied_checkout(Path(name) / "copy", "src", "tests", "pyproject.toml") as folder:
                mistake.apply(folder)
                noticed = _run_tests(folder, TESTS[mistake.module])
            yield mistake, noticed, time.monotonic() - begin_s


def _run_tests(folder: Path, tests: Sequence[str]) -> str:
    """Run tests in a copy, in a child of this process that has all libraries loaded; return the one that fails."""
    child = os.fork()
    if child:
        return _first_failure(folder) if _await(child) else ""
    code = 1
    try:
        code = _pytest(folder, tests)
    except BaseException:
        traceback.print_exc()
        raise
    finally:
        os._exit(code)


def _first_failure(folder: Path) -> str:
    """Return the test that ended a run, from the run's log."""
    lines = (folder / "log.txt").read_text("utf-8", "replace").splitlines()
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    return failed[0].rpartition("hardware/")[2] if failed else "no end of the tests"


def _pytest(folder: Path, tests: Sequence[str]) -> int:
    """Run tests in a copy, silently, with its modules instead of those loaded before; return the exit code."""
    import pytest

    os.chdir(folder)
    os.setpgid(0, 0)
    os.environ |= {"PYTHONPATH": str(folder / "src"), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    sys.path[:0] = [str(folder / "src"), str(folder / "tests")]
    for name in [name for name in sys.modules if name.partition(".")[0] == "napari_elsplus"]:
        del sys.modules[name]
    log = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT)
    os.dup2(log, 1)
    os.dup2(log, 2)
    paths = [f"tests/hardware/{test}" for test in tests]
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-k", "not grpc", "-m", "not slow", *paths]))


def _await(child: int) -> int:
    """Return the exit status of a child, which is ended when its time is up."""
    until_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1]


def _import_what_the_tests_need() -> None:
    """Import libraries once, and nothing of the package, so that each child starts in no time."""
    import cv2  # noqa: F401
    import hypothesis  # noqa: F401
    import nidaqmx.stream_readers
    import nidaqmx.stream_writers  # noqa: F401
    import numba  # noqa: F401
    import pydantic  # noqa: F401
    import pytest  # noqa: F401
    import scipy.ndimage
    import scipy.optimize  # noqa: F401
    import usb.core  # noqa: F401


@click.command(name="mutations")
@click.argument("words", nargs=-1)
def mutations(words: tuple[str, ...]) -> None:
    """Make deliberate mistakes in the drivers, and count those that the tests let pass."""
    if sys.platform == "win32":
        raise click.ClickException("the tests run in forks of one process, which Windows has not")
    chosen = [m for m in MISTAKES if not words or any(word in m.label for word in words)]
    passed = []
    for mistake, noticed_by, took_s in try_all(chosen):
        click.echo(f"{'noticed' if noticed_by else 'PASSED '} {took_s:5.1f} s  {mistake.label}  [{noticed_by}]")
        if not noticed_by:
            passed.append(mistake)
    click.echo(f"{len(passed)} of {len(chosen)} mistakes pass unnoticed")


if __name__ == "__main__":
    mutations()
