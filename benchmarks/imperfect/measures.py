"""Quality of images and of calibrations on an imperfect rig, judged by the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from napari_elsplus.processing.axial.axial_response import LEVEL_3DB, LEVEL_10DB, axial_response
from napari_elsplus.processing.axial.profiles import SQUARE_UM, AxialProfiles, axial_profiles
from napari_elsplus.processing.images.distortion import polynomial_terms
from napari_elsplus.processing.images.row_power import RowPower
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc
from napari_elsplus.simulation.axial_scan import lit_for_plate
from napari_elsplus.simulation.calibration_scenes import background
from napari_elsplus.simulation.model.bundle import Cores
from napari_elsplus.simulation.rendering.scan import LineScan
from napari_elsplus.simulation.rendering.views import views
from napari_elsplus.simulation.specimen.scenes import Plane, Scene, nuclei, plate, uniform
from napari_elsplus.simulation.specimen.textures import Mottle, Nuclei
from napari_elsplus.simulation.specimen.trajectories import trajectory
from napari_elsplus.workflows.axial import measure_axial_response
from napari_elsplus.workflows.tracking import Pipeline

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.imperfect.rig import ImperfectRig, Rows
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.axial.axial_response import AxialResponse
    from napari_elsplus.processing.calibration.draft import Draft
    from napari_elsplus.simulation.rendering.views import BundleView

JUDGED: Final = 0.9
"""Part of the bundle's diameter in which images and maps are judged, as the paper judges alignment."""
LIT_SIGMAS: Final = 3.0
"""Distance of the line from the bundle's rim, in standard deviations of its core over the slit, up to which it lights
cores; derived: 0.1 % of a Gaussian's light lies beyond."""
_THERE_UM: Final = np.r_[0.0, 8, np.arange(16.0, 64, 4), np.arange(68.0, 184, 8), np.arange(220.0, 720, 40)]
_CONTACT_FRAMES: Final = 6
"""Frames in contact beyond the two; chosen: all of a curve is divided by its value there."""
_SCAN_UM: Final = np.r_[_THERE_UM, _THERE_UM, np.zeros(_CONTACT_FRAMES)]
DEPTHS_UM: Final = np.asarray(np.random.default_rng(0).permutation(_SCAN_UM), np.float64)
"""Depths of a scan, um; chosen: a third of those of a whole scan, each twice, in a random order. Power that changes
slowly then differs from one depth to the next, and is seen as noise; in order it would bend the curve."""

MAX_SCANS: Final = 64
"""Scans that are recorded at most, however many are advised; chosen: the fastest bleaching leaves hardly any
light of the specimen then."""
_OWN_DEPTHS_UM: Final = np.array([0.0, 28, 36, 44, 104, 120, 136])
"""Depths, um, between which the distances of a rig itself are interpolated; chosen: about those of the ideal rig."""
_FLAT_FRAMES: Final = 10
"""Frames of an even target for a flat field; chosen: the step takes 50, of which the noise of 10 is twice that."""
_NEAR_UM: Final = 60.0
"""Distance from the middle of the bundle, um, within which a parabola describes any distortion; chosen."""


def hazy_nuclei(seed: int) -> Scene:
    """Return dim nuclei under mottle at 150 um that is ten times brighter."""
    return Scene((Plane(Nuclei(seed=seed), 0.0, 0.2), Plane(Mottle(seed=seed), 150.0, 2.0)))


class Sectioning(NamedTuple):
    """Correlation with the focal plane: of LS, and of ELS+."""

    ls: float
    els: float


def sectioning(
    rig: ImperfectRig,
    calibration: Calibration,
    scene: Scene,
    *,
    seed: int = 0,
    row_corrections: bool = True,
) -> Sectioning:
    """Correlate LS and ELS+ of one frame with the focal plane alone, as the same view shows it without noise."""
    renderer = rig.renderer(scene, seed=seed)
    section = Sectioner(calibration, rig.instrument.frame_shape, row_reference=row_corrections)
    bare = Sectioner(calibration.model_copy(update={"background": None}), rig.instrument.frame_shape)
    wanted = bare.ls(renderer.in_focus().render(0)).copy()
    raw = renderer.render(0)
    if row_corrections:
        power = RowPower(section, calibration)
        found = [power.image(raw, mode) for mode in (Mode.LS, Mode.ELS)]
    else:
        found = [image(raw).copy() for image in (section.ls, section.els)]
    judged = disc(section.side, JUDGED * section.diameter_px)
    return Sectioning(*(_correlation(image[judged], wanted[judged]) for image in found))


def _correlation(one: np.ndarray, two: np.ndarray) -> float:
    both = np.isfinite(one) & np.isfinite(two)
    return float(np.corrcoef(one[both], two[both])[0, 1])


def flat_fielded(
    rig: ImperfectRig, straight: ImperfectRig, calibration: Calibration, scene: Scene, line_rows: Rows, *, seed: int = 0
) -> float:
    """Correlate flat-fielded ELS+ of one scanned frame with the focal plane of the rig without imperfections.

    Both are divided by the mean of scans of an even target, as the calibration's step of the flat field takes them.
    """
    section = Sectioner(calibration, rig.instrument.frame_shape)
    bare = Sectioner(calibration.model_copy(update={"background": None}), rig.instrument.frame_shape)
    even, ideal = rig.renderer(uniform(), seed=seed + 1), straight.renderer(uniform(), seed=seed + 1)
    flat = np.mean([section.ls(even.render(k, line_rows=line_rows)).copy() for k in range(_FLAT_FRAMES)], axis=0)
    wanted_flat = np.mean([section.ls(ideal.render(k)).copy() for k in range(_FLAT_FRAMES)], axis=0)
    wanted = bare.ls(straight.renderer(scene, seed=seed).in_focus().render(0)).copy()
    found = section.els(rig.renderer(scene, seed=seed).render(0, line_rows=line_rows)).copy()
    judged = disc(section.side, JUDGED * section.diameter_px)
    return _correlation(found[judged] / flat[judged], wanted[judged] / wanted_flat[judged])


class Misalignment(NamedTuple):
    """Left-over of the view alignment over all cores, px RMS, and the standard deviation that is stated for it."""

    left_over_px: float
    stated_px: float


def misalignment(rig: ImperfectRig, calibration: Calibration) -> Misalignment:
    """Compare where the calibration expects each core in the residual view with where it is."""
    bundle = calibration.measured_bundle
    known, left, right = views(rig.instrument)
    judged = np.hypot(known.rows_um, known.cols_um) < JUDGED * rig.instrument.bundle.radius_um
    on_left = np.stack([left.rows_px, left.cols_px])[:, judged]
    off = _in_residual(calibration, on_left) - np.stack([right.rows_px, right.cols_px])[:, judged]
    return Misalignment(float(np.sqrt((off**2).sum(0).mean())), bundle.alignment_uncertainty_px or 0.0)


def _in_residual(calibration: Calibration, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows and columns (2, places) at which a calibration has places of the confocal in the residual view."""
    bundle = calibration.measured_bundle
    affine = np.array(bundle.residual_to_confocal)
    expected = np.linalg.solve(affine[:, :2], places - affine[:, 2:])
    if calibration.distortion is not None:
        place = (places - np.reshape(bundle.confocal_centre, (2, 1))) / (bundle.diameter_px / 2)
        expected = expected + calibration.distortion @ polynomial_terms(*place)
    return np.asarray(expected, np.float64)


class Error(NamedTuple):
    """Error of a measured number, and the standard deviation that is stated for it."""

    off: float
    stated: float


def offset_error(rig: ImperfectRig, calibration: Calibration) -> Error:
    """Error of the slit offset, rows, at the calibration's own confocal centre, and where the residual view shows it.

    A lens that distorts displaces the middle of a view from its central core, along a line that need not lie level.
    """
    offset, bundle = calibration.offset, calibration.bundle
    assert offset is not None
    columns: tuple[float | None, float | None] = (None, None)
    if bundle is not None:
        shown = _in_residual(calibration, np.reshape(bundle.confocal_centre, (2, 1)))
        columns = bundle.confocal_centre[1], float(shown[1, 0])
    return Error(offset.rows - true_offset_rows(rig, columns), offset.uncertainty_rows)


def true_offset_rows(rig: ImperfectRig, columns: tuple[float | None, float | None] = (None, None)) -> float:
    """Return the slit offset, rows, from where the views show the cores on a line through the middle of the bundle.

    Parameters
    ----------
    rig : ImperfectRig
        The instrument.
    columns : tuple of float, optional
        Column of the camera at which each view is looked at, by default where it shows the bundle's central core.
    """
    shown = views(rig.instrument)
    instrument = rig.instrument
    volts = instrument.volts_at_row_zero + instrument.volts_per_row * instrument.confocal_centre[0]
    left, right = (
        _shown_row(rig, view, volts, column) for view, column in zip((shown.left, shown.right), columns, strict=True)
    )
    return right - left


def _shown_row(rig: ImperfectRig, view: BundleView, volts: float, column: float | None = None) -> float:
    """Return the row on which a view shows the line, at a column of the camera or that of the view's centre.

    A lens that distorts displaces the whole view, its centre as well.
    """
    instrument = rig.instrument
    um_per_px, radius_um = instrument.optics.um_per_px, instrument.bundle.radius_um
    cores = views(instrument).cores
    near = np.hypot(cores.rows_um, cores.cols_um) < _NEAR_UM
    terms = _quadratic(cores.rows_um[near], cores.cols_um[near])
    to_row, to_col = (np.linalg.lstsq(terms, axis[near], rcond=None)[0] for axis in (view.rows_px, view.cols_px))
    line_row = float(instrument.line_row(volts))
    across = np.linspace(-50.0, 50.0, 2001)  # um
    tilt, bow = np.tan(np.deg2rad(instrument.line_tilt_deg)), instrument.imperfections.line_bow_rows * um_per_px
    line = (line_row - instrument.confocal_centre[0]) * um_per_px + tilt * across + bow * (across / radius_um) ** 2
    seen = _quadratic(line, across)
    return float(np.interp(to_col[0] if column is None else column, seen @ to_col, seen @ to_row))


def _quadratic(rows: Rows, cols: Rows) -> Rows:
    return np.stack([np.ones_like(rows), rows, cols, rows**2, cols**2, rows * cols], axis=1)


def gain_error(rig: ImperfectRig, calibration: Calibration) -> Error:
    """Error of the residual view's gain in fluorescence, over the cores of the part of the bundle that is judged."""
    bundle = calibration.bundle
    assert bundle is not None
    return Error(bundle.residual_gain - true_gain(rig), bundle.residual_gain_uncertainty)


def true_gain(rig: ImperfectRig) -> float:
    """Return the brightness of the residual view over the confocal, pixel by pixel, from the gains of the cores.

    A view that is distorted shows its cores closer together in some parts, and brighter, than in others.
    """
    known, left, right = views(rig.instrument)
    judged = np.hypot(known.rows_um, known.cols_um) < JUDGED * rig.instrument.bundle.radius_um
    places_um = known.rows_um[judged], known.cols_um[judged]
    areas = _areas_px(left, *places_um, judged) / _areas_px(right, *places_um, judged)
    light, other = ((known.transmission * view.gain * _drawn(view, len(judged)))[judged] for view in (left, right))
    return float((other * areas).sum() / light.sum())


def _drawn(view: BundleView, cores: int) -> Rows:
    """Return the light that the pixels of a view take from each core: where cores are dense, less of what it gives."""
    weights = np.bincount(view.spots.cores.ravel(), weights=view.spots.weights.ravel(), minlength=cores)
    return np.asarray(view.spots.scale * weights, np.float64)


def _areas_px(view: BundleView, rows_um: Rows, cols_um: Rows, judged: np.ndarray) -> Rows:
    """Return the area of a view, px, that a square micrometre of the bundle takes at each of the judged cores."""
    terms = polynomial_terms(rows_um, cols_um)
    slopes = [polynomial_terms(rows_um + down, cols_um + across) - terms for down, across in ((1, 0), (0, 1))]
    places = np.stack([view.rows_px, view.cols_px], axis=1)[judged]
    scale = np.abs(terms).max(axis=1)
    to_place = np.linalg.lstsq((terms / scale[:, None]).T, places, rcond=None)[0] / scale[:, None]
    by_row, by_col = (slope.T @ to_place for slope in slopes)
    return np.asarray(np.abs(by_row[:, 0] * by_col[:, 1] - by_row[:, 1] * by_col[:, 0]), np.float64)


def galvo_error(rig: ImperfectRig, draft: Draft) -> Error:
    """Error of the galvo map, rows, at the middle of the bundle, about which the sweep is symmetrical.

    True is the row on which the left view shows the line at the column of the map.
    """
    galvo, instrument = draft.calibration.galvo, rig.instrument
    assert galvo is not None
    assert draft.galvo is not None
    volts = float(galvo.volts(instrument.confocal_centre[0]))
    shown_row = _shown_row(rig, views(instrument).left, volts, draft.galvo.column)
    return Error(instrument.confocal_centre[0] - shown_row, draft.galvo.middle_uncertainty_rows)


def bow_error(rig: ImperfectRig, calibration: Calibration) -> Error:
    """Error of the line's bow, rows at the bundle's rim."""
    galvo = calibration.galvo
    assert galvo is not None
    found = galvo.bow_rows or 0.0  # not significant
    return Error(found - rig.instrument.imperfections.line_bow_rows, galvo.bow_uncertainty_rows or 0.0)


class Scanned(NamedTuple):
    """Line against slit while it lights cores: rows off by more than a quarter slit, signal kept."""

    off: int
    signal: float


def scanned(rig: ImperfectRig, line_rows: Rows) -> Scanned:
    """Judge line positions on the rows of a view in which the line lights cores, or should.

    Both views see a row by the light that enters the bundle while it is exposed: where the slit of the residual view is
    on the bundle and the line is not, neither view shows anything. The signal is that of an in-focus plane in the
    confocal view.
    """
    instrument = rig.instrument
    radius, rows = instrument.diameter_px / 2, np.arange(len(line_rows))
    centres = instrument.confocal_centre[0], instrument.residual_centre[0]
    sigma_rows = instrument.optics.rows(np.hypot(instrument.line.core_um, instrument.slit_um / np.sqrt(12)))
    away = np.minimum(np.abs(rows - centres[0]), np.abs(line_rows - centres[0])) - radius
    exposed = (rows > min(centres) - radius) & (rows < max(centres) + radius)
    judged = exposed & (away < LIT_SIGMAS * sigma_rows)
    error = np.abs(line_rows - rows)
    on_left = np.abs(rows - centres[0]) < radius
    kept = np.exp(-0.5 * (error[on_left] / sigma_rows) ** 2)
    chord = np.sqrt(radius**2 - (rows[on_left] - centres[0]) ** 2)
    off = int((error[judged] > instrument.slit_rows / 4).sum())
    return Scanned(off, float((kept * chord).sum() / chord.sum()))


def axial(rig: ImperfectRig, calibration: Calibration, *, seed: int = 0) -> AxialResponse:
    """Measure the axial response in a scan of depths; the background is taken in the light of the scan."""
    scan = rig.axial_scan(DEPTHS_UM, seed=seed)
    dark = calibration.model_copy(update={"background": background(lit_for_plate(rig.instrument), seed=seed + 1)})
    return measure_axial_response(list(scan), dark, DEPTHS_UM)  # each frame rendered once


def axial_as_advised(rig: ImperfectRig, calibration: Calibration, line_rows: Rows, *, seed: int = 0) -> AxialResponse:
    """Measure the axial response of a rig's scan, recorded again as often as the uncertainty so far advises."""
    count, parts = len(DEPTHS_UM), list[AxialProfiles]()
    # In one order, a ripple of the power could have the same phase at a depth in all scans.
    depths_um = np.random.default_rng(seed).permuted(np.tile(DEPTHS_UM, (MAX_SCANS, 1)), axis=1).ravel()
    scan = rig.axial_scan(depths_um, seed=seed, line_rows=line_rows)
    dark = calibration.model_copy(update={"background": background(lit_for_plate(rig.instrument), seed=seed + 1)})
    wanted = 1
    while len(parts) < wanted:
        for number in range(len(parts), wanted):
            parts.append(axial_profiles([scan[k] for k in range(number * count, (number + 1) * count)], dark))
        ls, residual = (np.concatenate([getattr(part, name) for part in parts]) for name in ("ls", "residual"))
        response = axial_response(depths_um[: len(ls)], ls, residual, parts[0].systematic)
        wanted = min(wanted * response.frames_advised, MAX_SCANS)
    return response


def own_distances_um(rig: ImperfectRig, line_rows: Rows) -> tuple[float, float]:
    """Return the 3 dB and 10 dB distances of ELS+ of a rig itself: with its halo, bow and scan, without any noise.

    The difference of the light on the cores of both views, without gains and the bundle's own light; jitter of the line
    counts by its mean effect.
    """
    instrument = lit_for_plate(rig.instrument)
    known, left, right = views(instrument)
    inside = np.maximum(np.abs(known.rows_um), np.abs(known.cols_um)) < SQUARE_UM / 2
    cores = Cores(*(values[inside] for values in known))
    seen = [
        view._replace(gain=1.0, rows_px=view.rows_px[inside], cols_px=view.cols_px[inside]) for view in (left, right)
    ]
    jitter_rows = instrument.imperfections.line_jitter_rows

    def els(depth_um: float) -> float:
        scan = LineScan(instrument, plate(depth_um + instrument.line.gap_um), cores)
        lights = [[scan.light(view, line_rows + side * jitter_rows) for view in seen] for side in (-1, 1)]
        ls, residual = (sum(float((one[k].steady - one[k].of_bundle).sum()) for one in lights) for k in (0, 1))
        return ls - residual

    shares = np.log([els(float(depth)) for depth in _OWN_DEPTHS_UM])
    fall = PchipInterpolator(shares[0] - shares, _OWN_DEPTHS_UM)
    return float(fall(-np.log(LEVEL_3DB))), float(fall(-np.log(LEVEL_10DB)))


class Tracked(NamedTuple):
    """Share of frames that were tracked in the first segment, and the RMS error of their positions, camera pixels."""

    share: float
    rms_px: float


def tracked(rig: ImperfectRig, calibration: Calibration, frames: int, *, seed: int = 0) -> Tracked:
    """Track a probe moved by hand over nuclei, and compare with its path."""
    path, optics = trajectory("hand", speed_um_s=2000.0, seed=seed), rig.instrument.optics
    renderer = rig.renderer(nuclei(seed), path, seed=seed)
    pipeline = Pipeline(calibration, rig.instrument.frame_shape)
    for k in range(frames):
        pipeline.track(renderer.render(k), frame=k, time_s=k * optics.frame_period_s)
    rows = [row for row in pipeline.rows if row.segment == pipeline.rows[0].segment and np.isfinite(row.row_px)]
    middle = rig.instrument.confocal_centre[0] / optics.line_periods_per_frame
    times_s = (np.array([row.frame for row in rows]) + middle) * optics.frame_period_s
    truth = path.positions_um(times_s) / optics.um_per_px
    found = np.array([(row.row_px, row.col_px) for row in rows])
    off = found - truth
    return Tracked(len(rows) / frames, float(np.sqrt(((off - off.mean(0)) ** 2).sum(1).mean())))
