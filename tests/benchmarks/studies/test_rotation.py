from __future__ import annotations

import numpy as np
import pytest

from benchmarks.studies.rotation import compared
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import Velocity
from napari_elsplus.processing.tracking.registration.motion_models import turned_by


def test_a_track_is_compared_in_the_orientation_of_its_first_frame() -> None:
    angle = 0.3 + 0.01 * np.arange(6)
    true_px = np.array([5.0, 7.0]) + np.outer(np.arange(6), (20.0, -8.0))
    found = 0.5 * (true_px - true_px[0]) @ turned_by(-0.3).T
    found[4:, 0] += 0.5
    still = Velocity(0.0, 0.0)
    poses = [
        Pose(0, row, col, still, 0.9, 0.5, TrackingState.TRACKED, turned)
        for (row, col), turned in zip(found.tolist(), (angle - 0.3).tolist(), strict=True)
    ]
    result = compared(poses, 2.0, true_px, angle)
    assert result.tracked.all()
    np.testing.assert_allclose(result.error_px, [0, 0, 0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(result.sigma_px, 1.0)
    assert result.angle_deg == pytest.approx(0.0, abs=1e-9)
    assert result.end_percent == pytest.approx(100 / np.hypot(100, 40))
