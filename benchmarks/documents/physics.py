"""Charts and tables of docs/physics.md: ``python3 run.py bench docs --only physics``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmarks.documents import physics_charts as charts
from benchmarks.documents.pages import fill, require_marks
from benchmarks.rigs.clipped_response import clipped_drop_offs
from benchmarks.studies import printed
from benchmarks.studies.sectioning import mean_residual, measure_axial, weigh_offset
from napari_elsplus.processing.analysis.slit_offset import fit_saturation
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, model_drop_offs
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.workflows.pictures.axial import draw_axial_response
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.processing.axial.axial_response import AxialResponse

SLITS_UM: Final = (1.9, 2.9, 5.8)
SHARP_SLITS_UM: Final = (2.9, 5.8, 8.8)
SEEDS: Final = 10
WEIGHED_UM: Final = (3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 25.0, 29.0, 35.0, 40.0, 50.0, 58.0, 67.0, 77.0, 90.0)
STRIPS_UM: Final = ((-295.0, -260.0), (-285.0, -275.0), (260.0, 295.0))
EDGE_UM: Final = (-74.0, -12.0)
TABLES: Final = ("offsets", "small-offsets", "slits", "seeds", "instruments", "edge")


def make(docs: Path, *, quick: bool = False) -> None:
    """Measure, draw and tabulate everything in docs/physics.md.

    Parameters
    ----------
    docs : pathlib.Path
        Folder of ``physics.md``; charts go into its folder ``images``.
    quick : bool
        Two seeds and three offsets: a check that it runs.

    Raises
    ------
    InputError
        If there is no ``physics.md`` in it, or a table's place is missing there.
    """
    page = docs / "physics.md"
    require_marks(page, TABLES)
    by_offset = {offset: measure_axial(_instrument(offset)) for offset in printed.OFFSETS_UM}
    small = {offset: measure_axial(_instrument(offset)) for offset in printed.SMALL_OFFSETS_UM}
    by_slit = {slit: measure_axial(_instrument(29.0, slit)) for slit in SLITS_UM}
    sharp = {slit: measure_axial(_instrument(77.0, slit, "b")) for slit in SHARP_SLITS_UM}
    by_seed = [measure_axial(_instrument(29.0), seed=seed) for seed in range(2 if quick else SEEDS)]
    residuals = {offset: mean_residual(offset) for offset in EDGE_UM}
    trades = {offset: weigh_offset(offset) for offset in (WEIGHED_UM[1::5] if quick else WEIGHED_UM)}
    figures = {
        "axial": draw_axial_response(by_offset[29.0]),
        "offset": charts.drop_off_against_offset(by_offset),
        "slit": charts.drop_off_against_slit(sharp),
        "kept": charts.kept_signal(by_offset, sharp),
        "choice": charts.the_choice(trades),
        "edge": charts.edge_artefacts(residuals, _instrument(74.0).optics.um_per_px),
    }
    for name, figure in figures.items():
        save_figure(figure, docs / "images" / f"physics-{name}.png", force=True)
    tables = {
        "offsets": _offset_table(by_offset),
        "small-offsets": _small_offset_table(small),
        "slits": _slit_table(by_slit),
        "seeds": _seed_table(by_seed),
        "instruments": _instrument_table(),
        "edge": _edge_table(residuals),
    }
    fill(page, {name: "\n".join(table) for name, table in tables.items()})


def _instrument(offset_um: float, slit_um: float = 2.9, state: str = "a") -> Instrument:
    return Instrument.of("120hz", slit_um=slit_um, offset_um=offset_um, line=LINE_MODELS[state])


def _offset_table(measured: dict[float, AxialResponse]) -> list[str]:
    ls, closed_ls = measured[29.0], model_drop_offs(offset_um=None)
    clipped_ls, _ = clipped_drop_offs(_instrument(29.0))
    rows = [
        "| 3 dB / 10 dB (um) | paper | closed form | with the rim | raw frames | raw frames off the paper |",
        "|---|---|---|---|---|---|",
        f"| LS | {' / '.join(f'{um:.0f} +- {spread:.0f}' for um, spread in printed.LS_UM.values())} "
        f"| {closed_ls.drop_3db_um:.1f} / {closed_ls.drop_10db_um:.0f} "
        f"| {clipped_ls.drop_3db_um:.1f} / {clipped_ls.drop_10db_um:.0f} "
        f"| {ls.ls_3db.um:.1f} / {ls.ls_10db.um:.0f} "
        f"| {_off(ls.ls_3db.um, printed.LS_UM[3][0])} / {_off(ls.ls_10db.um, printed.LS_UM[10][0])} |",
    ]
    for offset, response in measured.items():
        paper = [printed.els_drop_off_um(offset, decibel) for decibel in (3, 10)]
        closed, clipped = model_drop_offs(offset_um=offset), clipped_drop_offs(_instrument(offset))[1]
        rows.append(
            f"| ELS, offset {offset:.0f} | {paper[0]:.1f} / {paper[1]:.1f} "
            f"| {closed.drop_3db_um:.1f} / {closed.drop_10db_um:.1f} "
            f"| {clipped.drop_3db_um:.1f} / {clipped.drop_10db_um:.1f} "
            f"| {response.els_3db.um:.1f} / {response.els_10db.um:.1f} "
            f"| {_off(response.els_3db.um, paper[0])} / {_off(response.els_10db.um, paper[1])} |"
        )
    fits = [
        fit_saturation(list(measured), [getattr(response, name).um for response in measured.values()])
        for name in ("els_3db", "els_10db")
    ]
    ours = " / ".join(f"{fit.limit_um:.0f} (1 - exp(-{fit.rate_per_um:.4f} OF))" for fit in fits)
    papers = " / ".join(f"{limit:.0f} (1 - exp(-{rate:.4f} OF))" for limit, rate in printed.ELS_FITS.values())
    return [*rows, f"| ELS, fit over the offsets OF | {papers} | | | {ours} | |"]


def _small_offset_table(measured: dict[float, AxialResponse]) -> list[str]:
    lines = [
        "| offset (um) | 3 dB / 10 dB, paper (um) | with the rim (um) | raw frames (um) | signal kept |",
        "|---|---|---|---|---|",
    ]
    for offset, response in measured.items():
        paper, (_, clipped) = printed.SMALL_OFFSETS_UM[offset], clipped_drop_offs(_instrument(offset))
        lines.append(
            f"| {offset:g} | {paper[0]:g} / {paper[1]:g} | {clipped.drop_3db_um:.1f} / {clipped.drop_10db_um:.1f} "
            f"| {response.els_3db.um:.1f} / {response.els_10db.um:.1f} | {100 * response.signal_kept:.0f} % |"
        )
    return lines


def _slit_table(measured: dict[float, AxialResponse]) -> list[str]:
    return [
        "| slit (um) | ELS+ 10 dB, paper (um) | raw frames | LS 3 dB, paper (um) | raw frames | signal kept |",
        "|---|---|---|---|---|---|",
        *(
            f"| {slit} | 120 | {response.els_10db.um:.1f} | {printed.LS_BY_SLIT_UM[slit]:g} | {response.ls_3db.um:.1f} "
            f"| {100 * response.signal_kept:.1f} % |"
            for slit, response in measured.items()
        ),
    ]


def _seed_table(measured: list[AxialResponse]) -> list[str]:
    rows = [
        f"| {SEEDS} seeds, offset 29 um, slit 2.9 um | mean | sd | lowest | highest | must lie in |",
        "|---|---|---|---|---|---|",
    ]
    els_um = {decibel: round(printed.els_drop_off_um(29.0, decibel), 1) for decibel in printed.ELS_FITS}
    for name, field, low, high in (
        *((f"LS {db} dB", f"ls_{db}db", um - spread, um + spread) for db, (um, spread) in printed.LS_UM.items()),
        *((f"ELS+ {db} dB", f"els_{db}db", 0.95 * um, 1.05 * um) for db, um in els_um.items()),
    ):
        values = np.array([getattr(response, field).um for response in measured])
        rows.append(
            f"| {name} (um) | {values.mean():.2f} | {values.std(ddof=1):.3f} | {values.min():.2f} "
            f"| {values.max():.2f} | {low:.1f} to {high:.1f} |"
        )
    return rows


def _instruments() -> dict[str, Instrument]:
    """Instruments that differ in what a distance depends on."""
    line = LINE_MODELS["a"]
    usual = _instrument(29.0)
    return {
        "offset 29 um, slit 2.9 um, 120 Hz": usual,
        "offset -29 um": replace(usual, offset_rows=-usual.offset_rows),
        "offset 12 um, slit 1.9 um": Instrument.of("120hz", slit_um=1.9, offset_um=12.0),
        "offset 58 um, slit 5.8 um": Instrument.of("120hz", slit_um=5.8, offset_um=58.0),
        "240 Hz, offset -77 um": Instrument.of("240hz", offset_um=-77.0),
        "sharper line (state b), offset 77 um": _instrument(77.0, state="b"),
        "fibres of 1.4 times the aperture": replace(usual, line=replace(line, spread=1.4 * line.spread)),
        "fibres of 0.8 times the aperture": replace(usual, line=replace(line, spread=0.8 * line.spread)),
        "bundle of 480 um": replace(usual, bundle=replace(usual.bundle, diameter_um=480.0)),
    }


def _instrument_table() -> list[str]:
    columns = ("LS 3 dB", "LS 10 dB", "ELS+ 3 dB", "ELS+ 10 dB")
    rows = [f"| instrument | {' | '.join(f'{name} (um)' for name in columns)} |", "|---" * (1 + len(columns)) + "|"]
    measured = {name: (one, measure_axial(one, seed=3)) for name, one in _instruments().items()}
    for preset in ("120hz", "240hz"):
        dim = Instrument.of(preset, offset_um=-29.0)
        measured[f"a quarter of the light, {preset[:3]} Hz, offset -29 um"] = (
            dim,
            measure_axial(dim, seed=3, light=0.25),
        )
    for name, (instrument, response) in measured.items():
        drops = (response.ls_3db, response.ls_10db, response.els_3db, response.els_10db)
        truth = sum(map(tuple, clipped_drop_offs(instrument)), ())
        told = (
            f"{drop.um:.1f} +- {drop.uncertainty_um:.2f} ({drop.um - um:+.2f})"
            for drop, um in zip(drops, truth, strict=True)
        )
        rows.append(f"| {name} | {' | '.join(told)} |")
    return rows


def _edge_table(residuals: dict[float, NDArray[np.float32]]) -> list[str]:
    um_per_px = _instrument(74.0).optics.um_per_px
    lines = [
        "| offset (um) | 15 to 50 um inside the upper rim | 25 to 35 um inside | 15 to 50 um inside the lower rim |",
        "|---|---|---|---|",
    ]
    for offset, image in residuals.items():
        shares = " | ".join(f"{_share(image, um_per_px, *strip_um):.2f}" for strip_um in STRIPS_UM)
        lines.append(f"| {abs(offset):.0f} | {shares} |")
    return lines


def _share(image: NDArray[np.float32], um_per_px: float, first_um: float, last_um: float) -> float:
    """Brightness between two rows down the middle, over that of the centre."""
    axis_um = (np.arange(len(image)) - (len(image) - 1) / 2) * um_per_px
    centre = np.hypot(axis_um[:, None], axis_um) < 50
    inside = np.ix_((axis_um >= first_um) & (axis_um <= last_um), np.abs(axis_um) < 40)
    return float(image[inside].mean() / image[centre].mean())


def _off(value: float, target: float) -> str:
    return f"{100 * (value / target - 1):+.1f} %"
