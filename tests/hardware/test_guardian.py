"""However the process that drives the mirror dies, the line is off the bundle within half a second."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict

import pytest

from napari_elsplus.acquisition.engine.engine import Engine
from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware import takeover as takeover_module
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.guardian import supervision as guardian_module
from napari_elsplus.hardware.guardian.process import STANDSTILL_S, guard
from napari_elsplus.hardware.guardian.supervision import COMMAND, SILENT_S, Guardian
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.takeover import ParkOrder
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.hardware.virtual.card.card import VirtualCard
from napari_elsplus.hardware.virtual.card.grpc_server import CardServer
from napari_elsplus.hardware.virtual.card.process import RemoteCard
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.scenes import empty
from napari_elsplus.simulation.truth import park_volts
from ni_library import replacing_ni_library

PRESET = PRESETS["240hz"]
PARK_V = park_volts(Instrument.of(PRESET.name))
DRIVE = """
    import json, signal, time
    from napari_elsplus.hardware.rigs import open_rig
    from napari_elsplus.hardware.virtual.bench import Simulation
    from napari_elsplus.hardware.virtual.timeline import StrobeTrain
    from napari_elsplus.hardware.scan.timing import ScanTiming
    from napari_elsplus.hardware.scan.waveform import els_waveform
    from napari_elsplus.instrument.optics import PRESETS
    from napari_elsplus.simulation.specimen.scenes import empty

    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which is ignored where the tests run under `nohup`
    preset = PRESETS["240hz"]
    with open_rig("simulated", Simulation(scene=empty(), own_process=True)) as rig:
        timing = ScanTiming(preset.optics.line_period_s, preset.optics.line_periods_per_frame, 3)
        rig.scanner.scan(els_waveform(rig.bench.optics.calibration(preset), timing, rig.limits))
        rig.scanner.watch_frames(None)  # the strobe comes without a camera
        rig.bench.card.strobe(StrobeTrain(time.perf_counter(), preset.optics.frame_period_s))
        print(json.dumps(rig.bench.card.place), flush=True)
        time.sleep(60)
"""


def order_for(address: str, park_v: float = -0.7) -> ParkOrder:
    return ParkOrder(CardSettings(park_v, address=address), GalvoLimits(min_v=-2.0, max_v=2.0))


def seconds_until(condition: Callable[[], bool], within_s: float = 5.0) -> float:
    begin = time.perf_counter()
    while not condition():
        assert time.perf_counter() - begin < within_s, "it never came to that"
    return time.perf_counter() - begin


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM", "SIGHUP", "SIGINT"])
def test_the_mirror_is_parked_however_the_driving_process_dies(how) -> None:
    """The card lives on, and goes on sweeping by itself until somebody stops it."""
    driver = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(DRIVE)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    place = json.loads(driver.stdout.readline())
    driver.stdout.close()
    instrument = Instrument.of(PRESET.name)
    top = instrument.confocal_centre[0] - instrument.diameter_px / 2

    def clearances_um() -> set[float]:
        """Where the line stands above the bundle, some milliseconds long."""
        rows = ((card.last_volts - instrument.volts_at_row_zero) / instrument.volts_per_row for _ in range(20))
        return {instrument.optics.um(top - row) for row in rows}

    with RemoteCard(place) as card:
        seconds_until(lambda: len(clearances_um()) > 5)  # it sweeps
        driver.send_signal(getattr(signal, how))
        took = seconds_until(lambda: min(clearances_um()) > 99.9)
        assert driver.wait(10) == {"SIGKILL": -9, "SIGTERM": 143, "SIGHUP": 129, "SIGINT": -2}[how]
        assert min(clearances_um()) > 99.9
    if how == "SIGKILL":
        assert took < 0.5


def test_a_dismissed_guardian_leaves_the_mirror_alone() -> None:
    card = VirtualCard()
    with CardServer(card) as server:
        with Guardian(order_for(server.address)) as guardian:
            assert card.last_volts == 0.0
        assert card.last_volts == 0.0
        assert not guardian._process.alive


@pytest.mark.parametrize(("end", "volts"), [("", -0.7), ("farewell\n", 0.0)])
def test_orders_that_end_without_a_farewell_are_carried_out(end, volts) -> None:
    card = VirtualCard()
    with CardServer(card) as server:
        order = json.dumps(asdict(order_for(server.address)))
        answers = io.StringIO()
        guard(io.StringIO(f"{order}\n{end}"), answers)
    assert answers.getvalue() == "ready\n"
    assert card.last_volts == volts


@pytest.mark.parametrize(("later", "volts"), [(-0.9, -0.9), (None, -0.7)])
def test_the_last_whole_order_counts(later, volts) -> None:
    card = VirtualCard()
    with CardServer(card) as server:
        first = order_for(server.address)
        second = (
            '{"card": {"park_v": -0.' if later is None else json.dumps(asdict(order_for(server.address, later))) + "\n"
        )
        guard(io.StringIO(json.dumps(asdict(first)) + "\n" + second), io.StringIO())
    assert card.last_volts == volts


def test_a_guardian_that_is_killed_is_replaced_with_the_newest_order_and_that_is_reported() -> None:
    """Before: nothing was on guard any more, without a word."""
    with (
        CardServer(VirtualCard()) as server,
        Guardian(order_for(server.address)) as guardian,
    ):
        first = guardian.pid
        guardian.revise(-0.9)
        os.kill(first, signal.SIGKILL)
        seconds_until(lambda: guardian.pid != first and len(guardian.reports) > 0 and guardian.on_guard)
        assert guardian.order.card.park_v == -0.9
        assert "guardian" in str(guardian.reports[0])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_guardian_that_stands_still_is_replaced_and_that_is_reported() -> None:
    """Before: it went unnoticed, and nothing would have parked."""
    lost: list[DeviceError] = []
    with (
        CardServer(VirtualCard()) as server,
        Guardian(order_for(server.address), lost.append) as guardian,
    ):
        time.sleep(3 * SILENT_S)
        assert not guardian.reports, "one that answers is left alone"
        first = guardian.pid
        os.kill(first, signal.SIGSTOP)
        stopped_s = time.perf_counter()
        seconds_until(lambda: bool(lost) or (guardian.on_guard and guardian.pid != first))
        assert (
            time.perf_counter() - stopped_s < 2.0
        )  # on a busy computer; the rehearsal holds the 1 s by the card's clock
        seconds_until(lambda: guardian.on_guard and len(guardian.reports) > 0, 20)
        assert "did not answer" in str(guardian.reports[0])
        with pytest.raises(ProcessLookupError):
            os.kill(first, 0)


def test_a_guardian_that_is_told_to_end_by_others_than_its_process_stays() -> None:
    """Before: SIGTERM to all processes, as at a logout, ended it before it could park."""
    card = VirtualCard()
    with CardServer(card) as server:
        guardian = Guardian(order_for(server.address))
        for name in {"SIGTERM", "SIGHUP", "SIGINT"} & set(dir(signal)) if sys.platform != "win32" else ():
            os.kill(guardian.pid, getattr(signal, name))
        guardian.hand_over()
        seconds_until(lambda: card.last_volts == -0.7)
        seconds_until(lambda: not guardian.on_guard)
        guardian.dismiss()


@pytest.mark.parametrize("cut_off", ["", '{"card": {"park_v": -0.'])
def test_a_guardian_whose_process_dies_before_it_gave_an_order_ends_in_silence(cut_off: str) -> None:
    """Before: with a traceback, as after Ctrl-C while a rig was opened."""
    answers = io.StringIO()
    guard(io.StringIO(cut_off), answers)
    assert answers.getvalue() == ""


class Broken(io.StringIO):
    """A pipe whose other end is closed."""

    def flush(self) -> None:
        raise BrokenPipeError


def test_a_guardian_whose_process_dies_before_it_is_ready_parks() -> None:
    """Before: it ended by its answer, which nobody received."""
    card = VirtualCard()
    with CardServer(card) as server:
        order = json.dumps(asdict(order_for(server.address)))
        guard(io.StringIO(order + "\n"), Broken())
    assert card.last_volts == -0.7


@pytest.mark.skipif(sys.platform == "win32", reason="fills a pipe as POSIX does")
def test_a_terminal_that_takes_no_message_does_not_stop_parking() -> None:
    """Before: a terminal that was stopped by Ctrl-S held up every attempt but the first."""
    card = VirtualCard()
    reading, terminal = os.pipe()
    os.set_blocking(terminal, False)
    while True:
        try:
            os.write(terminal, b"." * 1024)
        except BlockingIOError:
            break
    os.set_blocking(terminal, True)
    with CardServer(card) as server:
        order = json.dumps(asdict(order_for(server.address)))
        process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=terminal, text=True)
        process.stdin.write(order + "\n")
        process.stdin.flush()
        assert process.stdout.readline() == "ready\n"
        card.inject(refuse_s=0.5)
        process.stdin.close()
        try:
            seconds_until(lambda: card.last_volts == -0.7)
            assert process.wait(10) == 0
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
    os.close(reading)
    os.close(terminal)


def test_who_reports_and_fails_does_not_stop_parking() -> None:
    """Before: the first message that could not be written ended it, not parked."""
    card = VirtualCard()

    def fail(_: object) -> None:
        raise AttributeError("there is no terminal")

    with CardServer(card) as server:
        card.inject(refuse_s=0.3)
        assert order_for(server.address).take_over(fail).parked
    assert card.last_volts == -0.7


def no_memory(*_: object, **__: object) -> None:
    raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))


def no_thread(*_: object, **__: object) -> None:
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize("exhaust", [no_memory, no_thread])
def test_a_guardian_that_no_memory_lets_start_is_asked_for_until_it_comes_while_the_galvo_is_parked(
    monkeypatch, exhaust
):
    """Before: the thread that watches ended; without threads it went on, and the galvo was not parked."""
    parks: list[DeviceError] = []
    with (
        CardServer(VirtualCard()) as server,
        Guardian(order_for(server.address), parks.append) as guardian,
    ):
        first = guardian.pid
        with monkeypatch.context() as exhausted:
            exhausted.setattr(guardian_module.subprocess, "Popen", exhaust)
            os.kill(first, signal.SIGKILL)
            seconds_until(lambda: len(parks) > 1)
            assert "so the galvo was parked" in str(guardian.reports[0])
            with pytest.raises(DeviceError, match="no guardian"):
                guardian.check()
        seconds_until(lambda: guardian.on_guard and guardian.pid != first, 20)
        guardian.check()


def test_a_guardian_that_never_comes_back_can_be_dismissed_and_revised(monkeypatch) -> None:
    """Before: ValueError, from its closed pipe."""
    with CardServer(VirtualCard()) as server:
        guardian = Guardian(order_for(server.address))
        monkeypatch.setattr(guardian_module.subprocess, "Popen", no_memory)
        os.kill(guardian.pid, signal.SIGKILL)
        seconds_until(lambda: len(guardian.reports) > 0)
        guardian.revise(-0.8)
        guardian.dismiss()


def test_the_supervision_of_a_guardian_outlives_whoever_fails_on_its_reports() -> None:
    """Before: the first exception of a subscriber, or of what parks, ended it."""
    parks: list[DeviceError] = []

    def fail(report: DeviceError) -> None:
        parks.append(report)
        raise RuntimeError("a defect elsewhere")

    with (
        CardServer(VirtualCard()) as server,
        Guardian(order_for(server.address), fail) as guardian,
    ):
        guardian.on_report(fail)
        for _ in range(2):
            now = guardian.pid
            os.kill(now, signal.SIGKILL)
            seconds_until(lambda now=now: guardian.on_guard and guardian.pid != now, 20)
        seconds_until(lambda: bool(parks))


def test_neither_an_engine_nor_a_script_moves_a_galvo_that_has_no_guardian(monkeypatch) -> None:
    """Before: a scan was accepted while nothing was on guard; then one of the scanner itself."""
    rig = open_rig("simulated", Simulation(scene=empty(), own_process=True))
    with Engine(rig) as engine:
        engine.hold(0.1)
        with monkeypatch.context() as exhausted:
            exhausted.setattr(guardian_module.subprocess, "Popen", no_memory)
            os.kill(rig.guardian.pid, signal.SIGKILL)
            seconds_until(lambda: rig.scanner.park_state.parked)
            for hold in (engine.hold, rig.scanner.hold):
                with pytest.raises(DeviceError, match="no guardian"):
                    hold(0.1)
            seconds_until(lambda: rig.scanner.park_state.parked)
        seconds_until(lambda: rig.guardian.on_guard, 20)
        engine.hold(0.1)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_guardian_that_the_system_cannot_end_does_not_hold_up_its_replacement(monkeypatch) -> None:
    """Before: its end was waited for without end, and nothing was on guard meanwhile, without a word."""
    with (
        CardServer(VirtualCard()) as server,
        Guardian(order_for(server.address)) as guardian,
    ):
        first = guardian.pid
        with monkeypatch.context() as held_up:
            held_up.setattr(guardian_module.subprocess.Popen, "kill", lambda _: None)
            os.kill(first, signal.SIGSTOP)
            seconds_until(lambda: guardian.pid != first and guardian.on_guard, 20)
        os.kill(first, signal.SIGKILL)


def test_a_guardian_goes_around_a_call_to_the_card_that_does_not_return() -> None:
    """Before: it waited without end, and the line stood on the bundle."""
    card = VirtualCard()
    with replacing_ni_library(card):
        order = json.dumps(asdict(order_for("")))
        card.inject(hangs=True)
        thread = threading.Thread(target=guard, args=(io.StringIO(order + "\n"), io.StringIO()), daemon=True)
        thread.start()
        thread.join(10)
        assert not thread.is_alive()
    assert card.last_volts == -0.7


def test_an_order_that_fails_is_carried_out_again(monkeypatch) -> None:
    """Before: a guardian without memory for the first call ended, and nobody parked."""
    card = VirtualCard()
    opened = []

    def open_without_memory(*arguments: object, **options: object) -> DaqScanner:
        opened.append(arguments)
        if len(opened) < 3:
            raise MemoryError
        return DaqScanner(*arguments, **options)

    monkeypatch.setattr(takeover_module, "DaqScanner", open_without_memory)
    told: list[str] = []
    with CardServer(card) as server:
        order = json.dumps(asdict(order_for(server.address)))
        guard(io.StringIO(order + "\n"), io.StringIO(), lambda state: told.append(state.message))
    assert card.last_volts == -0.7
    assert told[0].startswith("NOT PARKED")


def test_a_guardian_whose_start_is_interrupted_is_ended(monkeypatch) -> None:
    """Before: it stayed, and took the card over two seconds later from whoever drove it then."""
    started: list[guardian_module.GuardianProcess] = []

    def interrupt(process: guardian_module.GuardianProcess, _: float) -> bool:
        started.append(process)
        raise KeyboardInterrupt

    monkeypatch.setattr(guardian_module.GuardianProcess, "wait_until_ready", interrupt)
    card = VirtualCard()
    with CardServer(card) as server:
        with pytest.raises(KeyboardInterrupt):
            Guardian(order_for(server.address))
        seconds_until(lambda: not started[0].alive)
    assert card.last_volts == 0.0


def test_a_guardian_that_cannot_reach_the_card_does_not_pretend_to_watch() -> None:
    with pytest.raises(DeviceError, match="guardian did not start"):
        Guardian(order_for("127.0.0.1:9"))


SCRIPT = """
    import json, sys, time
    from napari_elsplus.acquisition.engine.engine import Engine
    from napari_elsplus.acquisition.engine.status import Settings
    from napari_elsplus.hardware.rigs import open_rig
    from napari_elsplus.hardware.virtual.bench import Simulation
    from napari_elsplus.instrument.optics import PRESETS
    from napari_elsplus.simulation.specimen.scenes import empty

    rig = open_rig("simulated", Simulation(scene=empty(), own_process=True))
    with Engine(rig) as engine:
        engine.configure(Settings("240hz"))
        engine.use(rig.bench.optics.calibration(PRESETS["240hz"]))
        engine.start()
        print(json.dumps([rig.bench.card.place, rig.guardian.pid]), flush=True)
        while True:
            guardian = rig.guardian
            state = rig.scanner.park_state
            reports = [str(report) for report in guardian.reports]
            print(json.dumps([guardian.pid, guardian.on_guard, state.stage, reports]), flush=True)
            time.sleep(0.05)
"""


@pytest.fixture
def script() -> Iterator[tuple[subprocess.Popen[str], RemoteCard, int]]:
    """A script that opens a rig by itself and scans; its card, and its guardian."""
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(SCRIPT)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    place, guardian = json.loads(process.stdout.readline())
    with RemoteCard(place) as card:
        seconds_until(lambda: len(card.programs()[-1].samples) > 0, 20)
        yield process, card, guardian
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stdout.close()
        card.inject(refuse_until_s=0.0)
        seconds_until(lambda: is_parked(card), 20)


def is_parked(card: RemoteCard) -> bool:
    """Whether the output stands where the simulated rig parks."""
    newest = card.programs()[-1]
    return not len(newest.samples) and abs(newest.resting_v - PARK_V) < 0.2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_script_that_opens_a_rig_has_a_guardian(script) -> None:
    """Before: only the engine's process and the command line had one."""
    process, card, _ = script
    killed_s = time.perf_counter()
    process.kill()
    seconds_until(lambda: is_parked(card), 10)
    assert card.programs()[-1].since_s - killed_s < 0.5


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_process_that_stands_still_is_parked_and_told_when_it_goes_on(script) -> None:
    """Before: Ctrl-Z left the galvo sweeping without end, and nothing checked it."""
    process, card, guardian = script
    stopped_s = time.perf_counter()
    process.send_signal(signal.SIGSTOP)  # as Ctrl-Z does, which a group without a terminal ignores
    seconds_until(lambda: is_parked(card), 10)
    assert 0.8 * STANDSTILL_S < card.programs()[-1].since_s - stopped_s < STANDSTILL_S + 1.0  # on a busy computer
    time.sleep(0.5)
    process.send_signal(signal.SIGCONT)
    while True:
        pid, on_guard, stage, reports = json.loads(process.stdout.readline())
        assert is_parked(card)
        if pid != guardian and on_guard and stage == "parked" and reports:
            break
    assert "stood still" in reports[0]
    assert "what ended it" not in reports[0], "nothing has ended"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
def test_a_process_that_is_killed_is_parked_although_its_child_holds_the_pipe() -> None:
    """Before: the guardian noticed the death of its process when the last forked child ended."""
    forks = SCRIPT.replace("engine.start()", "engine.start(); import os; os.fork() or (time.sleep(20), os._exit(0))")
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(forks)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        start_new_session=True,
    )  # fmt: skip
    place, _ = json.loads(process.stdout.readline())
    with RemoteCard(place) as card:
        seconds_until(lambda: len(card.programs()[-1].samples) > 0, 20)
        killed_s = time.perf_counter()
        process.kill()
        seconds_until(lambda: is_parked(card), 10)
        assert card.programs()[-1].since_s - killed_s < STANDSTILL_S + 1.0  # the same
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_guardian_takes_over_a_card_that_refuses_as_soon_as_it_accepts(script) -> None:
    """Before: it gave up after two seconds."""
    process, card, _ = script
    card.inject(refuse_s=4.0)
    accepts_s = time.perf_counter() + 4.0
    process.kill()
    seconds_until(lambda: is_parked(card), 10)
    assert -0.1 < card.programs()[-1].since_s - accepts_s < 0.5


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_guardian_killed_while_scanning_is_replaced_or_the_galvo_parks_and_both_are_reported(script) -> None:
    """Before: six seconds later it was still scanning with nothing on guard, and no fault."""
    process, card, guardian = script
    killed_s = time.perf_counter()
    os.kill(guardian, signal.SIGKILL)
    while True:
        pid, on_guard, _, reports = json.loads(process.stdout.readline())
        if (pid != guardian and on_guard) or is_parked(card):
            break
    assert time.perf_counter() - killed_s < 1.5  # to see it takes a moment; the card's clock follows
    if is_parked(card):
        assert card.programs()[-1].since_s - killed_s < 1.0
    while not reports:
        *_, reports = json.loads(process.stdout.readline())
    assert "guardian" in reports[0]


def test_a_guardian_is_dismissed_only_when_the_galvo_is_parked() -> None:
    """Before: the rig was closed, and with it the guardian, while the card refused."""
    with open_rig("simulated", Simulation(scene=empty(), own_process=True)) as rig:
        rig.scanner.hold(0.1)
        rig.bench.card.inject(refuse_s=3.0)
    assert not rig.scanner.park_state.parked
    assert rig.scanner.park_state.message.startswith("NOT PARKED")
    assert rig.guardian.on_guard
    seconds_until(lambda: rig.scanner.park_state.parked, 10)
    seconds_until(lambda: not rig.guardian.on_guard, 10)


def test_a_guardian_is_dismissed_although_closing_was_interrupted(monkeypatch) -> None:
    """Before: it stayed until the program ended, and then took the card from whoever used it."""
    rig = open_rig("simulated", Simulation(scene=empty(), own_process=True))
    with monkeypatch.context() as interrupted:
        interrupted.setattr(rig.scanner, "close", lambda: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            rig.close()
    rig.scanner.close()
    seconds_until(lambda: not rig.guardian.on_guard, 10)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_guardian_that_stands_still_does_not_hold_up_its_dismissal() -> None:
    with CardServer(VirtualCard()) as server:
        guardian = Guardian(order_for(server.address))
        os.kill(guardian.pid, signal.SIGSTOP)
        begun_s = time.perf_counter()
        guardian.dismiss()
        assert time.perf_counter() - begun_s < 5
        assert not guardian.on_guard
