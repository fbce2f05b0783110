from __future__ import annotations

import numpy as np

from napari_elsplus.processing.mosaicing.coverage import Coverage
from napari_elsplus.processing.mosaicing.tiles import Rectangle


def test_counts_and_means_are_those_of_the_discs_that_cover_a_cell() -> None:
    rng = np.random.default_rng(0)
    places, scores = rng.uniform(-100, 500, (50, 2)), rng.uniform(0.5, 1, 50)
    scores[0] = np.nan
    coverage = Coverage(Rectangle(-24, 16, 360, 416), 60.0)
    coverage.add(places[:20], scores[:20])
    coverage.add(places[20:], scores[20:])
    frames, quality = coverage.frames, coverage.quality
    row, col = (8 * (np.arange(size) + 0.5) + first for size, first in zip(frames.shape, (-24, 16), strict=True))
    covers = np.hypot(row[:, None, None] - places[:, 0], col[None, :, None] - places[:, 1]) <= 60
    np.testing.assert_array_equal(frames, covers.sum(axis=2))
    scored = covers[..., 1:]
    mean = (scored * scores[1:]).sum(axis=2) / np.maximum(scored.sum(axis=2), 1)
    seen = scored.any(axis=2)
    np.testing.assert_allclose(quality[seen], mean[seen], atol=1e-5)
    assert np.isnan(quality[~seen]).all()
    assert (frames == 0).any()
    assert frames.max() > 2
