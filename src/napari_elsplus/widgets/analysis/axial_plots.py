"""Curves and tables of the Axial response panel."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.widgets.shared.plots import Curve

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.processing.analysis.slit_offset import SaturationFit
    from napari_elsplus.processing.axial.axial_response import DropOff
    from napari_elsplus.viewing.axial import DropOffs, Scan

    Mark = tuple[float, str, str]

OTHERS: Final = ("purple", "vermilion", "orange")
"""Colours of earlier scans, keys of the palette."""
FIT_POINTS: Final = 100
"""Points of a fitted curve; chosen, smooth at any width of the plot."""


def response_curves(scans: Sequence[Scan]) -> tuple[list[Curve], list[Mark]]:
    """Return the curves of the last of several scans with its drop-offs marked, and ELS+ of the others."""
    *others, last = scans
    response = last.response
    distance = response.depth_um - response.contact_um
    curves = [
        Curve("LS", distance, response.ls, "blue", "dotted"),
        Curve("residual", distance, response.residual, "grey", "dashed"),
        Curve("ELS+", distance, response.els, "green"),
    ]
    for index, scan in enumerate(others):
        apart = scan.response.depth_um - scan.response.contact_um
        curves.append(Curve(f"ELS+, {scan.name}", apart, scan.response.els, OTHERS[index % len(OTHERS)]))
    drops = (
        (response.els_3db, "green", "ELS+ 3 dB"),
        (response.els_10db, "green", "ELS+ 10 dB"),
        (response.ls_3db, "blue", "LS 3 dB"),
        (response.ls_10db, "blue", "LS 10 dB"),
    )
    marks = [(drop.um, colour, f"{name} {drop.um:.0f} µm") for drop, colour, name in drops if np.isfinite(drop.um)]
    return curves, marks


def drop_off_curves(found: DropOffs) -> list[Curve]:
    """Return drop-offs against a slit parameter as points, with the paper's curve where it could be fitted.

    Parameters
    ----------
    found : DropOffs
        Drop-offs of several scans, and the fits.
    """
    curves = [
        Curve("3 dB", found.x_um, found.drop_3db_um, "green", marks=True),
        Curve("10 dB", found.x_um, found.drop_10db_um, "orange", "dashed", marks=True),
    ]
    for name, fit, colour in (("3 dB", found.fit_3db, "green"), ("10 dB", found.fit_10db, "orange")):
        if fit is not None:
            x = np.linspace(0, float(found.x_um.max()), FIT_POINTS)
            curves.append(
                Curve(_fit_label(name, fit), x, fit.limit_um * (1 - np.exp(-fit.rate_per_um * x)), colour, "dotted")
            )
    return curves


def table(scans: Sequence[Scan]) -> str:
    """Return the drop-offs of scans as rich text, micrometres: the last one with notes, ELS+ of the others."""

    def row(*cells: str) -> str:
        return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"

    *others, last = scans
    rows = [row("", "3 dB / µm", "10 dB / µm")]
    rows += [row(scan.name, _value(scan.response.els_3db), _value(scan.response.els_10db)) for scan in others]
    one = last.response
    rows.append(
        f"<tr><td colspan=3><b>{escape(last.name)}</b>: {100 * one.signal_kept:.0f} % of the LS signal kept</td></tr>"
    )
    rows.append(row("LS", _with_uncertainty(one.ls_3db), _with_uncertainty(one.ls_10db)))
    rows.append(row("ELS+", _with_uncertainty(one.els_3db), _with_uncertainty(one.els_10db)))
    notes = (note.replace("+-", "±").replace(" um", " µm").replace(" %", "&nbsp;%") for note in axial_notes(one))
    rows += [f"<tr><td colspan=3>{note}</td></tr>" for note in notes]
    return f"<table width='100%' cellspacing=2>{''.join(rows)}</table>"


def _value(drop: DropOff) -> str:
    return f"{drop.um:.1f}" if np.isfinite(drop.um) else "beyond"


def _with_uncertainty(drop: DropOff) -> str:
    if not np.isfinite(drop.um):
        return "beyond the scan"
    return f"{drop.um:.1f} ± {max(drop.uncertainty_um, 0.1):.1f}"


def _fit_label(name: str, fit: SaturationFit) -> str:
    return f"{name} fit: {fit.limit_um:.0f} µm (1 - exp(-{fit.rate_per_um:.3f} x))"
