"""Spans of a long recording's images: each is a task of its own, and all are written into one unfinished file.

The file lies in a folder ``.batch/NAME/spans``, beside the plan of its spans and a record of each that was written and
flushed, until the last one is in it and it is renamed into place. A kill at any time costs the spans under way.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.io import put_in_place, replacing, write_json
from napari_elsplus.io.atomic import remove_unfinished
from napari_elsplus.io.text import read_json

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from napari_elsplus.workflows.batch.job import BatchItem, Values
    from napari_elsplus.workflows.sectioning import SectionedImages

SPAN_IMAGES: Final = 600
"""Images of a span, about. Chosen: 0.6 s of processor time, beside which the 0.05 s of opening the recording anew are
little, and as much as a worker may have to wait for at the end."""
SPANS: Final = "spans"
"""Key of the spans that are still to be made, in what a stage returns that was split into them."""
_PLAN: Final = "plan.json"


def split(images: int) -> list[range]:
    """Return equal spans of the indices of images; a single one for a short recording.

    Examples
    --------
    >>> split(240), split(1300)
    ([range(0, 240)], [range(0, 650), range(650, 1300)])
    """
    count = max(1, round(images / SPAN_IMAGES))
    return [range(images * place // count, images * (place + 1) // count) for place in range(count)]


@dataclass(frozen=True)
class SpannedImages:
    """The unfinished images of a recording that are made in spans.

    Parameters
    ----------
    item : BatchItem
        The recording.
    """

    item: BatchItem

    @property
    def folder(self) -> Path:
        """Folder of the unfinished file, its plan and its records."""
        return self.item.records / "spans"

    @property
    def file(self) -> Path:
        """The unfinished file."""
        return self.folder / self.item.images.name

    def open(self, images: SectionedImages, spans: Sequence[range], values: Values) -> list[range]:
        """Create the unfinished file, or resume that of an earlier run by the same plan; return the spans it lacks.

        Parameters
        ----------
        images : SectionedImages
            All images of the recording.
        spans : sequence of range
            Their indices, in spans.
        values : dict
            What is known of the stage before its images are made; part of the plan.
        """
        plan = {
            "input": self.item.fingerprint(),
            "values": values,
            SPANS: [[span.start, span.stop] for span in spans],
        }
        if self._plan() != plan:
            self._remove()
            remove_unfinished(self.folder)
            with replacing(self.folder) as beside:
                beside.mkdir()
                images.allocate(beside / self.item.images.name)
                write_json(beside / _PLAN, plan)
        return [span for span in spans if not self._record(span.start, span.stop).exists()]

    def remember(self, span: range, values: Values) -> None:
        """Write that a span is in the file and flushed, with the values that were found in it."""
        write_json(self._record(span.start, span.stop), values, force=True)

    def finish(self) -> Values:
        """Rename the file, of which all spans are written, into place; return the values of the stage."""
        plan = self._plan() or {}
        values: Values = plan["values"]
        for start, stop in plan[SPANS]:
            values |= read_json(self._record(start, stop), "run the batch again")
        if self.file.exists():  # else an earlier run was killed after renaming it
            put_in_place(self.file, self.item.images, self.folder / "replaced")
        self.item.remember("section", values, plan["input"])
        self._remove()
        return values

    def _plan(self) -> dict[str, Any] | None:
        try:
            plan: dict[str, Any] = read_json(self.folder / _PLAN, "run the batch again")
        except InputError:
            return None
        return plan

    def _record(self, start: int, stop: int) -> Path:
        return self.folder / f"{start}-{stop}.json"

    def _remove(self) -> None:
        (self.folder / _PLAN).unlink(missing_ok=True)  # first: what is removed in part is no unfinished file
        shutil.rmtree(self.folder, ignore_errors=True)
