"""A share of a batch's stages, executed in a plain process.

``python -m benchmarks.programs.batch_share SOURCE OUTPUT FIRST STEP``; several of these at once, without a
scheduler, are what a computer can give at most.
"""

from __future__ import annotations

import sys
from pathlib import Path

from napari_elsplus.workflows.batch.job import BatchItem, BatchJob, find_recordings
from napari_elsplus.workflows.batch.spans import SPANS
from napari_elsplus.workflows.batch.tasks import finish_spans, run_span, run_stage


def plain_job(output: Path) -> BatchJob:
    """Return the job of which the stages are executed; its folder is opened once, before its processes start."""
    return BatchJob(str(output), "els", mosaic=True, calibration=None)


def execute(source: Path, output: Path, first: int, step: int) -> None:
    """Execute all stages of every `step`-th recording, from the one with index `first`, one after the other."""
    job = plain_job(output)
    items = [BatchItem(name, str(path), job) for name, path in find_recordings(source).items()]
    for item in items[first::step]:
        for stage in job.stages:
            found = run_stage(stage, item)
            if SPANS in found:
                finish_spans(item, [run_span(span, item) for span in found[SPANS]])


if __name__ == "__main__":
    execute(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
