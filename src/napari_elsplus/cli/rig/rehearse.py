"""``rehearse``: faults played on the simulated rig, promise against observation."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from napari_elsplus.cli.options import FILE, force_option, progress, refuse_outputs

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.option("--fault", "names", multiple=True, help="Name of a fault; several may be given; all by default.")
@click.option("--report", type=FILE, help="Write the table to this JSON file.")
@force_option
def command(names: tuple[str, ...], report: Path | None, force: bool) -> None:
    """Rehearse faults on the simulated rig, in processes of their own; print what was promised and what happened.

    Exits 0 when every promise was held, 1 when one was not. Software replaces no hardware interlock.
    """
    from napari_elsplus.diagnosis.rehearsal.rehearse import faults
    from napari_elsplus.diagnosis.rehearsal.row import heading, line
    from napari_elsplus.io import write_json

    refuse_outputs(report, force=force, suffixes={report: ".json"})
    chosen = faults(names)
    click.echo(heading())
    rows = []
    for fault in progress(chosen, "Rehearsing"):
        row = fault.rehearse()
        rows.append(row)
        click.echo(click.style(line(row), fg=None if row.held else "red"))
    if report is not None:
        write_json(report, [asdict(row) for row in rows], indent=1, force=force)
    broken = [row for row in rows if not row.held]
    click.echo(f"{len(rows) - len(broken)} of {len(rows)} promises were held")
    if broken:
        raise SystemExit(1)
