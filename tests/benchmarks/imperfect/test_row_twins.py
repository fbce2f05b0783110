"""Twins of the independent rig: what the best weights along the line could reach is an upper bound."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.imperfect.row_twins import DISTURBANCES, HAZE_UM, Twin, Twins, bow_weights, compare, drawn, markdown
from benchmarks.rigs.row_rig import SPREAD, RowRig
from napari_elsplus.instrument.calibration import Calibration, GalvoSection, OffsetSection, OpticsSection

SMALL = RowRig(
    frames=0, shape=(120, 240), left=(60.0, 59.0), right=(53.5, 180.5), diameter=106.0, seed=31, sweep_frames=60
)


def test_noise_costs_correlation_and_the_best_weights_gain_some() -> None:
    found = compare(SMALL)
    assert 0.9 < found.els < found.noise_free + 1e-3
    assert found.noise_free < found.best < 1


def test_a_bowed_line_takes_other_weights_and_a_straight_one_takes_none() -> None:
    """At the rim of a line that is bowed away from the residual view's slit, that slit shows less of the haze."""
    width_rows = np.hypot(1.4, SPREAD * HAZE_UM / 2.3)

    def haze(rows: float) -> float:
        return float(np.exp(-0.5 * (rows / width_rows) ** 2))

    for bow_rows in (0.0, 2.0, -2.0):
        at = bow_rows * 0.81
        rim = (haze(at) - (1 - haze(10))) / haze(10 + at)
        assert bow_weights(calibrated(bow_rows), 0.1, np.array([0.0, 0.9])) == pytest.approx([1.0, rim], abs=1e-4)


def calibrated(bow_rows: float) -> Calibration:
    return Calibration.model_construct(
        offset=OffsetSection.model_construct(rows=10.0, core_rows=1.4, halo_rows=15.0, halo_share=0.0),
        galvo=GalvoSection.model_construct(bow_rows=bow_rows),
        optics=OpticsSection.model_construct(um_per_px=2.3),
    )


def test_the_table_states_what_a_rough_rig_loses_of_each() -> None:
    rig, twin, rough = drawn(411), Twin(0.95, 0.96, 0.97, 0.951, 1.02), Twin(0.94, 0.955, 0.968, 0.9385, 1.1)
    table = markdown([Twins(rig, {**dict.fromkeys(DISTURBANCES, twin), "rough": rough})])
    ends = "| 0.9500 | 0.9400 | 0.9500 | 0.0100 | 0.0050 | 0.0020 | -0.0015 | 1.02 | 1.10 |"
    assert table.splitlines()[2].endswith(ends)
    assert drawn(411) == rig != drawn(412)
