"""Picture of the mosaic of a finished stack with its track: ``python3 run.py bench finished STACK --out PICTURE``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from napari_elsplus.processing.tracking.motion.pose import TrackingState
from napari_elsplus.workflows.mosaicing import mosaic

if TYPE_CHECKING:
    from napari_elsplus.processing.images.sectioning import Frames


def draw_finished(stack: Frames) -> Figure:
    """Return one frame of a finished stack, its mosaic, and the track of each segment.

    Parameters
    ----------
    stack : Frames
        (T, rows, cols) finished images.
    """
    made = mosaic(stack, finished=True, insertion="feathered")
    tracked = [row for row in made.track if row.state == TrackingState.TRACKED]
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    one, whole, path = figure.subplots(1, 3)
    frame = np.asarray(stack[tracked[len(tracked) // 2].frame if tracked else 0])
    one.imshow(frame, cmap="gray", vmax=np.percentile(frame, 99.5))
    one.set_title(f"one of {len(made.track)} frames")
    drawn = made.image[made.image > 0]
    whole.imshow(made.image, cmap="gray", vmin=0, vmax=np.percentile(drawn, 99.5) if drawn.size else 1)
    whole.set_title(f"mosaic of {len(tracked)}, {made.segments} segments")
    for axes in (one, whole):
        axes.set_axis_off()
    for segment in sorted({row.segment for row in tracked}):
        places = np.array([(row.col_px, row.row_px) for row in tracked if row.segment == segment])
        path.plot(*places.T, ".-", label=f"segment {segment}, {len(places)} frames")
    path.set(xlabel="column (px)", ylabel="row (px)", aspect="equal")
    path.invert_yaxis()
    path.legend(frameon=False)
    return figure
