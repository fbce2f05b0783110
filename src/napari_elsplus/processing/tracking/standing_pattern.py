"""What stands still in the view, as dirt, its shadow or a reflection do, taken out of a finished recording's images.

The edge of a shadow has more contrast than smooth tissue, and holds the registration where it is. Over a recording in
which the probe moves the median of each pixel shows what stands still; where the probe rests it shows the tissue. Which
of the two it is follows from tracking the recording without it: what explains more of the frames is kept.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.registration.pair_registration import Registrar, TrackedPair
    from napari_elsplus.processing.tracking.tracker import Tracker

    Image = NDArray[np.float32]
    Images = Callable[[int], Image]
    Track = tuple[list[Pose], Tracker]

MAX_SAMPLES: Final = 64
"""Frames, spread evenly, from which what stands still is estimated; chosen."""
MIN_SAMPLES: Final = 8
"""Frames from which it is; chosen, a median of fewer contains the tissue."""
MIN_SHARE: Final = 0.03
"""Contrast of the pattern over that of the frames, variances at half resolution, from which the recording is tracked
without it; chosen: dust over a twentieth of rich tissue makes 0.04, of which removal lessens errors."""
FEWER_LINKS: Final = 0.5
"""Part of what tracking leaves unexplained that may be left without the pattern if fewer frames are linked; chosen:
around rings as bright as three times the tissue it is 0.16 to 0.29, where the probe hardly moves 0.57 and more."""
WITHOUT_PATTERN: Final = "Tracking again, without what stands still"
"""Name of the step in which a recording is tracked so."""


def evenly_spread(count: int) -> list[int]:
    """Return the indices of at most :data:`MAX_SAMPLES` of `count` frames, evenly spread."""
    return [int(index) for index in np.unique(np.linspace(0, count - 1, MAX_SAMPLES).astype(int))]


def tracked_without_pattern(
    poses: list[Pose], tracker: Tracker, image: Images, again: Callable[[Images], Track]
) -> tuple[list[Pose], Tracker, Images]:
    """Return the poses, tracker and images of a recording without what stands still, or those given if it is no better.

    Parameters
    ----------
    poses : list of Pose
        Of the recording as it is.
    tracker : Tracker
        That has estimated them.
    image : callable
        Returns the image (n, n) of a frame by its index.
    again : callable
        Tracks other images of all frames; returns their poses and tracker.
    """
    registrar, count = tracker.registrar, len(poses)
    without = without_standing_pattern(image, registrar, count)
    if without is not None:
        found, other = again(without)
        if stands_still((tracker.links, image), (other.links, without), registrar, count):
            return found, other, without
    return poses, tracker, image


def without_standing_pattern(image: Images, registrar: Registrar, count: int) -> Images | None:
    """Return a function that returns a frame's image without what stands still; None where little does.

    The pattern becomes brighter and darker with the frame, so that nothing is taken out of one without light.

    Parameters
    ----------
    image : callable
        Returns the image (n, n) of a frame by its index.
    registrar : Registrar
        Of these images.
    count : int
        Number of frames.
    """
    samples = [sample for sample in map(image, evenly_spread(count)) if sample.any()]
    if len(samples) < MIN_SAMPLES:
        return None
    lit = np.any(samples, axis=0)
    median = np.median(samples, axis=0)
    level = float(median[lit].mean())
    pattern = np.where(lit, median - level, 0).astype(np.float32)
    if contrast(registrar, pattern) < MIN_SHARE * np.mean([contrast(registrar, sample) for sample in samples]):
        return None

    def without(index: int) -> Image:
        """Return the image of a frame without the pattern."""
        frame = image(index)
        left: Image = frame - frame[lit].mean() / np.float32(level) * pattern
        return left

    return without


def contrast(registrar: Registrar, image: Image) -> float:
    """Return the variance of an image at half resolution, high-passed; in the mean over the square.

    Parameters
    ----------
    registrar : Registrar
        Of such images.
    image : numpy.ndarray
        (n, n) float32.
    """
    view = registrar.view()
    view.image[:] = image
    return float(np.square(registrar.prepare(view).levels[1]).mean())


def stands_still(
    track: tuple[Sequence[TrackedPair], Images], without: tuple[Sequence[TrackedPair], Images], registrar: Registrar,
    count: int,
) -> bool:  # fmt: skip
    """Return True if a track of images without the pattern leaves less of them unexplained; half if it has fewer links.

    Parameters
    ----------
    track, without : tuple
        Registrations of a track, and the images that were tracked: as they are, and without the pattern.
    registrar, count
        As of :func:`without_standing_pattern`.
    """
    left, as_they_are = (unexplained(*each, registrar, count) for each in (without, track))
    return left < (1.0 if len(without[0]) >= len(track[0]) else FEWER_LINKS) * as_they_are


def unexplained(links: Sequence[TrackedPair], image: Images, registrar: Registrar, count: int) -> float:
    """Return the mean squared difference of each frame from the one it is registered to, once that is warped.

    Of a frame that is not registered it is that of unrelated ones.

    Parameters
    ----------
    links : sequence of TrackedPair
        Registrations of a track, of which some are compared.
    image, registrar, count
        As of :func:`without_standing_pattern`.
    """
    chosen = links[:: -(-len(links) // MAX_SAMPLES) or 1]
    left = [(1 - link.registration.at_half) * contrast(registrar, image(link.later)) for link in chosen]
    lost = count - 1 - len(links)
    frames = evenly_spread(count) if lost > 0 else []
    unrelated = [contrast(registrar, image(frame)) for frame in frames]
    return 2 * sum(k * float(np.mean(each)) for k, each in ((len(links), left), (lost, unrelated)) if each) / count
