"""Tasks of a batch: a stage of a recording, or a span of its images, unless an earlier run has finished it.

What computes is imported where a task is executed: the process that submits tasks does without it. What is raised, of
a recording that cannot be read for instance, fails its task alone; the row of the table has the message.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from napari_elsplus.io import open_recording
from napari_elsplus.io.atomic import remove_unfinished
from napari_elsplus.workflows.batch.spans import SPANS, SpannedImages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.workflows.batch.job import BatchItem, Values


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
        Columns of the recording's row in the table; of a long recording's images only the spans to be made, under
        :data:`SPANS`, after which :func:`finish_spans` finishes the stage.
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


def run_span(span: range, item: BatchItem) -> Values:
    """Make a span of the images of a recording; return what it finds.

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


def finish_spans(item: BatchItem, _made: Sequence[Values]) -> Values:
    """Return what the images of a recording show after all of their spans were made, and rename them into place.

    Parameters
    ----------
    item : BatchItem
        The recording.
    _made : sequence of dict
        What the tasks of the spans returned, for which this one waits; one that failed fails this one.

    Returns
    -------
    dict
        As :func:`run_stage`.
    """
    return SpannedImages(item).finish()
