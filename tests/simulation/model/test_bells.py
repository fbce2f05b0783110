from __future__ import annotations

import numpy as np
from scipy.special import erf

from napari_elsplus.simulation.model.bells import BELL, ERF, bell, error_function


def test_tables_give_both_functions_to_a_ten_millionth() -> None:
    arguments = np.random.default_rng(1).normal(0, 4, 20_000)
    np.testing.assert_allclose([bell(BELL, u) for u in arguments], np.exp(-0.5 * arguments**2), atol=1e-7)
    np.testing.assert_allclose([error_function(ERF, u) for u in arguments], erf(arguments), atol=1e-7)


def test_they_end_beyond_their_reach() -> None:
    for far in (6.0, 1e9, np.inf):
        assert bell(BELL, far) == bell(BELL, -far) == 0
        assert error_function(ERF, far) == -error_function(ERF, -far) == 1
