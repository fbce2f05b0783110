"""Rigs by name: the simulated one, a user's own from a file, and what is left when a program ends, however it ends."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from napari_elsplus.errors import DeviceError, InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.protocols import Camera, Region, Scanner
from napari_elsplus.hardware.rig_files import read_rig
from napari_elsplus.hardware.rigs import open_rig, rig_names
from napari_elsplus.hardware.scan.timing import ScanTiming, StrobePhase
from napari_elsplus.hardware.scan.waveform import els_waveform
from napari_elsplus.hardware.virtual.bench import Simulation
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections
from napari_elsplus.simulation.specimen.scenes import distal_light, empty, fibres
from napari_elsplus.simulation.specimen.trajectories import Circle

SMALL = Region(262, 0, 524, 1328)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    return tmp_path / "rigs"


def write(folder, text):
    folder.mkdir()
    (folder / "mine.toml").write_bytes(text.encode("latin-1"))


def test_the_simulated_rig_is_first_and_keeps_the_protocols() -> None:
    assert rig_names() == ["simulated", "simulated-real"]
    with open_rig(simulation=Simulation(scene=empty(), real_time=False)) as rig:
        rig.camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        assert isinstance(rig.camera, Camera)
        assert isinstance(rig.scanner, Scanner)
        assert rig.strobe is StrobePhase.EXPOSURE
        assert rig.bench.card.last_volts == rig.scanner.park_v


@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
def test_it_parks_the_line_clear_of_the_bundle_by_a_halos_width(preset) -> None:
    with open_rig(simulation=Simulation(scene=empty(), real_time=False)) as rig:
        instrument = rig.bench.optics.instrument(preset)
        top = instrument.confocal_centre[0] - instrument.diameter_px / 2
        assert (top - instrument.line_row(rig.bench.card.last_volts)) * preset.optics.um_per_px >= 100 - 1e-6


def test_what_the_simulated_rig_looks_at_can_be_changed_between_frames() -> None:
    with open_rig(simulation=Simulation(scene=empty(), real_time=False)) as rig:
        rig.camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        means = []
        for scene in (empty(), distal_light()):
            rig.bench.optics.show(scene)
            rig.camera.start()
            frame = np.empty(rig.camera.frame_shape, np.uint8)
            rig.camera.read_into(frame, 30.0)
            rig.camera.stop()
            means.append(frame.mean())
    assert means[1] > 5 * means[0]


def test_in_real_time_a_closed_path_is_played_again_and_every_round_is_the_same() -> None:
    """Rendered once, so that 240 frames per second leave time for everything else."""
    preset = PRESETS["240hz"]
    simulation = Simulation(scene=fibres(), trajectory=Circle(200, period_s=0.1))
    with open_rig(simulation=simulation) as rig:
        rig.camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        timing = ScanTiming(rig.camera.line_period_s, rig.camera.line_periods_per_frame, 3, rig.strobe)
        rig.scanner.scan(els_waveform(rig.bench.optics.calibration(preset), timing, rig.limits))
        rig.camera.start()
        seen: dict[int, np.ndarray] = {}
        same = 0
        for _ in range(90):
            frame = np.empty(rig.camera.frame_shape, np.uint8)
            number = rig.camera.read_into(frame, 5.0).frame_number
            before = seen.setdefault(number % 24, frame)
            same += before is not frame and np.array_equal(before, frame)
        assert same > 40
        assert len({frame.tobytes() for frame in seen.values()}) == len(seen)


def test_where_the_strobes_wire_breaks_the_mirror_parks_while_the_camera_goes_on() -> None:
    with open_rig(simulation=Simulation(scene=empty())) as rig:
        rig.camera.configure(SMALL, slit_rows=3, frame_rate_hz=240)
        timing = ScanTiming(rig.camera.line_period_s, rig.camera.line_periods_per_frame, 3, rig.strobe)
        rig.scanner.scan(els_waveform(rig.bench.optics.calibration(PRESETS["240hz"]), timing, rig.limits))
        rig.camera.start()
        frame = np.empty(rig.camera.frame_shape, np.uint8)
        for _ in range(5):
            rig.camera.read_into(frame, 5.0)
        rig.scanner.check()
        rig.bench.plug.camera.cut_strobe()
        for _ in range(240):
            rig.camera.read_into(frame, 5.0)
        with pytest.raises(DeviceError, match="no strobe"):
            rig.scanner.check()
        assert rig.bench.card.last_volts == rig.scanner.park_v


def test_a_users_own_rig_is_a_readable_file_that_comes_back_the_same(folder) -> None:
    text = """
        [card]
        park_v = -0.8
        device = "cDAQ1"
        falling = false
        [camera]
        kind = "genicam"
        serial = "14120"
        strobe = "readout"
        [mirror]
        min_v = -1.0
        natural_hz = 800.0
    """
    write(folder, text)
    settings = read_rig("mine")
    assert rig_names() == ["simulated", "simulated-real", "mine"]
    assert settings.mirror.natural_hz == 800
    assert settings.mirror.max_v == 2.0
    assert settings.camera.strobe is StrobePhase.READOUT
    assert settings.card == CardSettings(-0.8, device="cDAQ1", falling=False)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[card]\n", "card.park_v"),
        ("[card]\npark_v = nan\n", "park_v"),
        ("[card]\npark_v = 12\n", "12"),
        ("[card]\npark_v = -3\n", "parking position"),
        ("[card]\npark_v = -0.7\nparkv = 1\n", "parkv"),
        ("[card]\npark_v = -0.7\n[camera]\nkind = 'basler'\n", "basler"),
        ("[card]\npark_v = -0.7\nhold_limit_s = -20\n", "hold_limit_s.*-20"),
        ("[card]\npark_v = -0.7\n[mirror]\nmin_v = 1.0\nmax_v = -1.0\n", "min_v 1 is not below max_v -1"),
        ("[card]\npark_v = -0.7\n[mirror]\nmin_v = -0.5\n", "park_v -0.7 is outside min_v -0.5"),
        ("[card]\npark_v = -0.7\nlaser_line = 'PFI3'\n", "laser_line.*PFI3"),
        ("[card]\npark_v = -0.7\noutput = 'ai0'\n", "output.*ai0"),
        ("[card]\npark_v = -0.7\ncounter = 0\n", "card.counter"),
        ("[card]\npark_v = -0.7\n[mirror]\nnatural_hz = 0.0\n", "rig mine: natural_hz is 0"),
        ("[card]\npark_v = -0.7\n[mirror]\nmax_v = 11.0\n", "-2 to 11 V"),
        ("[card]\npark_v = -0.7\n[mirror]\nmaxv = 1.0\n", "mirror.maxv"),
        ("[simulation]\nimperfections = {galvo = 800}\n", "no imperfection is called 'galvo'"),
        ("[simulation]\nimperfections = {row-noise = 300}\n", "row-noise is 300, outside of 0 to 20"),
        ("[simulation]\n[card]\npark_v = -0.7\n", "card"),
        ("[card\n", "mine"),
        ("\xff", "mine"),
    ],
)
def test_a_wrong_file_says_which_key_and_which_value(folder, text, told) -> None:
    write(folder, text)
    with pytest.raises(InputError, match=told):
        open_rig("mine")


def test_a_file_may_name_an_imperfect_instrument_and_what_is_stated_about_its_galvo(folder) -> None:
    write(
        folder, "[simulation]\nimperfections = {galvo-resonance = 800, row-noise = 0.5}\n[mirror]\nnatural_hz = 1000\n"
    )
    with open_rig("mine", Simulation(scene=empty(), real_time=False)) as rig:
        truth = rig.bench.optics.simulation
        assert (rig.name, rig.limits.natural_hz, truth.moved_galvo.natural_hz) == ("mine", 1000, 800)
        assert rig.bench.optics.instrument(PRESETS["240hz"]).imperfections.row_noise_dn == 0.5


def test_the_real_simulated_rig_is_drawn_by_its_seed_and_states_nothing_about_its_galvo() -> None:
    drawn = []
    for name in ("simulated-real", "simulated-real:0", "simulated-real:7"):
        with open_rig(name, Simulation(scene=empty(), real_time=False)) as rig:
            assert rig.limits.natural_hz is None
            drawn.append(rig.bench.optics.simulation.imperfections)
    assert drawn[0] == drawn[1] != drawn[2]
    with pytest.raises(InputError, match="'x' is no seed"):
        open_rig("simulated-real:x")


def test_an_unknown_rig_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="choose one of simulated"):
        open_rig("theirs")


def test_a_real_rig_without_devices_says_so(folder, monkeypatch) -> None:
    write(folder, "[card]\npark_v = -0.7\n")
    monkeypatch.setattr("usb.core.find", lambda **_: iter(()))
    with pytest.raises(DeviceError, match="no USB3 Vision camera"):
        open_rig("mine")


def test_importing_the_hardware_needs_neither_libusb_nor_nis_driver() -> None:
    code = """
        import sys
        for missing in ("usb.backend.libusb1", "genicam"):
            sys.modules[missing] = None
        import napari_elsplus.hardware, napari_elsplus.hardware.rigs, napari_elsplus.hardware.daq.scanner
        import napari_elsplus.hardware.u3v.flea3, napari_elsplus.hardware.u3v.genapi
        assert "nidaqmx" not in sys.modules
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=True, timeout=60)


def test_a_card_in_its_own_process_shows_the_bench_what_it_does() -> None:
    preset = PRESETS["240hz"]
    with open_rig(simulation=Simulation(scene=empty(), own_process=True)) as rig:
        instrument = rig.bench.optics.instrument(preset)
        rig.scanner.hold(instrument.volts_at_row_zero + 200 * instrument.volts_per_row)
        assert instrument.line_row(rig.bench.card.last_volts) == pytest.approx(200)
        assert rig.bench.card.programs()[-1].resting_v == rig.bench.card.last_volts
    with pytest.raises(DeviceError, match="ended"):
        _ = rig.bench.card.last_volts
    with pytest.raises(InputError, match="real time"):
        open_rig(simulation=Simulation(own_process=True, real_time=False))


@pytest.mark.parametrize(("imperfections", "skips"), [("", False), ("bleaching=20", True)])
def test_only_imperfect_simulated_rigs_skip_frames_when_they_are_late(imperfections: str, skips: bool) -> None:
    """Before: the ideal one lost frames at the start of a scan on a busy computer."""
    drawn = Imperfections.parse(imperfections) if imperfections else IDEAL
    with open_rig(simulation=Simulation(scene=empty(), real_time=False, imperfections=drawn)) as rig:
        assert (rig.bench.plug.camera._moved_s is not None) == skips
