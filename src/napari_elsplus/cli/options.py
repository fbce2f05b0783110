"""Options that several commands share, tests of their values, the progress bar, and a track in words."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import isfinite
from pathlib import Path
from pkgutil import resolve_name
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import click
from rich.console import Console
from rich.progress import Progress, ProgressColumn, Task
from rich.text import Text

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io import refuse_existing, refuse_suffix
from napari_elsplus.io.atomic import real_path
from napari_elsplus.processing.compilation import compilation_remark

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import Recording, TrackPoint

    Item = TypeVar("Item")


class _Number(type(click.FLOAT)):  # type: ignore[misc] # click does not export its class
    """A finite number; click's own type accepts NaN and infinity."""

    def __init__(self, *, positive: bool = False) -> None:
        self._positive = positive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if not isfinite(number) or (self._positive and number <= 0):
            option = param.opts[-1] if param is not None else "the number"
            kind = "positive, finite" if self._positive else "finite"
            raise InputError(f"{option} is {number}", f"give a {kind} number")
        return number


class _Named(click.Path):
    """A path of at least one character."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            raise InputError("the name of a file or folder is empty", "name one")
        return super().convert(value, param, ctx)


class LazyChoice(click.Choice):  # type: ignore[type-arg, unused-ignore] # generic since click 8.2
    """A choice whose values are imported when they are needed: naming a wrong option needs none.

    Parameters
    ----------
    values : str
        ``package.module:NAME`` of the values (an enumeration, the keys of a dictionary), or of what returns them.
    """

    def __init__(self, values: str) -> None:
        self._values = values
        self.case_sensitive = True

    @property
    def choices(self) -> tuple[str, ...]:  # type: ignore[override, unused-ignore]
        """The values."""
        found = resolve_name(self._values)
        return tuple(map(str, found if isinstance(found, Iterable) else found()))


class LazyHelp(click.Option):
    """An option whose help is computed when it is displayed.

    Parameters
    ----------
    *declarations : Any
        As of :class:`click.Option`.
    describe : callable
        Returns the help.
    **attributes : Any
        As of :class:`click.Option`.
    """

    def __init__(self, *declarations: Any, describe: Callable[[], str], **attributes: Any) -> None:
        super().__init__(*declarations, **attributes)
        self._describe = describe

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Return names and help; see :meth:`click.Option.get_help_record`."""
        self.help = self._describe()
        return super().get_help_record(ctx)


class ReadingCommand(click.Command):
    """A command that reads recordings: its help lists their formats, which are imported for that alone."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the formats below the options; see :meth:`click.Command.format_epilog`."""
        from napari_elsplus.io.formats.registry import supported_recordings

        self.epilog = f"{self.params[0].human_readable_name} is one of: {supported_recordings()}."
        super().format_epilog(ctx, formatter)


FILE = _Named(path_type=Path)
NUMBER, POSITIVE = _Number(), _Number(positive=True)
IMAGE_TYPE = LazyChoice("napari_elsplus.processing.images.modes:Mode")
SEED = click.IntRange(0, (1 << 31) - 1)
"""Seeds that every random generator in use takes: 31 bits."""

calibration_option = click.option(
    "-c", "--calibration", type=FILE,
    help="Calibration file, as written by `calibrate`; by default the one beside or in the recording.",
)  # fmt: skip
output_option = click.option("-o", "--output", type=FILE, required=True, help="File to write.")
force_option = click.option("--force", is_flag=True, help="Overwrite an existing output file.")


def refuse_outputs(
    *paths: Path | None,
    force: bool,
    inputs: Iterable[Path | None] = (),
    suffixes: Mapping[Path | None, str] = MappingProxyType({}),
) -> None:
    """Refuse output files that may not be written, before any work is done.

    Parameters
    ----------
    *paths : pathlib.Path or None
        Files to write; None for an option that was not given.
    force : bool
        Accept existing files.
    inputs : iterable of pathlib.Path or None
        Files that are read.
    suffixes : mapping of pathlib.Path or None to str
        Suffix that files are written with, where there is but one.

    Raises
    ------
    InputError
        If one exists and `force` is not given, cannot be a file, is named twice, is one of the inputs, which are never
        overwritten, is a folder that holds one, would be read as a frame of a folder that is one, or has another
        suffix.
    """
    wanted = [path for path in paths if path is not None]
    read = {real_path(path) for path in inputs if path is not None}
    for index, path in enumerate(wanted):
        real = real_path(path)
        if real in read:
            raise InputError(f"{path} is read, and would be overwritten", "name another file to write")
        held = min((one for one in read if real in one.parents), default=None)
        if held is not None:
            raise InputError(f"{path} holds {held.name}, which is read", "name another file to write")
        folder = next((parent for parent in real.parents if parent in read), None)
        if folder is not None and _is_image(path):
            raise InputError(f"{path} lies in {folder}, which is read, and would be a frame of it", "name another")
        refuse_existing(path, force=force)
        if real in map(real_path, wanted[:index]):
            raise InputError(f"{path} is named twice", "name another file for one of them")
        if path in suffixes:
            refuse_suffix(path, suffixes[path])


def files_read(recording: Path, chosen: Path | None) -> tuple[Path, ...]:
    """Return the files that are read: a `recording`, and its calibration, `chosen` with -c or else beside it."""
    from napari_elsplus.io import calibration_beside

    return recording, *calibration_files(calibration_beside(recording) if chosen is None else chosen)


def calibration_of(recording: Recording, chosen: Path | None, otherwise: str = "") -> Calibration:
    """Return the calibration that was chosen, else the one beside or in a recording, and print which that is.

    Parameters
    ----------
    recording : Recording
        Open.
    chosen : pathlib.Path or None
        The file named with -c.
    otherwise : str
        What else the user may do if the recording has none, or contains images.

    Raises
    ------
    InputError
        If the recording contains images that were made of raw frames.
    CalibrationError
        If there is none, or it is broken.
    """
    from napari_elsplus.io import read_calibration  # imports numpy, of which wrong options need nothing

    if (made := recording.image_type) is not None:
        problem = f"{recording.path.name} contains images that were made of raw frames ({made})"
        raise InputError(problem, f"name the recording of raw frames{otherwise}")
    if chosen is not None:
        return read_calibration(chosen)
    found, file = recording.find_calibration()
    if found is None:
        problem = f"there is no calibration in or beside {recording.path.name}"
        raise CalibrationError(problem, f"name one with -c{otherwise}")
    click.echo(f"calibration: {file or f'the one in {recording.path}'}")
    return found


def calibration_files(path: Path | None) -> tuple[Path, ...]:
    """Return the files of the calibration of a `path`, NAME.json and NAME.npz; none for None."""
    if path is None:
        return ()
    return (path, path.with_suffix(".npz")) if path.name else (path,)  # the current folder and / have no name


def _is_image(path: Path) -> bool:
    """Return True for a name by which frames or images are read."""
    from napari_elsplus.io.formats.registry import format_of_name  # imports numpy, of which wrong options need nothing

    return format_of_name(path) is not None


class _Rate(ProgressColumn):
    """Steps done in a second, most of them frames; empty before it is known."""

    def render(self, task: Task) -> Text:
        speed = task.speed
        return Text("" if speed is None else f"{speed:.0f}/s" if speed >= 10 else f"{speed:.1f}/s")


class ConsoleDisplay:
    """Progress bars on a console, and beside them the kernel that is being compiled; nothing without a terminal.

    Parameters
    ----------
    console : rich.console.Console
        Where they are displayed.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar: Progress | None = None

    def progress(self, numbers: Iterable[Item], step: str) -> Iterable[Item]:
        """Display a progress bar of a step's numbers."""
        return self._with_bar(numbers, step) if self._console.is_terminal else numbers

    def compiling(self, kernel: str) -> None:
        """Display the name of a `kernel` that is being compiled, in place of the step's; an empty one at its end."""
        if self._bar is not None:
            remark = f" ({compilation_remark(kernel)})" if kernel else ""
            self._bar.update(self._task, description=self._step + remark, refresh=True)
        elif kernel and self._console.is_terminal:
            self._console.print(compilation_remark(kernel))

    def _with_bar(self, numbers: Iterable[Item], step: str) -> Iterator[Item]:
        with Progress(*Progress.get_default_columns(), _Rate(), console=self._console, transient=True) as bar:
            self._bar, self._step, self._task = bar, step, bar.add_task(step)
            try:
                yield from bar.track(numbers, task_id=self._task)
            finally:
                self._bar = None


@cache
def display() -> ConsoleDisplay:
    """Return the display on standard error."""
    return ConsoleDisplay(Console(stderr=True))


def progress(numbers: Iterable[Item], step: str) -> Iterable[Item]:
    """Display a progress bar of a step's numbers on standard error, if that is a terminal."""
    return display().progress(numbers, step)


def calibration_progress(numbers: Iterable[Item], step: str) -> Iterable[Item]:
    """Display a progress bar of the numbers of a step of a calibration, as :func:`progress`."""
    return progress(numbers, f"Calibrating: {step}")


def tracked(rows: Sequence[TrackPoint]) -> str:
    """Return the number of tracked frames among the rows of a track, and of their segments, in words."""
    segments = [row.segment for row in rows if row.state == "tracked"]
    count = len(set(segments))
    return f"{len(segments)} of {len(rows)} frames tracked in {count} segment{'s' * (count != 1)}"
