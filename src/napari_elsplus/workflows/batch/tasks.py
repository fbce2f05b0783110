"""Tasks of a batch: a stage of a recording, or a span of its images, unless an earlier run has finished it.

What computes is imported where a task is executed: the process that submits tasks does without it. A recording that
cannot be read, or lacks a calibration, is returned as an error, for its row of the table.
"""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, Final, ParamSpec

from napari_elsplus.errors import ElsPlusError, error_message
from napari_elsplus.io import open_recording
from napari_elsplus.io.atomic import remove_unfinished
from napari_elsplus.workflows.batch.spans import SPANS, SpannedImages

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from napari_elsplus.workflows.batch.job import BatchItem, Values

    Arguments = ParamSpec("Arguments")

ERROR: Final = "error"
"""Key of a failed task's message."""


def _returning_errors(task: Callable[Arguments, Values]) -> Callable[Arguments, Values]:
    """Return a task that returns the message of a failure under :data:`ERROR`."""

    @wraps(task)
    def returning(*arguments: Arguments.args, **options: Arguments.kwargs) -> Values:
        try:
            return task(*arguments, **options)
        except (ElsPlusError, OSError) as error:
            return {ERROR: error_message(error)}

    return returning


@_returning_errors
def run_stage(stage: str, item: BatchItem) -> Values:
    """Return what a stage finds in a recording: from an earlier run's record, or by executing it.

    Parameters
    ----------
    stage : str
        ``"section"`` or ``"mosaic"``.
    item : BatchItem
        The recording.

    Returns
    -------
    dict
        Columns of the recording's row in the table; a message under :data:`ERROR` if it failed; of a long recording's
        images only the spans to be made, under :data:`SPANS`, after which :func:`finish_spans` finishes the stage.
    """
    found, fingerprint = item.recall(stage), item.fingerprint()
    if found is None:
        from napari_elsplus.workflows.batch.stages import STAGES, single_threaded

        for folder in (item.folder, item.records):
            folder.mkdir(parents=True, exist_ok=True)
        remove_unfinished(item.record(stage), item.tile, *item.files(stage))
        with open_recording(item.recording) as recording, single_threaded():
            found = STAGES[stage](item, recording)
        if SPANS not in found:
            item.remember(stage, found, fingerprint)
    return found


@_returning_errors
def run_span(span: range, item: BatchItem) -> Values:
    """Make a span of the images of a recording; return what it finds, or a message under :data:`ERROR`.

    Parameters
    ----------
    span : range
        Indices of the images.
    item : BatchItem
        The recording.
    """
    from napari_elsplus.workflows.batch.stages import fill_span, single_threaded

    with open_recording(item.recording) as recording, single_threaded():
        found = fill_span(span, item, recording)
    SpannedImages(item).remember(span, found)
    return found


@_returning_errors
def finish_spans(item: BatchItem, found: Sequence[Values]) -> Values:
    """Return what the images of a recording show after all of their spans were made, and rename them into place.

    Parameters
    ----------
    item : BatchItem
        The recording.
    found : sequence of dict
        What the tasks of the spans returned.

    Returns
    -------
    dict
        As :func:`run_stage`; a message under :data:`ERROR` if a span failed.
    """
    failed = [values for values in found if ERROR in values]
    return failed[0] if failed else SpannedImages(item).finish()
