from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter
from napari_elsplus.viewing.mosaic.growing import COARSEST_PX, GrowingImage

GRID = Grid(120, 1, (0, 0), (59.5, 59.5), 116.0, RollingShutter(150.0))


def inserted(mosaic: Mosaic, row: float, col: float) -> None:
    rng = np.random.default_rng(int(abs(row + 7 * col)))
    mosaic.insert(1 + rng.random((120, 120)).astype(np.float32), row, col)


def test_every_level_shows_the_mosaic_while_it_grows() -> None:
    mosaics = {0: Mosaic(GRID), 1: Mosaic(GRID)}
    image = GrowingImage()
    for k, (row, col) in enumerate([(0, 0), (30, 20), (700, -1400), (710, -1380), (2500, 100), (2510, 90)]):
        inserted(mosaics[k % 2], row, col)
        image.update(mosaics)
        coarsest = image.levels[-1]
        for level, finer in enumerate(image.levels[:-1]):
            whole = np.asarray(finer)
            part = np.s_[10:400:3, 5:300]
            np.testing.assert_array_equal(finer[part], whole[part])
            np.testing.assert_equal(finer[7, -9], whole[7, -9])
            np.testing.assert_array_equal(finer[-1], whole[-1])
            step = 2 ** (len(image.levels) - 1 - level)
            assert np.array_equal(_any(np.isfinite(whole), step), np.isfinite(coarsest))
        for number, mosaic in mosaics.items():
            if mosaic.extent is not None:
                at = mosaic.extent.translated(*image.sheet.origin(number))
                shown, (grey, weight) = np.asarray(image.levels[0])[at.slices(image.frame)], mosaic.read()
                np.testing.assert_array_equal(shown, np.where(weight > 0, grey, np.nan))
    assert max(image.levels[-1].shape) <= COARSEST_PX
    assert not image.update(mosaics).pixels


def test_the_coarsest_level_is_filled_in_place_so_that_whoever_keeps_it_sees_it() -> None:
    mosaic, image = Mosaic(GRID), GrowingImage()
    inserted(mosaic, 0, 0)
    image.update({0: mosaic})
    kept = image.levels[-1]
    before = np.isfinite(kept).sum()
    inserted(mosaic, 60, 60)
    change = image.update({0: mosaic})
    assert (change.pixels, change.frame) == (True, False)
    assert image.levels[-1] is kept
    assert np.isfinite(kept).sum() > before


def test_white_is_what_hardly_anything_exceeds() -> None:
    image = GrowingImage()
    assert image.white_level == 1.0
    mosaic = Mosaic(GRID)
    mosaic.insert(np.full((120, 120), 50, np.float32), 0, 0)
    image.update({0: mosaic})
    assert image.white_level == 50


def _any(drawn: np.ndarray, step: int) -> np.ndarray:
    rows, cols = drawn.shape
    return drawn.reshape(rows // step, step, cols // step, step).any(axis=(1, 3))


RASTER = """
import sys
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pathlib import Path
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.mosaicing.mosaic import Mosaic
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.viewing.mosaic.growing import GrowingImage

def resident_mb():
    fields = (line.split() for line in Path("/proc/self/status").read_text().splitlines())
    return next(int(field[1]) for field in fields if field[0] == "RssAnon:") / 1024

calibration = true_calibration(Instrument.of("240hz"))
grid = Grid.of(calibration)
side = 20_000 / (calibration.optics.um_per_px * grid.binning) - grid.diameter
frame = np.ones((grid.side, grid.side), np.float32)
mosaic, image = Mosaic(grid), GrowingImage()
before_mb = resident_mb()
for row in np.arange(0, side + 100, 100):
    for col in np.arange(0, side + 100, 100):
        mosaic.insert(frame, float(row), float(col))
    image.update({0: mosaic})
print(min(mosaic.extent.shape) * calibration.optics.um_per_px * grid.binning, resident_mb() - before_mb)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is told by Linux only")
def test_twenty_by_twenty_millimetres_take_less_than_a_gigabyte() -> None:
    done = subprocess.run([sys.executable, "-c", RASTER], capture_output=True, text=True, check=True, timeout=300)
    side_um, grown_mb = map(float, done.stdout.split())
    assert side_um > 19_900
    assert 400 < grown_mb < 1000
