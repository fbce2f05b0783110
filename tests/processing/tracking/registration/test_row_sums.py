from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.compiled import lean_kernel
from napari_elsplus.processing.tracking.registration import row_sums

NAMES = [name for name in vars(row_sums) if len(name) == 2 and name.isupper()]


@lean_kernel
def added(template, row, begin, size, samples, tone, column, powers, moments):
    at = row * template.shape[1] + begin
    row_sums.add_row_sums(template, at, template.shape[1], samples, tone, size, column, powers, moments)


@pytest.mark.parametrize("size", [1, 7, 8, 16, 37])
@pytest.mark.parametrize("column", [None, np.float32(-5.5)])
def test_moments_are_sums_of_products_over_the_row(size: int, column: np.float32 | None) -> None:
    random = np.random.default_rng(size)
    template = random.normal(3, 1, (9, 50)).astype(np.float32)
    samples = random.normal(3, 1, 60).astype(np.float32)
    gain, offset, powers = 1.2, 0.3, (1.0, -4.0, 16.0)
    moments = np.ones((3, row_sums.MOMENTS))
    added(template, 4, 7, size, samples, (np.float32(gain), np.float32(offset)), column, powers, moments)

    near, columns = template.astype(float), slice(7, 7 + size)
    values = {"1": np.ones(size), "T": near[4, columns], "I": samples[:size].astype(float)}
    values["Y"], values["X"] = (near[5, columns] - near[3, columns]) / 2, (near[4, 8:][:size] - near[4, 6:][:size]) / 2
    values["E"] = values["I"] - gain * values["T"] - offset
    values["G"] = (values["X"] ** 2 + values["Y"] ** 2) * values["E"]
    if column is not None:
        away = column + np.arange(size)
        values |= {"W": away * values["Y"], "U": away * values["X"]}
    for name in NAMES:
        if all(letter in values for letter in name):
            total, found = (values[name[0]] * values[name[1]]).sum(), moments[:, getattr(row_sums, name)] - 1
            np.testing.assert_allclose(found, np.multiply(powers, total), rtol=1e-4, atol=1e-3, err_msg=name)
    assert len(NAMES) == 27
