"""``batch``: sectioned images and mosaics of many recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.cli.options import FILE, IMAGE_TYPE, LazyChoice, progress

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.argument("source", type=FILE, metavar="FOLDER_OR_LIST")
@click.option(
    "-c", "--calibration", type=FILE, help="Calibration for all; by default that beside or in each recording."
)
@click.option("--mode", type=IMAGE_TYPE, default="els", show_default=True, help="Image type.")
@click.option("--mosaic", is_flag=True, help="Also track the probe and make a mosaic of each recording.")
@click.option(
    "--format", "file_format", default="ome-tiff", show_default=True,
    type=LazyChoice("napari_elsplus.workflows.batch.job:FORMATS"),
    help="Format of images and mosaics; ome-zarr is NGFF 0.5, and needs the extra zarr.",
)  # fmt: skip
@click.option("-o", "--output", type=FILE, required=True, help="Folder for the results; a batch in it is resumed.")
@click.option(
    "--scheduler",
    help="Address of an existing dask scheduler. It executes whatever code it is sent: name only one that you trust.",
)
@click.option(
    "--workers", type=click.IntRange(1), help="Local worker processes, without --scheduler; one per core by default."
)
def command(source: Path, output: Path, **options: Any) -> None:
    """Section every recording of a folder, or of a text file with one path per line.

    Subfolders are not searched: name their recordings in a list.

    Writes OUTPUT/NAME/els.ome.tif (mosaic.ome.tif and track.csv with --mosaic; .ome.zarr with --format ome-zarr),
    OUTPUT/table.csv with a row per recording, and OUTPUT/contact-sheet.png. The same command resumes an interrupted
    batch. Local workers and their dashboard listen on 127.0.0.1 only. Exits 1 if any recording failed.
    """
    from napari_elsplus.workflows.batch.run import batch

    def announce(address: str) -> None:
        click.echo(f"dashboard: {address}", err=True)

    result = batch(source, output, announce=announce, progress=progress, **options)
    for note in result.notes:
        click.echo(f"note: {note}")
    for row in result.failed:
        click.echo(f"failed: {row['name']}: {row['error']}")
    click.echo(f"{len(result.rows) - len(result.failed)} of {len(result.rows)} recordings done: {output / 'table.csv'}")
    if result.failed:
        raise SystemExit(1)
