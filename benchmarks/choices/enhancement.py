"""Resolution from motion: bars finer than the cores, from one frame and from several shifted ones.

The scene is a target of bars, known in closed form; what a method shows of it is read on the lines through the middles
of bars and gaps. A second scene, fibres, is enhanced from the even and from the odd frames separately: their Fourier
ring correlation, and what the scene does not explain, show how much of the structure is invented.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from benchmarks.harness.agreement import unexplained
from benchmarks.harness.methods import Benchmark, Case, Judgement, Method, Role, TimedElsewhere
from benchmarks.harness.peers import peer
from benchmarks.rigs.simulated import SimulatedRig, StopAndGo, measured, simulated_rig
from napari_elsplus.instrument.optics import CORE_PITCH_UM
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.pictures import Bars
from napari_elsplus.simulation.specimen.scenes import Plane, Scene, scene
from napari_elsplus.workflows.mosaicing import mosaic
from napari_elsplus.workflows.sectioning import finishing

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.simulation.specimen.textures import Texture

    Image = NDArray[np.float32]
    Frames = NDArray[np.uint8]

PERIODS: Final = tuple(2.6 / 1.06**step for step in range(26))
"""Line pairs of the target, core pitches, coarse to fine."""
BARS: Final = 5
_LENGTH_UM: Final = 24.0
_GAP_UM: Final = 9.0
_RESOLVED: Final = 0.1
"""Michelson contrast of resolved bars, as :data:`~napari_elsplus.processing.analysis.resolution.RESOLVED_CONTRAST`."""
_WANDER_UM: Final = 5.0
"""Standard deviation of the places at which the probe rests, along either axis."""
_SEARCH_UM: Final = 2.5
"""Distance over which a picture is brought onto the target, for methods that count their pixels from elsewhere."""
_COARSE: Final = 2.2
"""Line pairs, core pitches, of the bars that a picture is brought onto the target by."""
_FIELD_UM: Final = 320.0
_STEP_UM: Final = 0.5
_RING_WIDTH: Final = 4
"""Of a ring, in steps of the discrete frequencies."""
_RING: Final = 1 / 7
"""Fourier ring correlation at the resolution (Rosenthal and Henderson 2003)."""


class Group(NamedTuple):
    """Bars of one period; `upright` ones are a period apart along the columns. Edges of the first bar, um."""

    period_um: float
    top: float
    left: float
    upright: bool


class Picture(NamedTuple):
    """An image, and where it lies: micrometres per pixel, and scene coordinates (um) of its first pixel."""

    image: Image
    um_per_px: float
    top_um: float
    left_um: float


class Shifted(NamedTuple):
    """Shifted frames of a scene; `groups` are empty where the scene is a texture, judged by halves."""

    frames: Frames
    places_um: NDArray[np.float64]
    groups: tuple[Group, ...]
    texture: Texture


def target(periods: Sequence[float], half_um: float) -> tuple[Scene, tuple[Group, ...]]:
    """Return bars of periods (core pitches), each both ways, in the middle of the field."""
    groups: list[Group] = []
    left, top = -half_um, -0.85 * half_um
    for pitches in periods:
        period = pitches * CORE_PITCH_UM
        wide = (BARS - 0.5) * period
        if left + wide > half_um:
            left, top = -half_um, top + 2 * (_LENGTH_UM + _GAP_UM)
        groups += [Group(period, top, left, True), Group(period, top + _LENGTH_UM + _GAP_UM, left, False)]
        left += max(wide, _LENGTH_UM) + _GAP_UM
    bars = [bar for group in groups for bar in _bars(group)]
    return Scene((Plane(Bars(tuple(bars))),)), tuple(groups)


def _bars(group: Group) -> list[tuple[float, float, float, float]]:
    p, top, left = group.period_um, group.top, group.left
    if group.upright:
        return [(top, left + k * p, top + _LENGTH_UM, left + (k + 0.5) * p) for k in range(BARS)]
    return [(top + k * p, left, top + (k + 0.5) * p, left + _LENGTH_UM) for k in range(BARS)]


def shifted(rig: SimulatedRig, looked_at: Scene, groups: tuple[Group, ...], frames: int, seed: int) -> Shifted:
    """Record a scene from places at which the probe rests."""
    places = np.random.default_rng(seed).normal(0, _WANDER_UM, (frames, 2))
    path = StopAndGo(places, rig.instrument.optics.frame_period_s)
    raw = rig.recording(looked_at, path, frames, seed=seed)
    return Shifted(raw, places, groups, looked_at.planes[0].texture)


def _cases(quick: bool) -> list[Case]:
    if quick:
        small = measured(replace(Instrument.of("240hz"), bundle=Bundle(diameter_um=240.0)))
        return [_case(small, 4, 1, *target(PERIODS[::8], 70.0))]
    bars, groups = target(PERIODS, 170.0)
    fibres = scene("fibres", 5).in_focus()
    rigs = {preset: simulated_rig(preset) for preset in ("240hz", "120hz")}
    return [
        *(_case(rigs["240hz"], count, 2, bars, groups) for count in (4, 12, 30)),
        _case(rigs["120hz"], 30, 1, bars, groups),
        *(_case(rig, 30, 1, fibres, ()) for rig in rigs.values()),
    ]


def _case(rig: SimulatedRig, frames: int, items: int, looked_at: Scene, groups: tuple[Group, ...]) -> Case:
    name = f"{CORE_PITCH_UM / rig.um_per_px:.2g} px per core"
    shown = f"bars, {name}, {frames} frames" if groups else f"fibres, {name}, halves of {frames} frames"
    return Case(shown, [shifted(rig, looked_at, groups, frames, 700 + k) for k in range(items)], context=rig)


def judge(item: Shifted, answer: Sequence[Picture]) -> Judgement:
    """Finest resolved line pair, core pitches; or the resolution by Fourier ring correlation of two halves."""
    return _judge_bars(item, answer[0]) if item.groups else _judge_halves(item, answer)


def _judge_bars(item: Shifted, picture: Picture) -> Judgement:
    coarse = [group for group in item.groups if group.period_um > _COARSE * CORE_PITCH_UM]
    steps = np.arange(-_SEARCH_UM, _SEARCH_UM + 0.01, 0.25).tolist()
    best = max(
        ((down, across) for down in steps for across in steps),
        key=lambda offset: sum(contrast(picture, group, offset) for group in coarse),
    )
    pairs = list(zip(item.groups[::2], item.groups[1::2], strict=True))
    periods = np.array([upright.period_um for upright, _ in pairs]) / CORE_PITCH_UM
    contrasts = np.array([np.mean([contrast(picture, group, best) for group in pair]) for pair in pairs])
    unresolved = np.flatnonzero(contrasts < _RESOLVED)
    last = int(unresolved[0]) - 1 if unresolved.size else len(periods) - 1
    finest = periods[last] if last >= 0 else np.inf
    at = {pitches: float(np.interp(-pitches, -periods, contrasts)) for pitches in (1.0, 1.5)}
    return Judgement(float(finest), details={"contrast at 1 pitch": at[1.0], "contrast at 1.5 pitches": at[1.5]})


def _judge_halves(item: Shifted, answers: Sequence[Picture]) -> Judgement:
    """Compare two halves with each other and with the scene, on the field that both show."""
    axis = np.arange(-_FIELD_UM / 2, _FIELD_UM / 2, _STEP_UM)
    halves = [_resampled(picture, axis) for picture in answers]
    true = np.asarray(item.texture.sample(axis, axis), np.float32)
    frequency, ring = _ring_correlation(*halves)
    below = np.flatnonzero(ring < _RING)
    finest = 1 / frequency[below[0]] if below.size else 2 * _STEP_UM
    with_scene = _ring_correlation(0.5 * (halves[0] + halves[1]), true)[1]
    false = np.flatnonzero(with_scene < _RING)
    reached = 1 / frequency[false[0]] if false.size else 2 * _STEP_UM
    return Judgement(finest / CORE_PITCH_UM, details={
        "agrees with the scene to / pitches": reached / CORE_PITCH_UM,
        "unexplained by the scene": unexplained(0.5 * (halves[0] + halves[1]), true),
    })  # fmt: skip


def _resampled(picture: Picture, axis_um: NDArray[np.float64]) -> Image:
    rows, cols = ((axis_um - first) / picture.um_per_px for first in (picture.top_um, picture.left_um))
    grid_cols, grid_rows = np.meshgrid(cols.astype(np.float32), rows.astype(np.float32))
    return np.asarray(cv2.remap(picture.image, grid_cols, grid_rows, cv2.INTER_CUBIC), np.float32)


def _ring_correlation(one: Image, other: Image) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return spatial frequencies, cycles per um, and the correlation of two images on each ring."""
    side = len(one)
    window = np.outer(np.hanning(side), np.hanning(side))
    a, b = (np.fft.rfft2((image - image.mean()) * window) for image in (one, other))
    ring = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)) * side / _RING_WIDTH
    index = ring.astype(int).ravel()
    sums = [np.bincount(index, values.ravel()) for values in ((a * b.conj()).real, np.abs(a) ** 2, np.abs(b) ** 2)]
    count = side // 2 // _RING_WIDTH
    found = (sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-30)))[1:count]
    return np.asarray((np.arange(1, count) + 0.5) * _RING_WIDTH / (side * _STEP_UM)), np.asarray(found)


def contrast(picture: Picture, group: Group, offset_um: tuple[float, float] = (0.0, 0.0)) -> float:
    """Return the Michelson contrast on the lines through the middles of bars and gaps; 0 where it is dark."""
    across = group.period_um * (0.25 + 0.5 * np.arange(2 * BARS - 1))
    along = np.linspace(0.2, 0.8, 25) * _LENGTH_UM
    rows, cols = (along, across) if group.upright else (across, along)
    r = (group.top + rows + offset_um[0] - picture.top_um) / picture.um_per_px
    c = (group.left + cols + offset_um[1] - picture.left_um) / picture.um_per_px
    grid_c, grid_r = np.meshgrid(c.astype(np.float32), r.astype(np.float32))
    seen = cv2.remap(picture.image, grid_c, grid_r, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    line = seen.mean(axis=0 if group.upright else 1)
    bright, dark = float(line[::2].mean()), float(line[1::2].mean())
    return (bright - dark) / (bright + dark) if bright + dark > 0 else 0.0


def _whole_or_halves(
    enhance: Callable[[Frames, float, float], tuple[Picture, float | None]],
) -> Callable[[Shifted], TimedElsewhere | list[Picture]]:
    """Let a method make its picture of all frames, or of the even and of the odd ones."""

    def answer(item: Shifted) -> TimedElsewhere | list[Picture]:
        parts = [slice(None)] if item.groups else [slice(0, None, 2), slice(1, None, 2)]
        made = [enhance(item.frames[part], *item.places_um[part.start or 0]) for part in parts]
        seconds = [spent for _, spent in made if spent is not None]
        pictures = [picture for picture, _ in made]
        return TimedElsewhere(pictures, sum(seconds)) if seconds else pictures

    return answer


def _cores(case: Case) -> Callable[[Shifted], Any]:
    rig = case.context

    def enhance(frames: Frames, row_um: float, col_um: float) -> tuple[Picture, None]:
        made = mosaic(list(frames), rig.calibration, "ls", insertion="cores", threads=1)
        assert made.um_per_px is not None
        um, (row, col) = made.um_per_px, made.first_frame_px
        return Picture(made.image, um, row_um - row * um, col_um - col * um), None

    return _whole_or_halves(enhance)


def _single(cores: CoreFilter) -> Callable[[Case], Callable[[Shifted], Any]]:
    """Return the method that filters the first frame."""

    def prepare(case: Case) -> Callable[[Shifted], Any]:
        rig = case.context
        sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)
        finish = finishing(rig.calibration, sectioner, cores=cores)

        def enhance(frames: Frames, row_um: float, col_um: float) -> tuple[Picture, None]:
            um = rig.um_per_px
            top, left = (place - centre * um for place, centre in zip((row_um, col_um), sectioner.centre, strict=True))
            return Picture(finish(sectioner.ls(frames[0]).copy()), um, top, left), None

        return _whole_or_halves(enhance)

    return prepare


def _pyfibrebundle(case: Case) -> Callable[[Shifted], Any]:
    other, rig = peer("PyFibreBundle"), case.context
    sectioner = Sectioner(rig.calibration, rig.instrument.frame_shape)
    radius = int(rig.calibration.bundle.diameter_px / 2)

    def enhance(frames: Frames, row_um: float, col_um: float) -> tuple[Picture, float]:
        images = np.stack([sectioner.ls(frame).copy() for frame in frames])
        image, seconds = other(
            "enhance", flat=rig.calibration.flat, frames=images, pitch=CORE_PITCH_UM / rig.um_per_px, radius=radius
        )
        um = 2 * radius * rig.um_per_px / len(image)
        top, left = row_um - len(image) / 2 * um, col_um - len(image) / 2 * um
        return Picture(np.asarray(image, np.float32), um, top, left), seconds

    return _whole_or_halves(enhance)


METHODS = (
    Method("core by core", Role.OPTION, _cores),
    Method("one frame", Role.DEFAULT, _single(CoreFilter.NONE)),
    Method("one frame, median 3x3", Role.PAPER, _single(CoreFilter.MEDIAN)),
    Method("one frame, Gaussian", Role.OPTION, _single(CoreFilter.GAUSSIAN)),
    Method("one frame, interpolation", Role.OPTION, _single(CoreFilter.INTERPOLATE)),
    Method("PyFibreBundle, shifted frames", Role.PEER, _pyfibrebundle),
)

BENCHMARK = Benchmark(
    name="enhancement",
    question="How fine a picture several shifted frames give",
    error_label="finest resolved line pair / core pitches",
    cases=_cases,
    methods=METHODS,
    judge=judge,
    seconds=0.0,
    remarks=(
        "Time for all frames, tracking or shift estimation included; PyFibreBundle estimates the shifts itself. Bars "
        "count as resolved down to the first period whose contrast is below 10 %. In the cases of fibres the error is "
        "the resolution by Fourier ring correlation (1/7) between halves of the frames; a core pattern that stays in "
        "both correlates, too, which the agreement with the scene shows."
    ),
)
