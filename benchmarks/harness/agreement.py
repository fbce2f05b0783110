"""Agreement of an image with the one that is expected."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def unexplained(seen: NDArray[np.floating], expected: NDArray[np.floating]) -> float:
    """Return the fraction of the seen contrast that the expected image does not explain, whatever gain and offset.

    Parameters
    ----------
    seen, expected : numpy.ndarray
        (n,) pixels of an image, and of the ideal image.

    Returns
    -------
    float
        Square root of one minus the squared correlation: 0 is perfect, 1 is nothing in common.

    Examples
    --------
    >>> unexplained(np.array([1.0, 2.0, 4.0]), np.array([30.0, 50.0, 90.0])) < 1e-6
    True
    >>> round(unexplained(np.array([1.0, 2.0, 3.0]), np.array([1.0, 3.0, 2.0])), 3)
    0.866
    """
    rho = float(np.corrcoef(seen, expected)[0, 1])
    return float(np.sqrt(max(1 - rho**2, 0.0)))
