from __future__ import annotations

import re
import subprocess
import sys
from io import StringIO
from time import sleep

import click
import pytest
from rich.console import Console

import napari_elsplus
from napari_elsplus.cli import COMMANDS, elsplus, main
from napari_elsplus.cli.options import ConsoleDisplay
from napari_elsplus.cli.rig import window
from napari_elsplus.diagnosis.machine import Screen
from napari_elsplus.errors import InputError


def leaves(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and what was said on standard error."""
    with pytest.raises(SystemExit) as left:
        main(arguments)
    return int(left.value.code or 0), capsys.readouterr().err


def test_the_command_is_a_module_as_well() -> None:
    run = subprocess.run([sys.executable, "-m", "napari_elsplus", "--help"], capture_output=True, text=True)
    assert run.returncode == 0
    assert run.stdout.startswith("Usage: napari-elsplus")


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("0 frames in a.tif", "record again"), 2, "napari-elsplus: 0 frames in a.tif: record again\n"),
        (FileNotFoundError(2, "No such file", "a.tif"), 2, "napari-elsplus: a.tif: No such file: check the path"),
        (KeyboardInterrupt(), 130, "napari-elsplus: interrupted\n"),
    ],
)
def test_what_a_user_can_mend_is_one_line(
    error: BaseException, code: int, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise error

    monkeypatch.setattr(window, "open_window", fail)
    left, said = leaves([], capsys)
    assert left == code
    assert said.lstrip("\n").startswith(line)
    assert len(said.strip().splitlines()) == 1


def test_a_defect_of_ours_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(window, "open_window", fail)
    with pytest.raises(ZeroDivisionError):
        main([])


def test_an_unknown_command_exits_2(capsys: pytest.CaptureFixture[str]) -> None:
    code, said = leaves(["mosiac"], capsys)
    assert code == 2
    assert "mosiac" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str) -> None:
    context = click.Context(elsplus, info_name="napari-elsplus")
    command = elsplus.get_command(context, name)
    assert command is not None
    assert command.get_short_help_str()
    assert elsplus.get_command(context, name.upper()) is None


def test_without_a_screen_it_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(window, "probe_screen", lambda: Screen(False, "DISPLAY is not set"))
    code, said = leaves([], capsys)
    assert code == 2
    assert said.startswith("napari-elsplus: no window can be opened (DISPLAY is not set): start it on a desktop")


def test_with_a_screen_it_opens_napari(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(window, "probe_screen", lambda: Screen(True, "xcb"))
    monkeypatch.setattr(window.runpy, "run_module", lambda name, run_name: opened.append(name))
    main([])
    assert opened == ["napari_elsplus._window"]


@pytest.mark.parametrize(("argument", "code"), [("--version", 0), ("--help", 0), ("--wrong", 2), ("mosiac", 2)])
def test_version_help_and_errors_load_nothing_heavy(argument: str, code: int) -> None:
    program = (
        "import sys; from napari_elsplus.cli import main\n"
        f"try: main([{argument!r}])\n"
        "finally: print([m for m in ('napari', 'qtpy', 'cv2', 'numba', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (code, "[]")
    if argument == "--version":
        assert done.stdout.startswith(f"napari-elsplus, version {napari_elsplus.__version__}\n")


GROUPS = {"simulate": ["recording", "axial", "calibration"]}
"""Commands that have commands of their own."""
QUICK = [words for name in COMMANDS for words in ([name], *([name, sub] for sub in GROUPS.get(name, [])))]


def test_wrong_options_are_refused_before_numerics_are_imported() -> None:
    run = (
        "import sys; from napari_elsplus.cli import main\n"
        f"for words in {QUICK}:\n"
        "    try: main([*words, '--wrong'])\n"
        "    except SystemExit as end: assert end.code == 2, words\n"
        "print([m for m in ('napari', 'qtpy', 'cv2', 'numba', 'numpy', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr.count("No such option '--wrong'") == len(QUICK)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_kernel_that_is_compiled_is_named_on_a_terminal(terminal: bool) -> None:
    console = Console(file=StringIO(), force_terminal=terminal, width=120)
    display = ConsoleDisplay(console)
    display.compiling("before")
    for _ in display.progress(range(2), "Tracking"):
        display.compiling("align")
        display.compiling("")
    written = console.file.getvalue()
    assert ("compiling before, once after an installation" in written) == terminal
    assert ("Tracking (compiling align, once after an installation)" in written) == terminal


def test_a_progress_bar_displays_steps_in_a_second() -> None:
    console = Console(file=StringIO(), force_terminal=True, width=120)
    for _ in ConsoleDisplay(console).progress(range(50), "els"):
        sleep(0.01)
    rates = [float(rate) for rate in re.findall(r"([\d.]+)/s", console.file.getvalue())]
    assert rates
    assert 10 < rates[-1] < 110  # rich starts its clock within the first step
