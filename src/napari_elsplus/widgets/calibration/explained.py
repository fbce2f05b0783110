"""Each step in a line: what it measures, and what has to be done for it at the microscope."""

from __future__ import annotations

from typing import Final

from napari_elsplus.processing.calibration.draft import Step

EXPLAINED: Final = {
    Step.OFFSET: "Rows between the line in both views: the distance of the residual's slit from the line.",
    Step.GALVO: "Which voltage puts the line onto which row: a sweep of the mirror, and a straight line through it.",
    Step.PAIR: "Where the two images of the bundle are, and how the right one is laid onto the left.",
    Step.LAG: "How late the mirror is at full speed: the lead at which most light passes the slit.",
    Step.BACKGROUND: "What the camera sees without a sample: reflections and the bundle's own light, 50 frames.",
    Step.FLAT: "How bright an even sample looks: cores and illumination. The bundle pair has given a first one.",
}
PREPARE: Final = {
    Step.OFFSET: "Probe on an evenly fluorescent target, laser on. Turn the tilt mirror while you watch.",
    Step.GALVO: "Probe on an evenly fluorescent target, laser on.",
    Step.PAIR: "Light the bundle from its far end; the mirror is parked.",
    Step.LAG: "Probe on an evenly fluorescent target, laser on.",
    Step.BACKGROUND: "Probe in the dark tube, laser on.",
    Step.FLAT: "Probe on an evenly fluorescent target, laser on.",
}
SIMULATED: Final = "The simulated rig does this by itself."
