"""Twins of the independent rig: what the best weights along the line could reach is an upper bound."""

from __future__ import annotations

from benchmarks.imperfect.row_twins import DISTURBANCES, Twin, Twins, compare, drawn, markdown
from benchmarks.rigs.row_rig import RowRig

SMALL = RowRig(
    frames=0, shape=(120, 240), left=(60.0, 59.0), right=(53.5, 180.5), diameter=106.0, seed=31, sweep_frames=60
)


def test_noise_costs_correlation_and_the_best_weights_gain_some() -> None:
    found = compare(SMALL)
    assert 0.9 < found.els < found.noise_free + 1e-3
    assert found.noise_free < found.best < 1


def test_the_table_states_what_a_rough_rig_loses_of_each() -> None:
    rig, twin = drawn(411), Twin(0.95, 0.96, 0.97)
    table = markdown([Twins(rig, {**dict.fromkeys(DISTURBANCES, twin), "rough": Twin(0.94, 0.955, 0.968)})])
    assert table.splitlines()[2].endswith("| 0.9500 | 0.9400 | 0.9500 | 0.0100 | 0.0050 | 0.0020 |")
    assert drawn(411) == rig != drawn(412)
