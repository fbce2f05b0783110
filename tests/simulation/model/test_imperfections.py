"""Imperfections by name: unknown names and numbers out of range are refused in one line that names those that exist."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.imperfections import IDEAL, PARAMETERS, Imperfections
from napari_elsplus.simulation.model.instrument import Instrument


def test_every_number_has_a_plausible_range_within_its_limits_and_an_effect() -> None:
    for name, parameter in PARAMETERS.items():
        low, high = parameter.plausible
        assert parameter.low <= low < high <= parameter.high, name
        assert parameter.effect, name
    assert len(PARAMETERS) == len(fields(Imperfections))
    assert IDEAL.changed == {}
    assert not IDEAL.moves_galvo


@pytest.mark.checkout
def test_the_documentation_lists_them_all() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "simulation.md").read_text(encoding="utf-8")
    for name, (unit, low, high, plausible, effect) in PARAMETERS.items():
        ranges = f"{low:g} to {high:g} | {plausible[0]:g} to {plausible[1]:g}"
        assert f"| `{name}` | {unit or 'ratio'} | {ranges} | {effect} |" in page


@pytest.mark.parametrize("seed", range(20))
def test_a_drawn_instrument_is_plausible_and_its_own(seed: int) -> None:
    drawn = Imperfections.drawn(seed)
    assert Imperfections.of(drawn.changed) == drawn
    assert drawn != Imperfections.drawn(seed + 1)
    for name, value in drawn.changed.items():
        low, high = PARAMETERS[name].plausible
        assert low <= value <= high


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("galvo=800", "no imperfection is called 'galvo'"),
        ("galvo-resonance=80000", "galvo-resonance is 80000, outside of 200 to 10000 Hz"),
        ("galvo-damping=0", "galvo-damping is 0, outside of 0.05 to 3"),
        ("row-noise=nan", "row-noise is nan"),
        ("row-noise=much", "'row-noise=much' is no imperfection"),
        ("row-noise", "'row-noise' is no imperfection"),
    ],
)
def test_a_wrong_imperfection_is_refused_in_one_line_with_the_names(text: str, problem: str) -> None:
    with pytest.raises(InputError) as refused:
        Imperfections.parse(text)
    told = str(refused.value)
    assert problem in told
    assert "\n" not in told
    assert all(name in told for name in PARAMETERS)


def test_an_s_curve_deviates_by_its_rows_and_is_zero_at_middle_and_rim() -> None:
    ideal, bent = (Instrument.of("120hz", imperfections=Imperfections.parse(text)) for text in ("", "galvo-s-curve=2"))
    radius = ideal.diameter_px / 2
    rows = ideal.confocal_centre[0] + radius * np.linspace(-1, 1, 2001)
    volts = ideal.volts_at_row_zero + ideal.volts_per_row * rows
    np.testing.assert_allclose(ideal.line_row(volts), rows, atol=1e-9)
    off = bent.line_row(volts) - rows
    assert np.abs(off[[0, 1000, 2000]]).max() < 1e-9
    assert np.abs(off).max() == pytest.approx(2, abs=1e-5)
    assert off[1500] == pytest.approx(-off[500])
