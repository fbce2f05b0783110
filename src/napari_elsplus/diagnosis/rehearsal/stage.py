"""A rehearsal of one fault: its processes, and the expectations that judge it."""

from __future__ import annotations

import json
import math
import os
import secrets
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from multiprocessing.connection import Listener
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, Self, cast

import numpy as np
import psutil

from napari_elsplus.acquisition.engine.status import Settings, Status
from napari_elsplus.acquisition.streaming.recorder import RecordingPlan
from napari_elsplus.diagnosis.rehearsal.card_log import CardLog
from napari_elsplus.diagnosis.rehearsal.messages import ADDRESS, Exposures, request
from napari_elsplus.errors import DeviceError, ElsPlusError
from napari_elsplus.hardware.virtual.galvo import GalvoModel
from napari_elsplus.io import open_recording
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.acquisition.link.messages import Channel
    from napari_elsplus.instrument.calibration import Calibration

PRESET: Final = "240hz"
"""Camera region and frame rate of the rehearsal."""
OFFSET_UM: Final = -29.0
"""Slit offset of the rehearsed instrument, as that of the simulated rig."""
START_TIMEOUT_S: Final = 60.0
"""Time in which processes have to start; chosen: ten times that of an idle computer."""
CALL_TIMEOUT_S: Final = 30.0
"""Time for a command; chosen: above every command's own limits."""
LATER_S: Final = 0.5
"""Seconds for which the galvo is observed beyond a limit; chosen: retries and resets would show in it."""
IN_FLIGHT_S: Final = 0.1
"""Seconds before a fault in which frames may still be on their way; chosen: above the latency of a busy computer."""
KILL: Final = getattr(signal, "SIGKILL", signal.SIGTERM)
"""Signal that ends a process at once; Windows has one only, which does."""
FRAMES_BEFORE: Final = 40
"""Frames recorded before a fault; chosen: a sixth of a second at 240 Hz."""


class Stage:
    """Window, engine, card and guardian of one rehearsal. A context manager: leaving it ends all of them.

    Attributes
    ----------
    problems : list of str
        What was expected and not observed.
    messages : list of str
        Messages of the software under test.
    fault_s : float
        Time of the fault, on the card's clock.
    """

    def __init__(self) -> None:
        self.settings = Settings(PRESET)
        self.problems: list[str] = []
        self.messages: list[str] = []
        self.fault_s = math.nan
        self.parked_s: float | None = None
        self.lost = self.lost_silently = 0
        self.engine_pid = 0
        self.exposures: Exposures | None = None
        self.reported: dict[str, int] = {}
        self.instrument = Instrument.of(PRESET, offset_um=OFFSET_UM)
        self._held = ExitStack()
        self._key = secrets.token_bytes(16)

    def __enter__(self) -> Self:
        with ExitStack() as held:
            held.callback(self.kill_engine)
            self.folder = Path(held.enter_context(TemporaryDirectory(ignore_cleanup_errors=True)))
            self.recording = self.folder / "rehearsal.ome.tif"
            self._listener = held.enter_context(Listener(("127.0.0.1", 0), authkey=self._key))
            self.window_process = self.start([sys.executable, "-m", "napari_elsplus.diagnosis.rehearsal.window"])
            held.callback(_end, self.window_process)
            role, _, self._window = self._accept()
            assert role == "window"
            held.callback(self._window.close)
            self._held = held.pop_all()
        return self

    def __exit__(self, *reason: object) -> None:
        self._held.close()

    # what the processes do

    def start(self, command: list[str]) -> subprocess.Popen[bytes]:
        """Start a process by a command; it reports to this rehearsal, and its own messages go nowhere."""
        port = cast("tuple[str, int]", self._listener.address)[1]
        environment = {**os.environ, ADDRESS: json.dumps({"port": port, "key": self._key.hex()})}
        environment["ELSPLUS_CONFIG"] = str(self.folder)
        output = None if os.environ.get("ELSPLUS_REHEARSAL_VERBOSE") else subprocess.DEVNULL
        return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output)

    def open(self) -> None:
        """Open the rig and configure it; the engine's process reports."""
        number = self.begin("open", "simulated")
        self.accept_engine()
        self.result(number)
        self.call("configure", self.settings)
        self.call("use", self.calibration())

    def connect(self) -> None:
        """Start another engine from the same window, after :meth:`close`."""
        self._request("connect")

    def copy_images(self) -> None:
        """Let the window copy every image of the engine until it is closed."""
        self.wait_for(lambda: self._request("copy_images"), "image in the window")

    def kill_engine(self) -> None:
        """Kill the engine's process, if it is there."""
        pid, self.engine_pid = self.engine_pid, 0
        if pid:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, KILL)

    def accept_engine(self) -> None:
        """Wait for the process that has opened the rig."""
        role, facts, self._switches = self._accept()
        assert role == "engine"
        self._held.callback(self._switches.close)
        self.engine_pid = int(facts["pid"])
        self.log = self._held.enter_context(CardLog(facts["place"], self.instrument))

    def calibration(self) -> Calibration:
        """Return the true calibration of the rehearsed instrument."""
        return true_calibration(self.instrument).with_galvo(lag_s=GalvoModel().lag_s)

    def scan(self, *, record: bool = True) -> None:
        """Open the rig, scan, and record until frames are in the file."""
        self.open()
        self.call("start")
        self.wait_for(lambda: self.status().acquired > FRAMES_BEFORE, "frames")
        if record:
            self.call("record", RecordingPlan(self.recording))
            self.wait_for(lambda: self.status().recorded > FRAMES_BEFORE, "recorded frames")
        if not self.scans():
            raise DeviceError("the galvo does not scan before the fault", "report this")

    def scans(self) -> bool:
        """Return True if the drive was on the bundle within the last tenth of a second."""
        now_s = time.perf_counter()
        return self.log.on_bundle(now_s - 0.1, now_s)

    def finish(self) -> None:
        """End the stream, wait until the recording is complete, and expect every frame of before the fault in it."""
        self.note_exposures()
        self.status()
        self.call("stop")
        self.wait_for(lambda: not getattr(self.status().recording, "running", False), "end of the recording")
        self.expect_recording()

    def switch(self, name: str, *arguments: Any, **options: Any) -> Any:
        """Use the fault switch of that name; see `napari_elsplus.diagnosis.rehearsal.engine.Switches`."""
        return request(self._switches, "engine", CALL_TIMEOUT_S, name, *arguments, **options).result

    def fault(self, name: str, *arguments: Any, **options: Any) -> None:
        """Inject a fault by the switch of that name, and note its time."""
        self.fault_s = request(self._switches, "engine", CALL_TIMEOUT_S, name, *arguments, **options).answered_s

    def card_fault(self, **faults: Any) -> None:
        """Inject a fault of the card; see `napari_elsplus.hardware.virtual.card.faults.CardFaults`."""
        self.fault_s = time.perf_counter()
        self.log.card.inject(**faults)

    def begin(self, name: str, *arguments: Any) -> int:
        """Send the command of that name from the window; return its number."""
        return int(self._request("call", name, *arguments))

    def result(self, number: int, timeout_s: float = CALL_TIMEOUT_S) -> Any:
        """Return the result of the command of that number within `timeout_s`, or raise its error."""
        return self._request("wait", number, timeout_s, answer_s=timeout_s + CALL_TIMEOUT_S)

    def call(self, name: str, *arguments: Any) -> Any:
        """Send the command of that name from the window, and return its result or raise its error."""
        return self.result(self.begin(name, *arguments))

    def close(self) -> None:
        """Close the engine, as the window does."""
        self._request("close")

    def status(self) -> Status:
        """Return the newest status that the window has; what it reports is kept."""
        status, died = self._request("status")
        self.keep_messages(*(f"{fault.source}: {fault}" for fault in status.faults), *([str(died)] if died else []))
        if status.acquired:
            self.reported = dict(status.dropped)
        return cast("Status", status)

    def wait_for(self, condition: Callable[[], object], what: str, timeout_s: float = CALL_TIMEOUT_S) -> None:
        """Wait until a condition holds.

        Parameters
        ----------
        condition : callable
            Returns a true value.
        what : str
            What is awaited, for the message.
        timeout_s : float
            Longest wait.

        Raises
        ------
        DeviceError
            If it does not hold in time.
        """
        end_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end_s:
                raise DeviceError(f"no {what} within {timeout_s:g} s", "close other programs, then rehearse again")
            time.sleep(0.02)

    # what is expected

    def keep_messages(self, *messages: str) -> None:
        """Keep messages of the software under test, each once."""
        self.messages += [message for message in messages if message and message not in self.messages]

    def expect(self, condition: object, problem: str) -> None:
        """Note a problem unless a condition holds."""
        if not condition:
            self.problems.append(problem)

    def expect_parked(self, limit_s: float) -> None:
        """Expect the galvo clear of the bundle for good within `limit_s` of the fault, by the card's log."""
        until_s = self.fault_s + limit_s + LATER_S
        time.sleep(max(0.0, until_s - time.perf_counter()))
        until_s = time.perf_counter()
        self.parked_s = self.log.clear_after_s(self.fault_s, until_s)
        if self.parked_s is None:
            self.parked_s = until_s - self.fault_s
            self.problems.append(f"the line is still on the bundle after {self.parked_s:.2f} s")
        elif self.parked_s > limit_s:
            self.problems.append(f"the line left the bundle after {self.parked_s:.2f} s")

    def expect_scanning(self) -> None:
        """Expect that the galvo goes on scanning."""
        self.expect(self.scans(), "the galvo does not scan any more")

    def expect_reported(self, *words: str, timeout_s: float = 2.0) -> None:
        """Expect a message with one of some words within `timeout_s`."""
        end_s = time.monotonic() + timeout_s
        while not self._reported(words) and time.monotonic() < end_s:
            self.status()
            time.sleep(0.05)
        self.expect(self._reported(words), f"nothing about {' or '.join(words)} was reported")

    def expect_refused(self, number: int, *words: str, timeout_s: float = 2.0) -> None:
        """Expect that the command of that number is refused within `timeout_s`, with one of some words."""
        try:
            self.result(number, timeout_s)
        except ElsPlusError as error:
            self.keep_messages(str(error))
            self.expect(any(word in str(error) for word in words), f"refused for another reason: {error}")
        except Exception as error:  # noqa: BLE001 - whatever it is, it is not a refusal
            self.problems.append(f"{type(error).__name__} instead of a refusal: {error}")
        else:
            self.problems.append("the command was not refused")

    def expect_frames_go_on(self) -> None:
        """Expect that `FRAMES_BEFORE` further frames are acquired and processed."""
        before = self.status()
        with suppress(DeviceError):
            self.wait_for(lambda: self.status().processed >= before.processed + FRAMES_BEFORE, "frames", 3.0)
        now = self.status()
        self.expect(now.live and now.processed >= before.processed + FRAMES_BEFORE, "frames do not go on")

    def expect_undisturbed(self) -> None:
        """Expect that galvo and frames go on, and every frame of before the fault in the recording; end the stream."""
        self.expect_scanning()
        self.expect_frames_go_on()
        self.finish()

    def expect_recording(self, *, complete: bool = True) -> None:
        """Expect that every frame of the camera before the fault is in the recording, or was reported as lost.

        Parameters
        ----------
        complete : bool
            Frames missing at the end are lost without a report; False: the end of the engine is their report.
        """
        exposures = self.exposures
        assert exposures is not None
        try:
            with open_recording(self.recording) as recording:
                numbers = recording.frame_numbers
                readable = np.asarray(recording[len(recording) - 1]).any()
        except (ElsPlusError, OSError) as error:
            self.problems.append(f"the recording cannot be read: {error}")
            return
        self.expect(readable and (np.diff(numbers) > 0).all(), "the recording's frames are not in order")
        newest = exposures.frame + math.floor((self.fault_s - IN_FLIGHT_S - exposures.read_out_s) / exposures.period_s)
        gaps = int(numbers[-1] - numbers[0] + 1 - len(numbers))
        tail = max(0, newest - int(numbers[-1]))
        reported = sum(self.reported.values())
        self.lost = gaps + tail
        self.lost_silently = max(0, gaps - reported) + (tail if complete else 0)
        self.expect(not self.lost_silently, f"{self.lost_silently} frames are missing and were not reported")

    def note_exposures(self) -> None:
        """Keep the camera's own record of its frames, before the process that holds it may end."""
        self.exposures = self.switch("exposures")

    def later(self, **changes: Any) -> Settings:
        """Return the settings with changes."""
        return replace(self.settings, **changes)

    # inside

    def _reported(self, words: tuple[str, ...]) -> bool:
        return any(word in message for message in self.messages for word in words)

    def _request(self, name: str, *arguments: Any, answer_s: float = 2 * CALL_TIMEOUT_S) -> Any:
        return request(self._window, "window", answer_s, name, *arguments).result

    def _accept(self) -> tuple[str, dict[str, Any], Channel]:
        """Accept a connection; processes that never come end the wait."""
        found: list[Channel] = []

        def accept() -> None:
            with suppress(OSError):
                found.append(self._listener.accept())

        waiting = Thread(target=accept, name="rehearsal", daemon=True)
        waiting.start()
        waiting.join(START_TIMEOUT_S)
        if not found:
            raise DeviceError("a process of the rehearsal did not start", "close other programs, then rehearse again")
        role, facts = found[0].recv()
        return role, facts, found[0]


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process: in order when its connection is closed, else by a signal."""
    with suppress(subprocess.TimeoutExpired):
        process.wait(START_TIMEOUT_S / 4)
    process.kill()
    process.wait()


def ends_within(pid: int, timeout_s: float) -> bool:
    """Return True if the process of a pid ends within `timeout_s`."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        if not psutil.pid_exists(pid):
            return True
        time.sleep(0.05)
    return False
