"""A task of a batch: one stage of one recording, unless an earlier run has finished it.

What computes is imported where a task is executed: the process that submits tasks does without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from napari_elsplus.errors import ElsPlusError, error_message
from napari_elsplus.io import open_recording
from napari_elsplus.io.atomic import remove_unfinished

if TYPE_CHECKING:
    from napari_elsplus.workflows.batch.job import BatchItem, BatchJob, Values

ERROR: Final = "error"
"""Key of a failed stage's message."""
STAGES_MODULE: Final = "napari_elsplus.workflows.batch.stages"
"""Imported by local workers when they start."""


def run_stage(stage: str, item: BatchItem, job: BatchJob) -> Values:
    """Return what a stage finds in a recording: from an earlier run's record, or by executing it.

    Parameters
    ----------
    stage : str
        ``"section"`` or ``"mosaic"``.
    item : BatchItem
        The recording.
    job : BatchJob
        What is made of it.

    Returns
    -------
    dict
        Columns of the recording's row in the table; a message under :data:`ERROR` if it failed.
    """
    try:
        found = item.recall(job, stage)
        if found is None:
            from napari_elsplus.workflows.batch.stages import STAGES, single_threaded

            written = (item.folder(job) / name for name in job.files(stage))
            remove_unfinished(item.record(job, stage), item.tile(job), *written)
            with open_recording(item.recording) as recording, single_threaded():
                found = STAGES[stage](item, job, recording)
            item.remember(job, stage, found)
    except (ElsPlusError, OSError) as error:
        return {ERROR: error_message(error)}
    return found
