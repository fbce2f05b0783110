"""Run a batch on a dask scheduler, collect a table and a contact sheet."""

from __future__ import annotations

import csv
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import ElsPlusError, InputError, error_message
from napari_elsplus.instrument.arguments import require_path
from napari_elsplus.io import read_calibration, replacing
from napari_elsplus.io.atomic import real_path
from napari_elsplus.io.formats.extras import extra_needed
from napari_elsplus.processing.images.modes import Mode
from napari_elsplus.processing.progress import Progress, without_display
from napari_elsplus.workflows.batch.cluster import batch_client
from napari_elsplus.workflows.batch.job import FORMATS, BatchItem, BatchJob, Values, find_recordings, open_output
from napari_elsplus.workflows.batch.spans import SPANS
from napari_elsplus.workflows.batch.tasks import finish_spans, run_span, run_stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


ERROR: Final = "error"
"""Column of the message of what failed."""
COLUMNS: Final = (
    "recording", "name", "calibration", "images", "frames", "tracked", "segments", "path_um", "area_um2", "contrast",
    "warnings", ERROR,
)  # fmt: skip
"""Columns of the table; those that a job does not measure stay empty."""


@dataclass(frozen=True)
class BatchResult:
    """Outcome of a batch.

    Attributes
    ----------
    rows : list of dict
        A row per recording, with the columns :data:`COLUMNS`.
    notes : tuple of str
        Messages to the user.
    """

    rows: list[Values]
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> list[Values]:
        """Rows of the recordings that failed."""
        return [row for row in self.rows if row.get(ERROR)]


def batch(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    calibration: str | os.PathLike[str] | None = None,
    mode: Mode | str = Mode.ELS,
    mosaic: bool = False,
    file_format: str = "ome-tiff",
    scheduler: str | None = None,
    workers: int | None = None,
    announce: Callable[[str], None] = lambda _: None,
    progress: Progress = without_display,
) -> BatchResult:
    """Section many recordings, and make their mosaics, on the workers of a dask scheduler.

    Each stage of each recording is a task of one thread; the images of a long recording are several. A batch that was
    interrupted is resumed by the same call: what is finished is not done again. A recording that fails is reported and
    does not stop the others.

    Parameters
    ----------
    source : path-like
        Folder of recordings, whose subfolders are not searched, or a text file with one path per line.
    output : path-like
        Folder for the results: ``NAME/els.ome.tif`` (after the mode), ``NAME/mosaic.ome.tif``, ``NAME/track.csv``,
        ``table.csv`` and ``contact-sheet.png``.
    calibration : path-like, optional
        For all recordings; by default each has its own beside or in it.
    mode : Mode or str
        Image type.
    mosaic : bool
        Also track the probe and make a mosaic of each recording.
    file_format : str
        ``"ome-tiff"`` or ``"ome-zarr"`` (``.ome.zarr`` for ``.ome.tif``): format of images and mosaics.
    scheduler : str, optional
        Address of an existing dask scheduler, whose workers see the same files and have this package; it executes the
        code that it is sent. By default workers are started here and listen on 127.0.0.1 only.
    workers : int, optional
        Number of local workers, a process each; one per core by default. Not with `scheduler`, which has its own.
    announce : callable
        Receives the address of the dashboard.
    progress : Progress
        Wraps the numbers of the tasks.

    Returns
    -------
    BatchResult

    Raises
    ------
    InputError
        If there are no recordings, the format is unknown or not installed, the output folder holds anything else, no
        scheduler answers, or a number of workers is given for one.
    CalibrationError
        If the given calibration cannot be used.
    """
    if scheduler is not None and workers is not None:
        raise InputError(f"the scheduler {scheduler} has workers of its own", "give a number of workers without it")
    for path in (source, output):
        require_path(path)
    if calibration is not None:
        read_calibration(calibration)  # refused here, once
    _require_format(file_format)
    recordings = find_recordings(Path(source))
    chosen = None if calibration is None else str(real_path(calibration))
    job = BatchJob(str(real_path(output)), Mode(mode).value, mosaic, chosen, file_format)
    items = [BatchItem(name, str(real_path(path)), job) for name, path in recordings.items()]
    with batch_client(scheduler, workers) as client:
        open_output(job)
        announce(client.dashboard_link)
        stages = _ordered(items, job, len(client.nthreads()))
        steps = progress(range(len(stages)), "Batch")
        executed = {key: found for _, (key, found) in zip(steps, _finished_stages(client, stages), strict=False)}
    found = {item.name: [executed[item.name, stage] for stage in job.stages] for item in items}
    rows = [_row(item, found[item.name]) for item in items]
    for item, row in zip(items, rows, strict=True):
        if row[ERROR]:
            with suppress(OSError):  # it holds something
                item.folder.rmdir()
    _write_table(Path(job.output, "table.csv"), rows)
    _write_sheet(job, [(item, found[item.name][-1]) for item, row in zip(items, rows, strict=True) if not row[ERROR]])
    return BatchResult(rows, _notes(rows))


def _require_format(name: str) -> None:
    """Raise an error if no file of a format can be written here."""
    if name not in FORMATS:
        raise InputError(f"there is no format {name!r}", f"choose one of {', '.join(FORMATS)}")
    if name == "ome-zarr":
        with extra_needed("zarr", "OME-Zarr images"):
            import zarr  # noqa: F401


def _ordered(items: list[BatchItem], job: BatchJob, workers: int) -> list[tuple[str, BatchItem]]:
    """Return the stages of all recordings in the order in which they are begun.

    A mosaic cannot be split: those of as many recordings as there are workers precede a recording's images, so that
    short tasks are left for the end, and the recording is still in the computer's memory.
    """
    lag = {"mosaic": 0, "section": workers if job.mosaic else 0}
    begun = [(place + lag[stage], stage, item) for place, item in enumerate(items) for stage in job.stages]
    return [(stage, item) for _, stage, item in sorted(begun, key=lambda begin: begin[:2])]


def _finished_stages(client: Any, stages: list[tuple[str, BatchItem]]) -> Iterator[tuple[tuple[str, str], Values]]:
    """Execute stages, and yield the recording's name and the stage with what was found, as each is finished."""
    from distributed import as_completed

    def begin(task: Callable[..., Values], *arguments: Any, priority: int) -> Any:
        return client.submit(task, *arguments, pure=False, priority=priority)

    begun: dict[Any, tuple[str, BatchItem, int]] = {}
    for place, (stage, item) in enumerate(stages):
        begun[begin(run_stage, stage, item, priority=-place)] = (stage, item, -place)
    completed = as_completed(list(begun))
    for future in completed:
        stage, item, priority = begun.pop(future)
        error = future.exception()
        found = future.result() if error is None else {ERROR: _message(error)}
        if SPANS in found:
            spans = [begin(run_span, span, item, priority=priority) for span in found[SPANS]]
            last = begin(finish_spans, item, spans, priority=priority)
            begun[last] = (stage, item, priority)
            completed.add(last)
        else:
            yield (item.name, stage), found


def _message(error: BaseException) -> str:
    """Return what a task raised as one line: also a defect, and a worker that was killed again and again."""
    if isinstance(error, ElsPlusError | OSError):
        return error_message(error)
    return f"{type(error).__name__}: {error}"


def _row(item: BatchItem, found: list[Values]) -> Values:
    row: Values = dict.fromkeys(COLUMNS, "") | {"recording": item.recording, "name": item.name}
    for values in found:
        row |= {name: value for name, value in values.items() if name in COLUMNS and name != ERROR}
    row[ERROR] = "; ".join(dict.fromkeys(values[ERROR] for values in found if ERROR in values))
    return row


def _write_table(path: Path, rows: list[Values]) -> None:
    with (
        replacing(path, force=True) as unfinished,
        unfinished.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,
    ):
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(rows)


def _write_sheet(job: BatchJob, made: list[tuple[BatchItem, Values]]) -> None:
    if not made:
        return
    from napari_elsplus.workflows.batch.tiles import TILE_UM, read_tile
    from napari_elsplus.workflows.pictures.batch_sheet import draw_batch_sheet
    from napari_elsplus.workflows.pictures.files import save_grey_figure

    sheet = draw_batch_sheet([(_drawable(item.name), read_tile(item.tile), values[TILE_UM]) for item, values in made])
    save_grey_figure(sheet, Path(job.output, "contact-sheet.png"), force=True)


def _drawable(name: str) -> str:
    """Return the name of a file, which may be no text, as one that fonts can draw."""
    return os.fsencode(name).decode("utf-8", "replace")


def _notes(rows: list[Values]) -> tuple[str, ...]:
    notes = [f"{row['name']}: {row['warnings']}" for row in rows if row["warnings"]]
    used = {row["calibration"].rpartition("(")[2] for row in rows if row["calibration"]}
    if len(used) > 1:
        notes.append(
            f"the recordings have {len(used)} different calibrations: compare grey levels and lengths with care"
        )
    return tuple(notes)
