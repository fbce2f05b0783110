"""The plan of a batch: its recordings, what is made of each, and which stages earlier runs have finished.

A stage's record is written after its outputs were renamed into place, so that a stage with a record is complete. The
job lies in the folder ``.batch`` of the output, the records of each recording in ``.batch/NAME``.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import real_path
from napari_elsplus.io.calibration_lookup import calibration_beside
from napari_elsplus.io.formats.registry import format_of_name, recording_stem, supported_recordings
from napari_elsplus.io.text import read_json, read_lines, write_json

if TYPE_CHECKING:
    from collections.abc import Sequence

RECORDS: Final = ".batch"
"""Folder of the job and of the recordings' records, in the output folder of a batch."""
FORMATS: Final = {"ome-tiff": ".ome.tif", "ome-zarr": ".ome.zarr"}
"""Suffix of the files of images and mosaics by the name of their format."""
MAX_LIST_BYTES: Final = 16 << 20
"""Chosen: a list of a hundred thousand paths has some 10 MB; a larger file is another one, named by mistake."""
_ONE_PATH_PER_LINE: Final = "give a text file of one path per line"
Values = dict[str, Any]


@dataclass(frozen=True)
class BatchJob:
    """Products made of every recording.

    Parameters
    ----------
    output : str
        Folder of the results.
    mode : str
        Image type: :class:`~napari_elsplus.processing.images.modes.Mode`.
    mosaic : bool
        Also track the probe and make a mosaic.
    calibration : str, optional
        Calibration file for all recordings; by default that beside or in each.
    file_format : str
        Format of images and mosaics: a name of :data:`FORMATS`.
    """

    output: str
    mode: str
    mosaic: bool
    calibration: str | None
    file_format: str = "ome-tiff"

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages of a recording."""
        return ("section", "mosaic") if self.mosaic else ("section",)

    def describe(self) -> str:
        """Return the job in words, for a message."""
        made = f"{self.mode} images" + (" and mosaics" if self.mosaic else "") + f" as {self.file_format}"
        return made + (f" by {self.calibration}" if self.calibration else " by the recordings' calibrations")


@dataclass(frozen=True)
class BatchItem:
    """One recording of a batch.

    Parameters
    ----------
    name : str
        Name of its folder of results.
    recording : str
        Path of the recording.
    job : BatchJob
        What is made of it.
    """

    name: str
    recording: str
    job: BatchJob

    @property
    def folder(self) -> Path:
        """Folder of the recording's results."""
        return Path(self.job.output, self.name)

    @property
    def images(self) -> Path:
        """File of the sectioned images."""
        return self.folder / f"{self.job.mode}{FORMATS[self.job.file_format]}"

    @property
    def mosaic(self) -> Path:
        """File of the mosaic."""
        return self.folder / f"mosaic{FORMATS[self.job.file_format]}"

    @property
    def track(self) -> Path:
        """File of the track."""
        return self.folder / "track.csv"

    @property
    def records(self) -> Path:
        """Folder of what a later run needs of the recording: records of its stages, unfinished images, picture."""
        return Path(self.job.output, RECORDS, self.name)

    @property
    def tile(self) -> Path:
        """The recording's picture for the contact sheet."""
        return self.records / "tile.png"

    def files(self, stage: str) -> tuple[Path, ...]:
        """Return the files that a stage writes."""
        return (self.images,) if stage == "section" else (self.mosaic, self.track)

    def record(self, stage: str) -> Path:
        """Return the path of the record that a stage is finished."""
        return self.records / f"{stage}.json"

    def recall(self, stage: str) -> Values | None:
        """Return what a stage has found, if an earlier run made its files of the same ones; else None."""
        try:
            record = read_json(self.record(stage), "run the batch again")
        except InputError:
            return None
        values: Values = record["values"]
        complete = all(file.exists() for file in self.files(stage))
        return values if complete and record.get("input") == self.fingerprint() else None

    def remember(self, stage: str, values: Values, fingerprint: Values) -> None:
        """Write that a stage is finished.

        Parameters
        ----------
        stage : str
            The stage.
        values : dict
            What it found.
        fingerprint : dict
            What :meth:`fingerprint` returned before the stage.

        Raises
        ------
        InputError
            If the recording or its calibration is no longer that of the fingerprint.
        """
        if self.fingerprint() != fingerprint:
            raise InputError(f"{self.name} or its calibration was changed meanwhile", "run the batch again")
        write_json(self.record(stage), {"input": fingerprint, "values": values}, force=True)

    def fingerprint(self) -> Values:
        """Return number, bytes and newest time (ns) of the recording's files, and a digest of its calibration."""
        recording = Path(self.recording)
        # where it is a folder, those in it too: they may be written in place
        files = [path.stat() for path in (recording, *recording.rglob("*"))]
        size, newest_ns = sum(file.st_size for file in files), max(file.st_mtime_ns for file in files)
        calibration = self.job.calibration or calibration_beside(self.recording)
        return {"recording": [len(files), size, newest_ns], "calibration": _digest(calibration)}


def find_recordings(source: Path) -> dict[str, Path]:
    """Return the recordings of a folder, or of a text file that lists one path per line, by the names of their results.

    Parameters
    ----------
    source : pathlib.Path
        Folder (searched without its subfolders), or list; paths in a list are relative to it, and lines that are empty
        or begin with ``#`` are skipped.

    Raises
    ------
    InputError
        If there is none, or two recordings would have the same folder of results.
    """
    recordings = _in_folder(source) if source.is_dir() else _in_list(source)
    if not recordings:
        inside = sorted(path.name for path in source.iterdir() if path.is_dir()) if source.is_dir() else []
        if inside := [name for name in inside if not name.startswith(".")]:
            raise InputError(
                f"{source} names no recordings, and subfolders are not searched",
                f"give a list of the recordings, or one of the folders in it: {', '.join(inside):.80}",
            )
        raise InputError(f"{source} names no recordings", f"give a folder or a list of: {supported_recordings()}")
    return dict(zip(_names(recordings), recordings, strict=True))


def open_output(job: BatchJob) -> None:
    """Create the output folder of a job, or resume the same job in it.

    Raises
    ------
    InputError
        If it is a file, or the folder holds other files, or another job.
    """
    output, file = Path(job.output), Path(job.output, RECORDS, "job.json")
    described = {**asdict(job), "output": "", "calibration": _digest(job.calibration)}
    if file.exists():
        if read_json(file, f"name another folder than {output}") != described:
            raise InputError(f"{output} holds the results of another job than {job.describe()}", "name another folder")
        return
    if output.exists() and not output.is_dir():
        raise InputError(f"{output} is a file", "name a folder")
    if output.exists() and any(output.iterdir()):
        raise InputError(f"{output} holds other files", "name a new folder")
    file.parent.mkdir(parents=True, exist_ok=True)
    write_json(file, described)


def _in_folder(folder: Path) -> list[Path]:
    visible = (path for path in sorted(folder.iterdir()) if not path.name.startswith("."))
    return [path for path in visible if (found := format_of_name(path)) is not None and found.opener is not None]


def _in_list(file: Path) -> list[Path]:
    if not file.exists():
        raise InputError(f"there is no folder or list {file}", "check the path")
    if format_of_name(file) is not None:
        raise InputError(f"{file} is one recording", "give a folder, or a text file that lists one path per line")
    lines = read_lines(file, _ONE_PATH_PER_LINE, MAX_LIST_BYTES)
    listed = [file.parent / line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if listed and not any(map(os.path.lexists, listed)):
        raise InputError(f"no file that {file} lists is there, {listed[0].name:.60} is the first", _ONE_PATH_PER_LINE)
    return listed


def _names(recordings: Sequence[Path]) -> list[str]:
    """Return a name for each recording: its stem, preceded by its folder's where stems are alike."""
    stems = [recording_stem(path.name) for path in recordings]
    count = Counter(stems)
    names = [
        stem if count[stem] == 1 else f"{real_path(path).parent.name}-{stem}"
        for stem, path in zip(stems, recordings, strict=True)
    ]
    twice = [name for name, times in Counter(names).items() if times > 1]
    if twice:
        raise InputError(f"two recordings are called {twice[0]}", "rename one of them, or leave it out")
    return names


def _digest(calibration: str | Path | None) -> str | None:
    """Return a digest of a calibration's file and of its arrays beside it."""
    if calibration is None:
        return None
    files = Path(calibration), Path(calibration).with_suffix(".npz")
    parts = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.exists()]
    return " ".join(parts)
