from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from napari_elsplus.acquisition.engine.live_images import ROW_TEST_INTERVAL_FRAMES, LiveImages, LiveView, focus
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.fused import FusedSections
from napari_elsplus.processing.images.sectioning import Mode, disc
from napari_elsplus.workflows.sectioning import section

SHAPE = (100, 200)
CALIBRATION = Calibration.parse(
    {
        "bundle": {
            "confocal_centre": [50.5, 50.5],  # of 82 pixels, so that the grid is the camera's
            "residual_centre": [50.2, 150.4],
            "diameter_px": 80,
            "residual_to_confocal": [[1, 0, 0.3], [0, 1, -99.9]],
        }
    }
).model_copy(update={"background": np.full(SHAPE, 7, np.float32)})


def noise(count: int) -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(0, 200, (count, *SHAPE)).astype(np.uint8)


def slot_of(live: LiveImages) -> dict[str, NDArray[np.generic]]:
    return {name: np.empty(shape, dtype) for name, shape, dtype in live.layout.fields}


def test_the_confocal_view_is_the_camera_s_where_the_bundle_s_centre_lies_between_pixels() -> None:
    bundle = CALIBRATION.bundle
    assert bundle is not None
    moved = {"confocal_centre": (50.2, 50.7)}
    calibration = CALIBRATION.model_copy(update={"bundle": bundle.model_copy(update=moved)})
    raw = noise(1)
    live = LiveImages(SHAPE, calibration, LiveView())
    slot = slot_of(live)
    live.add(raw[0], 0)
    live.fill(raw[0], slot)
    inside = disc(82, 82)
    np.testing.assert_array_equal(slot["ls"][inside], raw[0][10:92, 10:92][inside] - np.float32(7))
    np.testing.assert_array_equal(slot["els"], slot["ls"] - slot["residual"])
    np.testing.assert_allclose(slot["residual"], section(raw, CALIBRATION, "residual")[0], atol=1e-3)


@pytest.mark.parametrize("average", [1, 3])
@pytest.mark.parametrize("names", ["", "els", "ls", "elsa", "residual elsa"])
def test_only_the_images_that_are_wanted_are_made(names: str, average: int) -> None:
    raw = noise(4)
    every = LiveImages(SHAPE, CALIBRATION, LiveView(average=average))
    some = LiveImages(SHAPE, CALIBRATION, LiveView(average=average, modes=frozenset(map(Mode, names.split()))))
    slots = slot_of(every), slot_of(some)
    assert set(slots[1]) == {"raw", *names.split()}
    for number in (0, 1, 2, 3):
        for live, slot in zip((every, some), slots, strict=True):
            live.add(raw[number], number)
            measured = live.fill(raw[number], slot)
    for name in slots[1]:
        np.testing.assert_array_equal(slots[1][name], slots[0][name])
    assert np.isnan(measured.focus) == ("els" not in names.split())


@pytest.mark.parametrize("cores", [CoreFilter.NONE, CoreFilter.MEDIAN])
@pytest.mark.parametrize("mode", ["ls", "residual", "els", "elsa"])
def test_live_images_are_those_of_the_pipeline(mode: str, cores: CoreFilter) -> None:
    raw = noise(2)
    live = LiveImages(SHAPE, CALIBRATION, LiveView(cores=cores))
    slot = slot_of(live)
    for number in range(2):
        live.add(raw[number], number)
    live.fill(raw[1], slot)
    expected = section(raw, CALIBRATION, mode, cores=cores)[-1]
    np.testing.assert_array_equal(slot[mode], expected)


@pytest.mark.parametrize("row_reference", [True, False])
@pytest.mark.parametrize("row_noise_dn", [0, 6])
def test_live_images_lose_their_row_noise_as_recordings_do(row_noise_dn: int, row_reference: bool) -> None:
    random = np.random.default_rng(4)
    rows = random.normal(0, row_noise_dn, (100, 1))
    raw = np.clip(30 + rows + random.normal(0, 1, SHAPE), 0, 255).astype(np.uint8)[None]
    live = LiveImages(SHAPE, CALIBRATION, LiveView(row_reference=row_reference))
    slot = slot_of(live)
    live.add(raw[0], 0)
    live.fill(raw[0], slot)
    np.testing.assert_array_equal(slot["ls"], section(raw, CALIBRATION, "ls", row_reference=row_reference)[0])
    along_rows = np.asarray(slot["ls"][21:61, 21:61]).mean(axis=1).std()
    assert (along_rows > 3) == (row_noise_dn > 0 and not row_reference)


def test_row_noise_that_begins_while_frames_stream_is_taken_off_after_the_next_test() -> None:
    random = np.random.default_rng(5)
    live = LiveImages(SHAPE, CALIBRATION, LiveView())
    slot = slot_of(live)
    spread = []
    for number in range(ROW_TEST_INTERVAL_FRAMES + 1):
        rows = random.normal(0, 6 if number else 0, (100, 1))
        raw = np.clip(30 + rows + random.normal(0, 1, SHAPE), 0, 255).astype(np.uint8)
        live.add(raw, number)
        live.fill(raw, slot)
        spread.append(np.asarray(slot["ls"][21:61, 21:61]).mean(axis=1).std())
    assert spread[0] < 1
    assert min(spread[1:-1]) > 3
    assert spread[-1] < 3


def test_kernels_for_frames_with_row_noise_are_compiled_before_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds, called = [], FusedSections.__call__

    def watched(fused: FusedSections, raw: NDArray[np.generic], *rest: object) -> None:
        kinds.append(raw.dtype)
        called(fused, raw, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(FusedSections, "__call__", watched)
    LiveImages(SHAPE, CALIBRATION, LiveView())
    assert set(kinds) == {np.dtype(np.uint8), np.dtype(np.float32)}


def test_elsa_keeps_its_parity_across_missing_frames() -> None:
    raw = noise(6)
    live = LiveImages(SHAPE, CALIBRATION, LiveView())
    slot = slot_of(live)
    for number in (0, 1, 3, 4):  # frame 2 is missing: 3 has no partner, and 4 waits for 5
        live.add(raw[number], number)
    live.fill(raw[4], slot)
    np.testing.assert_array_equal(slot["elsa"], section(raw[:2], CALIBRATION, "elsa")[0])
    live.add(raw[5], 5)
    live.fill(raw[5], slot)
    np.testing.assert_array_equal(slot["elsa"], section(raw[4:], CALIBRATION, "elsa")[0])


def test_averaging_lowers_the_noise_as_it_says() -> None:
    raw = noise(80)
    live = LiveImages(SHAPE, CALIBRATION, LiveView(average=4))
    slot = slot_of(live)
    for number, frame in enumerate(raw):
        live.add(frame, number)
    live.fill(raw[-1], slot)
    inner = (slice(20, 60), slice(20, 60))
    ratio = slot["els"][inner].std() / section(raw[-1:], CALIBRATION, "els")[0][inner].std()
    assert ratio == pytest.approx((1 / 7) ** 0.5, rel=0.1)  # recursive: variance w / (2 - w) with w = 1/4


def test_the_background_can_be_left_in() -> None:
    raw = noise(1)
    live = LiveImages(SHAPE, CALIBRATION, LiveView(background=False))
    slot = slot_of(live)
    live.add(raw[0], 0)
    live.fill(raw[0], slot)
    with_background = section(raw, CALIBRATION, "ls")[0]
    assert (slot["ls"] - with_background)[40, 40] == pytest.approx(7, abs=0.01)


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65520)])
def test_saturation_is_the_share_of_white_pixels(dtype: type[np.unsignedinteger], white: int) -> None:
    """Of a camera of 8 bits, and of one of 12, whose levels may be shifted to the left; 255 is one of its greys."""
    raw = np.random.default_rng(4).integers(0, white - 1, SHAPE).astype(dtype)
    raw[30] = 255 * (white > 255)
    raw[:25] = white
    live = LiveImages(SHAPE, None, LiveView())
    slot = {"raw": np.empty(SHAPE, dtype)}
    assert live.fill(raw, slot).saturated == pytest.approx(0.25, abs=0.04)


def test_focus_falls_with_blur_and_ignores_brightness() -> None:
    sharp = np.random.default_rng(2).uniform(50, 100, (80, 80)).astype(np.float32)
    blurred = (sharp + np.roll(sharp, 1, 0) + np.roll(sharp, 1, 1) + np.roll(sharp, (1, 1), (0, 1))) / 4
    assert focus(blurred) < 0.5 * focus(sharp)
    assert focus(3 * sharp) == pytest.approx(focus(sharp), rel=1e-4)
    assert np.isnan(focus(0 * sharp))


def test_averaging_over_no_frames_is_refused() -> None:
    with pytest.raises(InputError, match="0 frames"):
        LiveView(average=0)
