"""A wrong ramp gives a wrong image: calibration and scan judged by the picture, on the bench's one clock.

Correlation alone hides dimming, so brightness is judged too, band by band: the regression of the ELS+ image against the
one from an ideal scan.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.rig import Rig
from napari_elsplus.hardware.rigs import open_rig
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.hardware.scan.waveform import Waveform, els_waveform, exposed_rows, ramp_waveform
from napari_elsplus.hardware.virtual.bench import OpticalBench, Simulation
from napari_elsplus.hardware.virtual.camera.device import Shot
from napari_elsplus.hardware.virtual.timeline import BenchClock, Program, StrobeTrain
from napari_elsplus.instrument.optics import PRESETS
from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import nuclei
from napari_elsplus.simulation.specimen.trajectories import Still

PRESET = PRESETS["240hz"]


@pytest.fixture(scope="module")
def rig():
    scene = Simulation(scene=nuclei(), trajectory=Still(), real_time=False)
    with open_rig("simulated", scene) as opened:
        region = Region(*PRESET.sensor_origin, *PRESET.frame_shape)
        opened.camera.configure(region, slit_rows=3, frame_rate_hz=PRESET.optics.frame_rate_hz)
        yield opened


@pytest.fixture(scope="module")
def sectioner(rig) -> Sectioner:
    return Sectioner(rig.bench.optics.calibration(PRESET), PRESET.frame_shape)


@pytest.fixture(scope="module")
def ideal(rig, sectioner) -> np.ndarray:
    """ELS+ rendered directly, without camera, card and mirror."""
    renderer = Renderer(rig.bench.optics.instrument(PRESET), nuclei(), Still(), seed=100)
    return np.mean([sectioner.els(renderer.render(k)) for k in range(4)], axis=0)


def timing(rig: Rig) -> ScanTiming:
    return ScanTiming(rig.camera.line_period_s, rig.camera.line_periods_per_frame, 3, rig.strobe)


def scanned(rig: Rig, sectioner: Sectioner, waveform: Waveform) -> np.ndarray:
    """ELS+ through the drivers: scan, stream, section; the first frames pass while the mirror gets going."""
    rig.scanner.scan(waveform)
    rig.camera.start()
    try:
        buffer = np.empty(rig.camera.frame_shape, np.uint8)
        images = []
        for _ in range(10):
            rig.camera.read_into(buffer, 30.0)
            images.append(sectioner.els(buffer).copy())
        rig.scanner.check()
    finally:
        rig.camera.stop()
        rig.scanner.park()
    return np.mean(images[-4:], axis=0)


def agreement(
    image: np.ndarray, ideal: np.ndarray, diameter_px: float, part: float = 0.9, bands: int = 12
) -> tuple[float, float, np.ndarray]:
    """Correlation and slope over (a part of) the disc, and the slope in each of its bands from top to bottom."""
    inside = disc(len(ideal), part * diameter_px)
    correlation = np.corrcoef(image[inside], ideal[inside])[0, 1]
    slope = np.polyfit(ideal[inside], image[inside], 1)[0]
    rows = np.array_split(np.flatnonzero(inside.any(1)), bands)
    local = []
    for band in rows:
        x, y = (picture[band][inside[band]] for picture in (ideal, image))
        local.append((x @ y) / (x @ x))
    return correlation, slope, np.array(local)


def changed(known, **galvo):
    return known.model_copy(update={"galvo": known.galvo.model_copy(update=galvo)})


def test_with_the_right_calibration_the_image_is_right(rig, sectioner, ideal) -> None:
    known = rig.bench.optics.calibration(PRESET)
    image = scanned(rig, sectioner, els_waveform(known, timing(rig), rig.limits))
    correlation, slope, bands = agreement(image, ideal, known.bundle.diameter_px)
    assert correlation >= 0.98
    assert 0.97 <= slope <= 1.03
    assert bands.min() > 0.95
    assert bands.max() < 1.05


@pytest.mark.parametrize("wrong", ["slope", "offset", "lag"])
def test_a_wrong_calibration_dims_the_image_somewhere(rig, sectioner, ideal, wrong) -> None:
    """A slope 5 % wrong, 5 rows, an uncompensated lag of 220 us."""
    known = rig.bench.optics.calibration(PRESET)
    galvo = known.galvo
    middle = known.bundle.confocal_centre[0]
    changes = {
        "slope": {
            "volts_per_row": 1.05 * galvo.volts_per_row,
            "volts_at_row_zero": galvo.volts(middle) - 1.05 * galvo.volts_per_row * middle,
        },
        "offset": {"volts_at_row_zero": galvo.volts_at_row_zero + 5 * galvo.volts_per_row},
        "lag": {"lag_s": 0.0},
    }
    assert galvo.lag_s == pytest.approx(220e-6, abs=5e-6)
    limits = rig.limits
    waveform = els_waveform(changed(known, **changes[wrong]), timing(rig), limits)
    image = scanned(rig, sectioner, waveform)
    assert agreement(image, ideal, known.bundle.diameter_px)[2].min() < 0.8


def test_a_flyback_while_the_residual_image_is_exposed_is_seen(rig, sectioner, ideal) -> None:
    """The residual image stands 22 rows higher: the line flies through its first rows; the top of the disc shows it."""
    known = rig.bench.optics.calibration(PRESET)
    left = exposed_rows(known.bundle, residual=False)
    image = scanned(rig, sectioner, ramp_waveform(known.galvo, left, timing(rig), rig.limits))
    bands = agreement(image, ideal, known.bundle.diameter_px, 0.99, 40)[2]
    right = scanned(rig, sectioner, els_waveform(known, timing(rig), rig.limits))
    good = agreement(right, ideal, known.bundle.diameter_px, 0.99, 40)[2]
    assert bands.min() < 0.8
    assert np.abs(good - 1).max() < 0.02


def test_where_the_card_holds_the_line_the_camera_sees_it(rig) -> None:
    instrument = rig.bench.optics.instrument(PRESET)
    rig.scanner.hold(instrument.volts_at_row_zero + 250 * instrument.volts_per_row)
    rig.camera.start()
    try:
        frame = np.empty(rig.camera.frame_shape, np.uint8)
        for _ in range(4):
            rig.camera.read_into(frame, 30.0)
    finally:
        rig.camera.stop()
    assert instrument.line_row(rig.bench.card.last_volts) == pytest.approx(250)
    half = frame.shape[1] // 2
    brightest = [
        np.convolve(view.mean(1, dtype=float), np.ones(9), "same").argmax()
        for view in (frame[:, :half], frame[:, half:])
    ]
    assert brightest[0] == pytest.approx(250, abs=4)
    assert brightest[1] - brightest[0] == pytest.approx(instrument.offset_rows, abs=4)
    rig.scanner.park()
    bundle = rig.bench.optics.calibration(PRESET).bundle
    clear_um = (exposed_rows(bundle)[0] - instrument.line_row(rig.bench.card.last_volts)) * PRESET.optics.um_per_px
    assert clear_um >= 100 - 30  # the paper's clearance from the confocal image, the residual one standing 29 um higher


def test_the_rows_of_a_steady_scan_are_computed_once_and_anew_when_the_output_changes() -> None:
    optics, programs = PRESET.optics, []
    card = SimpleNamespace(programs=lambda: programs)

    def new_bench() -> OpticalBench:
        return OpticalBench(Simulation(), card, BenchClock(real_time=False))

    def rows_of(bench: OpticalBench, frame: int) -> np.ndarray:
        region, line_s = (*PRESET.sensor_origin, *PRESET.frame_shape), optics.line_period_s
        start_s = frame * optics.frame_period_s
        return bench.line_rows(Shot(frame, start_s, region, 3 * line_s, line_s, optics.frame_period_s, 0.0))

    train = StrobeTrain(0.0, optics.frame_period_s)
    ramp = Program(0.0, 0.0, np.linspace(-0.4, 0.2, 900), 900, 250e3, strobe=train)
    programs, bench = [ramp], new_bench()
    first, steady = rows_of(bench, 1), rows_of(bench, 20)
    assert rows_of(bench, 21) is rows_of(bench, 57) is steady
    assert first is not steady
    programs, later = [replace(ramp, strobe=replace(train, start_s=80 * optics.frame_period_s))], new_bench()
    for frame in (80, 81, 120):  # it begins with the first strobe, however long the output was ready
        np.testing.assert_allclose(rows_of(later, frame), rows_of(new_bench(), frame), atol=1e-6)
    assert np.abs(rows_of(new_bench(), 80) - rows_of(later, 120)).max() > 1
    two_ramps = replace(ramp, samples=np.concatenate([ramp.samples, ramp.samples[::-1]]))
    strobe_lost = replace(ramp, strobe=replace(train, end_s=22 * optics.frame_period_s))
    for output in (two_ramps, strobe_lost, Program(0.0, 0.1)):
        programs = [output]
        for frame in (40, 41):
            np.testing.assert_allclose(rows_of(bench, frame), rows_of(new_bench(), frame), atol=1e-6)
        assert np.abs(rows_of(bench, 41) - steady).max() > 1
