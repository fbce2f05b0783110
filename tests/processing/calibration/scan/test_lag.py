"""The scan's lag: found to a few hundredths of a row on rigs drawn at random, refused where the signal tells none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.calibration.scan.lag import fit_lag, measure_lag, take_leads

LINE_S = 7.648e-6


def signal(leads_s: np.ndarray, lag_s: float, width_rows: float = 4.0) -> np.ndarray:
    return 20 + 60 * np.exp(-0.5 * ((leads_s - lag_s) / (width_rows * LINE_S)) ** 2)


@given(lag_rows=st.floats(2, 95), width_rows=st.floats(2.5, 8))
@settings(max_examples=30, deadline=None)
def test_any_lag_that_a_galvo_may_have_is_found(lag_rows: float, width_rows: float) -> None:
    def signal_at(lead_s: float, shift_rows: float) -> float:
        return float(signal(np.array(lead_s + shift_rows * LINE_S), lag_rows * LINE_S, width_rows))

    found = measure_lag(signal_at, LINE_S)
    assert found.lag_s / LINE_S == pytest.approx(lag_rows, abs=0.01)
    assert found.leads_s[np.argmax(found.signal)] == pytest.approx(found.lag_s, abs=LINE_S)


def test_lags_of_random_rigs_are_found_and_their_uncertainty_holds() -> None:
    """Within 0.3 rows, the aim; with a halo, a tilted line and light that flickers."""
    rigs = [Rig.draw(seed) for seed in range(600, 640)]
    found = [measure_lag(lambda lead, rows, of=rig: of.scanned_signal(lead / LINE_S + rows), LINE_S) for rig in rigs]
    errors = np.array([lag.lag_s / LINE_S - rig.lag_rows for lag, rig in zip(found, rigs, strict=True)])
    stated = np.array([lag.uncertainty_s / LINE_S for lag in found])
    assert np.abs(errors).max() < 0.15
    assert 0.5 < np.mean(np.abs(errors) < stated) < 0.9
    assert np.mean(np.abs(errors) < 3 * stated) > 0.9


def test_the_search_is_watched_and_can_be_given_up() -> None:
    numbers: list[int] = []

    def impatient(every: Iterable[int]) -> Iterator[int]:
        for number in every:
            if number == 5:
                raise InputError("the lag was cancelled", "start it again when you like")
            numbers.append(number)
            yield number

    with pytest.raises(InputError, match="cancelled"):
        take_leads(lambda lead_s, shift: float(signal(np.array(lead_s + shift * LINE_S), 3e-4)), LINE_S, impatient)
    assert numbers == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("kind", ["dark", "flat", "rising", "noise"])
def test_a_signal_without_a_maximum_is_refused(kind: str) -> None:
    leads = np.arange(40) * 1.5 * LINE_S
    random = np.random.default_rng(0)
    values = {
        "dark": np.zeros(40),
        "flat": 100 + 0.2 * random.normal(size=40),
        "rising": np.linspace(10, 90, 40),
        "noise": 100 + random.normal(0, 3, 40),
    }[kind]
    with pytest.raises(MeasurementError, match=r"the signal (has no maximum|hardly depends on the lead)"):
        fit_lag(leads, values, LINE_S)
