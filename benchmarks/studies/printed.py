"""Axial response as printed in the paper: the reference of these benchmarks.

A. D. Thrapp and M. R. Hughes, "Reduced motion artifacts and speed improvements in enhanced line-scanning fiber bundle
endomicroscopy", J. Biomed. Opt. (2021), "Optical Sectioning and Signal Drop".
"""

from __future__ import annotations

from typing import Final

import numpy as np

LS_UM: Final = {3: (58.0, 3.0), 10: (550.0, 20.0)}
"""Drop-off distance of LS and its uncertainty, by dB."""
ELS_FITS: Final = {3: (58.0, 0.032), 10: (550.0, 0.0084)}
"""Limit (um) and rate (1/um) of the fits to ELS, ``limit (1 - exp(-rate offset))``, by dB."""
SLIT_FITS: Final = {
    ("ls", 3): (0.065, 0.084, 26.0),
    ("els", 3): (0.042, 0.83, 19.0),
    ("ls", 10): (0.44, -4.0, 270.0),
    ("els", 10): (0.034, 2.6, 170.0),
}
"""Quadratics in the slit width (um), by curve and dB."""
SMALL_OFFSETS_UM: Final = {2.9: (13.0, 59.0), 5.8: (9.6, 42.0), 8.6: (12.5, 45.0)}
"""3 dB and 10 dB distance of ELS (um) at offsets below 12 um, where they follow no curve."""
LS_BY_SLIT_UM: Final = {1.9: 70.0, 2.9: 70.0, 5.8: 67.0}
"""3 dB distance of LS (um) by the slit's width (um)."""
OFFSETS_UM: Final = (12.0, 29.0, 40.0, 58.0, 77.0)
"""Slit offsets that were measured, but for those below 12 um, where the printed fits leave the measurements."""


def els_drop_off_um(offset_um: float, decibel: int) -> float:
    """Drop-off distance of ELS that the printed fit gives at an offset.

    Examples
    --------
    >>> round(els_drop_off_um(29.0, 3), 1), round(els_drop_off_um(29.0, 10), 1)
    (35.1, 118.9)
    """
    limit, rate = ELS_FITS[decibel]
    return float(limit * (1 - np.exp(-rate * offset_um)))
