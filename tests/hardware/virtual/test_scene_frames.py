from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.hardware.virtual.remembered_frames import MAX_FILES
from napari_elsplus.hardware.virtual.scene_frames import SceneFrames
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import fibres, plate
from napari_elsplus.simulation.specimen.trajectories import Circle, Still


def test_frames_come_again_from_memory_while_the_line_moves_alike_and_only_then() -> None:
    instrument = Instrument.of("240hz")
    source = SceneFrames(instrument, plate(0.0), Circle(period_s=4 / 240), seed=0, ahead=True)
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    out = np.empty(instrument.frame_shape, np.uint8)

    def frame(number: int, late_rows: float) -> np.ndarray:
        source.fill(number, out, rows - late_rows)
        return out.copy()

    source.render_ahead(rows - 0.4)
    first = [frame(number, 0.4) for number in range(4)]
    again = [frame(number, 0.4) for number in range(4, 8)]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    missed = frame(8, 8.0)
    assert missed.mean() < 0.9 * first[0].mean()
    assert frame(9, 8.0).mean() < 0.9 * first[0].mean()
    assert frame(10, 0.4).mean() > 0.95 * first[2].mean()


def test_a_second_start_recalls_the_frames_of_a_closed_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_CACHE", str(tmp_path))
    instrument = Instrument.of("240hz")
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    frame = np.empty(instrument.frame_shape, np.uint8)

    def started(seed: int = 0, late_rows: float = 0.4) -> tuple[int, np.ndarray]:
        """Number of frames rendered at a start, and a frame."""
        source = SceneFrames(instrument, plate(0.0), Circle(period_s=3 / 240), seed=seed, ahead=True)
        rendered = []
        render = source._renderer.render
        source._renderer.render = lambda k, *a, **b: (rendered.append(k), render(k, *a, **b))[1]
        source.render_ahead(rows - late_rows)
        source.fill(4, frame, rows - late_rows)
        return len(rendered), frame.copy()

    left = tmp_path / "frames" / "frames-0123456789abcdef-01234567.4242"
    left.parent.mkdir()
    left.write_bytes(b"of a program that was killed")
    os.utime(left, (1, 1))
    first, again = started(), started()
    assert (first[0], again[0]) == (4, 1)  # one is always rendered, so that everything is compiled
    np.testing.assert_array_equal(first[1], again[1])
    assert started(seed=1)[0] == started(late_rows=0.8)[0] == 4
    assert started(late_rows=0.41)[0] == 1  # to within the noise the same line
    for cut, header in ((-1, b"("), (None, b"((")):  # before: a header that is spoilt ended the start with a traceback
        for file in tmp_path.rglob("*.npy"):
            file.write_bytes(file.read_bytes()[:cut].replace(b"(", header, 1))
        assert started()[0] == 4
    assert len(list(tmp_path.rglob("*.npy"))) <= MAX_FILES
    assert not left.exists()  # before: for ever, a third of a gigabyte each


def imperfect(text: str = "") -> Instrument:
    drawn = Imperfections.drawn(1) if not text else Imperfections.parse(text)
    return Instrument.of("240hz", imperfections=drawn)


def test_frames_of_a_bleaching_specimen_are_those_rendered_one_by_one_in_the_first_round() -> None:
    instrument, path = imperfect(), Circle(period_s=6 / 240)
    source = SceneFrames(instrument, fibres(), path, seed=3, ahead=True)
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    source.render_ahead(rows)
    alone = Renderer(instrument, fibres(), path, seed=3)
    frame = np.empty(instrument.frame_shape, np.uint8)
    alone.render(0)  # the source does so to compile all: jitters of the first frames are not interpolated
    for number in range(6):
        source.fill(number, frame, rows)
        np.testing.assert_array_equal(frame, alone.render(number))


def test_light_of_a_closed_path_is_computed_once_and_fades_under_noise_that_does_not_recur() -> None:
    source = SceneFrames(imperfect("bleaching=20"), fibres(), Circle(period_s=4 / 240), seed=3, ahead=True)
    rows = np.arange(524.0)
    source.render_ahead(rows)
    computed: list[int] = []
    source._renderer.core_light = lambda *_a, **_b: computed.append(1)  # type: ignore[method-assign]
    first, again, later = (np.empty((524, 1328), np.uint8) for _ in range(3))
    for frame, out in ((1, first), (5, again), (401, later)):
        source.fill(frame, out, rows)
    assert not computed
    assert not np.array_equal(first, again)
    lit = slice(200, 320), slice(280, 380)
    left = [float(image[lit].mean()) - first[:40, :40].mean() for image in (first, again, later)]
    assert left[1] == pytest.approx(left[0], rel=0.03)
    assert left[2] == pytest.approx(0.8**4 * left[0], rel=0.15)  # all but the bundle's own light


def test_frames_of_a_circle_recur_at_every_rate() -> None:
    """Before: at 237 Hz, the rate advised for a slow galvo, each frame was rendered anew, at a third of the pace."""
    instrument = Instrument.of("240hz", rate_hz=237.0)
    source = SceneFrames(instrument, fibres(), Circle(period_s=0.0335), seed=3, ahead=True)
    rows, (first, again, other) = np.arange(524.0), np.empty((3, 524, 1328), np.uint8)
    source.render_ahead(rows)
    for number, out in ((2, first), (10, again), (6, other)):
        source.fill(number, out, rows)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_frames_that_a_late_simulation_skips_bleach_nothing() -> None:
    """Before: a calibration on a busy computer went on in the dark, the even target bleached by frames without end."""
    source = SceneFrames(imperfect("bleaching=20"), plate(0.0), Still(), seed=3, ahead=True)
    rows, (first, later, skipped) = np.arange(524.0), np.empty((3, 524, 1328), np.uint8)
    source.fill(0, first, rows)
    source.fill(2000, later, rows)
    source.fill(2000, skipped, rows, lit_frames=0)
    lit = slice(200, 320), slice(280, 380)
    assert later[lit].mean() < 0.3 * first[lit].mean()
    assert skipped[lit].mean() == pytest.approx(first[lit].mean(), rel=0.02)


def test_what_recurs_leaves_the_statistics_of_imperfect_frames_as_they_are() -> None:
    """Noise in the dark and in the light, rows, hot pixels, power: of frames from memory, and rendered anew."""
    instrument, path, count = imperfect("row-noise=1,power-noise=3,prnu=1,hot-pixels=0.1,bleaching=1"), 2 / 240, 24
    rows = np.arange(instrument.frame_shape[0], dtype=np.float64)
    source = SceneFrames(instrument, plate(0.0), Circle(period_s=path), seed=3, ahead=True)
    alone = Renderer(instrument, plate(0.0), Circle(period_s=path), seed=3)
    source.render_ahead(rows)
    kept, anew = np.empty((2, count, *instrument.frame_shape), np.uint8)
    for number in range(count):
        source.fill(2 * (number + 10), kept[number], rows)
        alone.render(2 * (number + 10), anew[number])
    found = [statistics(frames.astype(np.float32)) for frames in (kept, anew)]
    for name, value in found[1].items():
        assert found[0][name] == pytest.approx(value, rel=0.03), name


def statistics(frames: np.ndarray) -> dict[str, float]:
    dark, lit = frames[:, :, 1220:], frames[:, 210:310, 280:380]
    return {
        "dark level": float(dark.mean()),
        "noise in the dark": float(dark.std(0).mean()),
        "noise of rows": float(dark.mean(2).std(0).mean()),
        "hot pixels": float(np.median((dark.mean(0) > 30).sum(1).mean())),
        "level": float(lit.mean()),
        "noise in the light": float(lit.std(0).mean()),
        "power of rows": float(lit.mean(2).std(0).mean()),
        "pattern": float(lit.mean(0).std()),
    }


def test_a_second_start_recalls_the_light_of_a_closed_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_CACHE", str(tmp_path))
    frames, rows = np.empty((2, 524, 1328), np.uint8), np.arange(524.0)
    computed: list[int] = []
    for frame in frames:
        source = SceneFrames(imperfect("bleaching=5"), plate(0.0), Circle(period_s=3 / 240), seed=0, ahead=True)
        light = source._renderer.core_light
        source._renderer.core_light = lambda *a, _light=light, **b: (computed.append(1), _light(*a, **b))[1]
        source.render_ahead(rows)
        source.fill(4, frame, rows)
    assert len(computed) == (1 + 3) + 1  # one is always rendered, so that everything is compiled
    np.testing.assert_array_equal(*frames)
