from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import CalibrationError, InputError, MeasurementError
from napari_elsplus.instrument.calibration import Calibration, OpticsSection
from napari_elsplus.workflows.sectioning import SectionedImages, section

SHAPE = (60, 130)
RAW = np.random.default_rng(0).integers(0, 200, (5, *SHAPE)).astype(np.uint8)


@pytest.fixture
def calibration() -> Calibration:
    return Calibration.parse(
        {
            "frame": {"shape": SHAPE},
            "bundle": {
                "confocal_centre": [30.0, 32.0],
                "residual_centre": [28.0, 96.0],
                "diameter_px": 50,
                "residual_to_confocal": [[1, 0, 2], [0, 1, -64]],
            },
        }
    )


@pytest.mark.parametrize(("mode", "count"), [("ls", 5), ("residual", 5), ("els", 5), ("elsa", 2)])
def test_each_mode_gives_its_number_of_images(calibration: Calibration, mode: str, count: int) -> None:
    result = section(RAW, calibration, mode)[:]
    assert result.shape == (count, 52, 52)
    assert result.dtype == np.float32


@pytest.mark.parametrize(("mode", "frames", "period_s"), [("els", 5, 0.01), ("elsa", 2, 0.02), ("elsa", 3, 0.02)])
def test_images_are_as_far_apart_as_the_frames_that_each_is_made_of(
    calibration: Calibration, mode: str, frames: int, period_s: float
) -> None:
    timed = calibration.model_copy(update={"optics": OpticsSection(line_period_s=1e-4, line_periods_per_frame=100)})
    assert section(RAW[:frames], timed, mode).frame_period_s == pytest.approx(period_s)


def test_els_is_ls_minus_residual(calibration: Calibration) -> None:
    ls, residual, els = (section(RAW, calibration, mode)[:] for mode in ("ls", "residual", "els"))
    assert np.array_equal(els, ls - residual)


def test_any_image_can_be_asked_for_in_any_order(calibration: Calibration) -> None:
    lazy = SectionedImages(RAW, calibration, "els")
    backwards = [lazy[k] for k in (4, 3, 2, 1, 0)]
    assert np.array_equal(backwards[::-1], section(RAW, calibration, "els")[:])
    assert np.array_equal(lazy[-1], backwards[0])
    with pytest.raises(IndexError):
        lazy[5]


def test_flat_field_divides_where_it_is_bright(calibration: Calibration) -> None:
    flat = np.full((52, 52), 2.0, np.float32)
    flat[:, :26] = 0.05
    flattened = section(RAW, calibration.model_copy(update={"flat": flat}), "ls", flat_field=True)[:]
    plain = section(RAW, calibration, "ls")[:]
    assert flattened[:, :, 26:] == pytest.approx(plain[:, :, 26:] / 2)
    assert not flattened[:, :, :26].any()


def test_what_cannot_be_done_is_said(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="elsa needs 2 frames, the recording has 1"):
        section(RAW[:1], calibration, "elsa")
    with pytest.raises(InputError, match="has 0"):
        section(RAW[:0], calibration, "ls")
    with pytest.raises(CalibrationError, match="no flat field"):
        section(RAW, calibration, "ls", flat_field=True)
    with pytest.raises(CalibrationError, match="calibrate it again"):
        section(RAW, calibration.model_copy(update={"flat": np.ones((9, 9), np.float32)}), "ls")
    with pytest.raises(MeasurementError, match="needs a flat field"):
        section(RAW, calibration, "ls", cores="interpolate")
    with pytest.raises(CalibrationError, match="no bundle section"):
        section(RAW, Calibration(), "ls")


@pytest.mark.parametrize("background", [None, np.ones(SHAPE, np.float32)], ids=["no background", "background"])
def test_frames_of_another_size_than_calibrated_are_refused(
    calibration: Calibration, background: np.ndarray | None
) -> None:
    raw = np.zeros((3, 50, 100), np.uint8)
    known = calibration.model_copy(update={"background": background})
    with pytest.raises(CalibrationError, match="frame has 60 x 130 pixels, the recording 50 x 100"):
        section(raw, known, "els")


@pytest.mark.parametrize("mode", ["ls", "els", "elsa"])
@pytest.mark.parametrize("cores", ["none", "median"])
def test_what_is_saved_is_what_is_computed_one_by_one(
    calibration: Calibration, mode: str, cores: str, tmp_path: Path
) -> None:
    images = section(RAW, calibration, mode, cores=cores)
    images.save(tmp_path / "images.ome.tif")
    assert np.array_equal(tifffile.imread(tmp_path / "images.ome.tif").reshape(images.shape), images[:], equal_nan=True)


def test_an_error_in_writing_ends_the_second_thread(
    calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: it waited for frames without end, and with it the program, after Ctrl-C for instance."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("napari_elsplus.io.disk.SpanWriter.write", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        section(RAW, calibration, "els").save(tmp_path / "images.ome.tif")
    assert caught.tb is not None  # it holds every frame of the call, and the images that one of them iterates
    assert not any(thread.name.startswith("images") for thread in threading.enumerate())


class OneBuffer:
    """Frames as some cameras' drivers hand them out: each overwrites the one before."""

    def __init__(self) -> None:
        self._buffer = np.empty(SHAPE, np.uint8)

    def __len__(self) -> int:
        return len(RAW)

    def __getitem__(self, index: int) -> np.ndarray:
        self._buffer[:] = RAW[index]
        return self._buffer


@pytest.mark.parametrize("mode", ["els", "elsa"])
@pytest.mark.parametrize("threads", [1, 2])
def test_frames_that_overwrite_the_one_before_give_the_images_of_those_that_stay(
    calibration: Calibration, mode: str, threads: int, tmp_path: Path
) -> None:
    expected = section(RAW, calibration, mode)[:]
    images = section(OneBuffer(), calibration, mode)
    images.save(tmp_path / "images.ome.tif", threads=threads)
    assert np.array_equal(images[:], expected, equal_nan=True)
    assert np.array_equal(tifffile.imread(tmp_path / "images.ome.tif"), expected, equal_nan=True)
