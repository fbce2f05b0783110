"""A share of a batch's stages, executed in a plain process.

``python -m benchmarks.programs.batch_share SOURCE OUTPUT FIRST STEP``; several of these at once, without a
scheduler, are what a computer can give at most.
"""

from __future__ import annotations

import sys
from pathlib import Path

from napari_elsplus.workflows.batch.job import BatchJob, find_items
from napari_elsplus.workflows.batch.spans import SPANS
from napari_elsplus.workflows.batch.tasks import finish_spans, run_span, run_stage


def plain_job(output: Path) -> BatchJob:
    """Return the job of which the stages are executed; its folder is opened once, before its processes start."""
    return BatchJob(str(output), "els", mosaic=True, calibration=None)


def execute(source: Path, output: Path, first: int, step: int) -> None:
    """Execute all stages of every `step`-th recording, from the one with index `first`, one after the other."""
    job = plain_job(output)
    for item in find_items(source)[first::step]:
        for stage in job.stages:
            found = run_stage(stage, item, job)
            if SPANS in found:
                finish_spans(item, job, [run_span(span, item, job) for span in found[SPANS]])


if __name__ == "__main__":
    execute(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
