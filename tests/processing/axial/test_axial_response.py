from __future__ import annotations

import json

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError, InputError, MeasurementError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.axial.axial_notes import axial_content, axial_notes, uncertainty_note
from napari_elsplus.processing.axial.axial_response import (
    MAX_CHANCE,
    SystematicUncertainty,
    axial_response,
)
from napari_elsplus.processing.axial.profiles import axial_profiles

DEPTH_UM = np.arange(0.0, 800.0, 2.0)


def curves(depth_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LS and residual with drop-offs that are known: LS 60 and 540 um, ELS+ 30 and 90 um, 80 % kept."""
    ls = 100 / (1 + depth_um / 60)
    return ls, ls - 80 / (1 + (depth_um / 30) ** 2)


def drops(response: object) -> list[float]:
    return [getattr(response, name).um for name in ("ls_3db", "ls_10db", "els_3db", "els_10db")]


def test_known_curves_give_their_drop_offs() -> None:
    response = axial_response(DEPTH_UM, *curves(DEPTH_UM))
    assert drops(response) == pytest.approx([60, 540, 30, 90], rel=1e-3)
    assert response.signal_kept == pytest.approx(0.8)
    assert response.els[0] == response.ls[0] == 1


def test_depths_in_any_order_from_any_start_repeated_and_uneven() -> None:
    rng = np.random.default_rng(0)
    depth = np.concatenate([np.arange(0, 100, 1.5), np.arange(100, 800, 7.0)])
    ls, residual = curves(depth)
    twice = rng.permutation(np.arange(2 * len(depth)) % len(depth))
    response = axial_response(depth[twice] - 333.0, ls[twice], residual[twice])
    assert response.contact_um == -333
    assert drops(response) == pytest.approx([60, 540, 30, 90], rel=5e-3)


@pytest.mark.parametrize("depth_um", [np.arange(3.0), np.concatenate([np.arange(8.0), np.arange(8.0)[::-1]])])
def test_a_signal_that_does_not_fall_is_kept_with_an_uncertainty(depth_um: np.ndarray) -> None:
    """Before: NaN, and an error in the panel, for the first frames of a manual scan, or a stage that stands still."""
    response = axial_response(depth_um, np.full(len(depth_um), 100.0), np.full(len(depth_um), 20.0))
    assert response.signal_kept == pytest.approx(0.8)
    assert np.isfinite(response.signal_kept_uncertainty)


def test_distances_count_from_contact_not_from_the_first_depth() -> None:
    """The probe starts pressed too hard against the plate: the signal first rises."""
    depth = np.arange(-40.0, 800.0, 2.0)
    ls, residual = curves(np.abs(depth) * np.where(depth < 0, 0.3, 1))
    response = axial_response(depth, ls, residual)
    assert response.contact_um == 0
    assert drops(response) == pytest.approx([60, 540, 30, 90], rel=5e-3)


def test_noise_widens_the_uncertainty_that_covers_the_error() -> None:
    rng = np.random.default_rng(1)
    clean = curves(DEPTH_UM)
    pulls = []
    for _ in range(40):
        ls, residual = (curve + rng.normal(0, 0.5, len(DEPTH_UM)) for curve in clean)
        response = axial_response(DEPTH_UM, ls, residual)
        assert drops(response) == pytest.approx([60, 540, 30, 90], rel=0.06)
        for name, truth in (("ls_3db", 60), ("ls_10db", 540), ("els_3db", 30), ("els_10db", 90)):
            drop = getattr(response, name)
            pulls.append((drop.um - truth) / drop.uncertainty_um)
    assert np.mean(np.abs(pulls) < 2) > 0.9


def test_a_zero_or_gain_that_errs_moves_the_distances_as_far_as_is_stated() -> None:
    """One standard deviation of each doubt, by hand, against the stated uncertainty; the curves have no noise."""
    ls, residual = curves(DEPTH_UM)
    exact = axial_response(DEPTH_UM, ls, residual)
    for doubts, moved in (
        (SystematicUncertainty(ls_zero_dn=0.2), axial_response(DEPTH_UM, ls + 0.2, residual)),
        (SystematicUncertainty(residual_zero_dn=0.2), axial_response(DEPTH_UM, ls, residual + 0.2)),
        (SystematicUncertainty(gain=0.01), axial_response(DEPTH_UM, ls, residual * 1.01)),
    ):
        stated = axial_response(DEPTH_UM, ls, residual, doubts)
        assert drops(stated) == drops(exact)
        for name in ("ls_3db", "ls_10db", "els_3db", "els_10db"):
            shift = abs(getattr(moved, name).um - getattr(exact, name).um)
            assert getattr(stated, name).uncertainty_um == pytest.approx(shift, rel=0.15, abs=0.02)
    assert stated.signal_kept_uncertainty == pytest.approx(0.002, rel=0.1)


def test_a_distance_beyond_the_scan_is_not_invented() -> None:
    near = DEPTH_UM[DEPTH_UM < 200]
    response = axial_response(near, *curves(near))
    assert np.isnan(response.ls_10db.um)
    assert response.els_10db.um == pytest.approx(90, rel=1e-2)
    assert json.loads(json.dumps(response.content(), allow_nan=False))["ls"]["drop_10db_um"] is None


@pytest.mark.parametrize(
    ("depth", "ls", "residual", "error", "word"),
    [
        (np.arange(5.0), np.arange(4.0), np.arange(4.0), InputError, "5 depths for 4 frames"),
        (np.zeros(9), np.arange(9.0), np.arange(9.0), InputError, "1 different depths"),
        (np.arange(9.0), np.full(9, np.nan), np.zeros(9), InputError, "NaN"),
        (np.arange(9.0), np.zeros(9), np.zeros(9), MeasurementError, "in contact is 0"),
        (np.arange(9.0), 9 - np.arange(9.0), 9 - np.arange(9.0), MeasurementError, r"ELS\+ in contact is 0"),
    ],
)
def test_what_cannot_be_measured_is_said(
    depth: np.ndarray, ls: np.ndarray, residual: np.ndarray, error: type[Exception], word: str
) -> None:
    with pytest.raises(error, match=word):
        axial_response(depth, ls, residual)


def test_a_square_larger_than_the_bundle_is_refused_and_the_scale_is_needed() -> None:
    record = {
        "bundle": {
            "confocal_centre": [100, 100],
            "residual_centre": [100, 300],
            "diameter_px": 150.0,
            "residual_to_confocal": [[1, 0, 0], [0, 1, -200]],
        },
        "optics": {"um_per_px": 2.0},
    }
    frames = np.zeros((4, 200, 400), np.uint8)
    with pytest.raises(MeasurementError, match="240 um does not fit into the bundle of 300 um"):
        axial_profiles(frames, Calibration.parse(record))
    with pytest.raises(CalibrationError, match="um_per_px"):
        axial_profiles(frames, Calibration.parse(record | {"optics": {"line_period_s": 1e-5}}))


def there_and_back() -> np.ndarray:
    depths = np.concatenate([np.arange(0, 40, 4), np.arange(40, 200, 10), np.arange(200, 720, 40)])
    return np.r_[depths, depths[::-1]]


def falling(depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ls, els = 100 / (1 + depths / 60), 100 / (1 + (depths / 30) ** 2)
    return ls, ls - els


def test_bleaching_is_made_up_for_in_a_scan_there_and_back() -> None:
    depths, random = there_and_back(), np.random.default_rng(7310)
    faded = 0.8 ** (np.arange(len(depths)) / (len(depths) - 1)) * random.normal(1, 0.002, len(depths))
    ls, residual = falling(depths)
    response = axial_response(depths, faded * ls, faded * residual)
    one_way = axial_response(*(each[: len(depths) // 2] for each in (depths, faded * ls, faded * residual)))
    assert response.loss is not None
    assert one_way.loss is None
    assert one_way.ls_10db.um < 500
    assert response.loss.significant
    assert response.loss.share == pytest.approx(0.2, abs=3 * response.loss.share_uncertainty)
    assert response.ls_10db.um == pytest.approx(540, rel=0.01)
    assert response.els_10db.um == pytest.approx(90, rel=0.01)


def test_power_noise_from_frame_to_frame_is_in_the_stated_distances() -> None:
    depths, random = there_and_back(), np.random.default_rng(7311)
    off, stated = [], []
    for _ in range(100):
        power = random.normal(1, 0.03, len(depths))
        response = axial_response(depths, *(power * each for each in falling(depths)))
        off.append(response.els_3db.um - 30)
        stated.append(response.els_3db.uncertainty_um)
    inside = [float(np.mean(np.abs(off) < sigmas * np.array(stated))) for sigmas in (1, 3)]
    assert 0.5 < inside[0] < 0.85
    assert inside[1] > 0.95


def test_many_frames_at_few_depths_are_known_by_their_own_scatter() -> None:
    """Depths lie so far apart that the curve bends more between them than it is uncertain."""
    depths, random = np.repeat(np.r_[np.arange(0.0, 60, 6), np.arange(60, 400, 20)], 12), np.random.default_rng(7313)
    ls, residual = falling(depths)
    found = []
    for _ in range(40):
        power = random.normal(1, 0.02, len(depths))
        found.append(axial_response(depths, power * ls, power * residual).els_3db)
    scatter = np.std([drop.um for drop in found])
    assert np.median([drop.uncertainty_um for drop in found]) == pytest.approx(scatter, rel=0.4)


def test_scans_that_are_repeated_are_not_stated_too_uncertain() -> None:
    """A distance lies between two depths, whose mean has less noise than either: 1.5 times the scatter was stated."""
    depths, random = np.tile(np.r_[np.arange(0.0, 40, 8), np.arange(40, 200, 10)], 12), np.random.default_rng(7315)
    ls, residual = falling(depths)
    found = []
    for _ in range(100):
        power = random.normal(1, 0.01, len(depths))
        uneven = power + random.normal(0, 0.02, len(depths))
        found.append(axial_response(depths, power * ls, uneven * residual).els_3db)
    scatter = np.std([drop.um for drop in found])
    assert 0.9 < np.median([drop.uncertainty_um for drop in found]) / scatter < 1.3


def test_more_frames_are_advised_where_power_noise_leaves_a_distance_uncertain() -> None:
    depths, random = there_and_back(), np.random.default_rng(7314)
    ls, residual = falling(depths)
    assert axial_response(depths, ls, residual).frames_advised == 1
    power = random.normal(1, 0.05, len(depths))
    response = axial_response(depths, power * ls, power * residual)
    shares = [drop.uncertainty_um / drop.um for drop in (response.els_3db, response.els_10db)]
    assert response.frames_advised == np.ceil((max(shares) / 0.005) ** 2) > 3
    gain = SystematicUncertainty(gain=0.02)  # more frames do not reduce it
    assert axial_response(depths, power * ls, power * residual, gain).frames_advised == response.frames_advised


def test_jitter_of_the_line_from_frame_to_frame_is_in_the_stated_distances() -> None:
    """Two frames at each depth: the light of the residual view scatters; 96 % were within three standard deviations."""
    depths, random = there_and_back(), np.random.default_rng(7312)
    off, stated = [], []
    for _ in range(200):
        ls, residual = falling(depths)
        response = axial_response(depths, ls, residual * random.normal(1, 0.03, len(depths)))
        off.append((response.els_3db.um - 30, response.els_10db.um - 90))
        stated.append((response.els_3db.uncertainty_um, response.els_10db.uncertainty_um))
    pulls = np.abs(off) / np.array(stated)
    assert np.all(np.mean(pulls < 3, axis=0) >= 0.98)
    assert np.all(np.mean(pulls < 1, axis=0) > 0.5)


def bleached(scans: int, lost: float, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scans in orders of their own of a plate that loses a share of its light in each, with noise of the camera."""
    random = np.random.default_rng(seed)
    depths = np.concatenate([random.permutation(there_and_back()) for _ in range(scans)])
    light = (1 - lost) ** (np.arange(len(depths)) * scans / len(depths))
    ls, residual = (signal * light + random.normal(0, noise, len(depths)) for signal in falling(depths))
    return depths, ls, residual


def test_further_scans_of_a_bleaching_plate_never_harm() -> None:
    """Made up for without weights, the noise of the last scans, with a fiftieth of the light, was amplified."""
    errors = {}
    for scans in (2, 10, 40):
        found = [axial_response(*bleached(scans, 0.1, 0.3, seed)).els_10db for seed in range(20)]
        truth = axial_response(*bleached(1, 0.0, 0.0, 0)).els_10db.um
        errors[scans] = np.sqrt(np.mean([(drop.um - truth) ** 2 for drop in found]))
        stated = np.sqrt(np.mean([drop.uncertainty_um**2 for drop in found]))
        assert stated == pytest.approx(errors[scans], rel=0.5)
    assert errors[40] < errors[10] < errors[2]


def test_a_bleaching_plate_is_to_be_scanned_as_often_as_that_helps() -> None:
    assert axial_response(*bleached(1, 0.0, 0.5, 3)).frames_advised > 40
    fading = axial_response(*bleached(1, 0.1, 0.5, 3))
    assert fading.loss is not None
    assert fading.loss.after_scan ** (2 * fading.frames_advised) == pytest.approx(0.1, rel=0.15)
    spent = axial_response(*bleached(fading.frames_advised, 0.1, 0.5, 3))
    assert (spent.frames_advised, spent.chance > MAX_CHANCE) == (1, True)
    assert "the plate has bleached" in uncertainty_note(axial_response(*bleached(40, 0.1, 0.8, 3)))


@pytest.mark.parametrize("lost", [0.0, 0.03, 0.1])
def test_the_uncertainties_contain_a_loss_that_a_few_repeated_frames_hardly_show(lost: float) -> None:
    """Of a scan out that returns to contact: a loss of 3 % is corrected in half of these, and was in none of them."""
    depths, random = there_and_back(), np.random.default_rng(7312)
    depths = np.r_[[0.0] * 3, depths[: len(depths) // 2], [0.0] * 3]
    pulls = []
    for _ in range(40):
        power = (1 - lost) ** (np.arange(len(depths)) / (len(depths) - 1)) * random.normal(1, 0.01, len(depths))
        found = axial_response(depths, *(power * each for each in falling(depths))).ls_10db
        pulls.append((found.um - 540) / found.uncertainty_um)
    assert np.mean(np.abs(pulls) > 2) < 0.1
    assert np.max(np.abs(pulls)) < 3.5


def test_what_unseen_bleaching_would_change_is_stated() -> None:
    depths = there_and_back()[: len(there_and_back()) // 2]
    faded = 0.9 ** (np.arange(len(depths)) / (len(depths) - 1))
    one_way = axial_response(depths, *(faded * each for each in falling(depths)))
    assert one_way.els_10db.um + one_way.unseen_um == pytest.approx(90, abs=0.1)
    assert one_way.unseen_um > 10 * one_way.els_10db.uncertainty_um
    assert f"ELS+ 10 dB lies {one_way.unseen_um:.1f} um farther" in axial_notes(one_way)[0]
    content = json.loads(json.dumps(axial_content(one_way)))  # of a file, from which nothing is printed
    assert content["light_lost"] is None
    assert (
        "bleaching and slow beats of the light are not seen, and the uncertainties do not contain them"
        in content["notes"][0]
    )
    returned = np.append(depths, depths[0])
    once = axial_response(returned, *falling(returned))
    assert "fewer than 4 frames repeat a depth" in axial_notes(once)[0]  # before: no depth was recorded again
    assert axial_response(there_and_back(), *falling(there_and_back())).unseen_um == 0


def test_contact_between_two_depths_is_in_the_stated_distances() -> None:
    """Distances counted from the brightest depth were 0.5 um too long, of which 0.01 um were stated."""
    z = []
    for start in np.linspace(-7, -4, 20):
        depth = np.arange(start, 90, 1.5)
        ls, els = 1 / (1 + np.abs(depth) / 20), 1 / (1 + np.square(depth / 7))
        response = axial_response(depth, ls, ls - els)
        z.append((response.els_3db.um - 7) / response.els_3db.uncertainty_um)
        assert response.content()["contact_uncertainty_um"] == pytest.approx(1.5 / 12**0.5)
    assert 0.5 < np.std(z) < 1.5
    assert np.abs(z).max() < 3
    from_contact = np.arange(0, 90, 1.5)
    ls, els = 1 / (1 + from_contact / 20), 1 / (1 + np.square(from_contact / 7))
    assert axial_response(from_contact, ls, ls - els).contact_uncertainty_um == 0
    assert "finer steps about it" in uncertainty_note(response)
