#!/usr/bin/env python3
"""Install and start napari-elsplus, or test it. Needs Python and nothing else; on Windows say ``py`` for ``python3``.

python3 run.py               opens napari with the plugin; without a screen runs the demonstration
python3 run.py test          lint, types and tests
python3 run.py test --all    the same, with the slow accuracy sweeps
python3 run.py test --rig    the camera's driver on Linux's own USB stack, in QEMU; two minutes, and Debian's packages
python3 run.py bench NAME    speed against accuracy: a benchmark's table, CSV and chart; ``bench --help`` lists all
python3 run.py bench docs    every chart and table of the documentation, measured anew
python3 run.py screens       a picture of every panel in both themes and two sizes, and a list of clipped text

What is installed goes into ``.venv`` beside this file; the first run takes some minutes, the next ones seconds.
"""

from __future__ import annotations

import argparse
import ctypes
import glob
import hashlib
import importlib.util
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

OLDEST_PYTHON = (3, 11)
INTERRUPTED = 130

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
STAMP = VENV / "elsplus-stamp.json"
DEMO = ROOT / "elsplus-demo"

NOT_FOR_CHILDREN = ("PYTHONHOME", "PYTHONPATH", "PIP_USER", "PIP_TARGET", "PYTHONDONTWRITEBYTECODE")
"""Variables that would make the .venv import, or install into, other places than itself, or compile at every start."""

COMPILE = "import compileall, sysconfig; compileall.compile_dir(sysconfig.get_path('purelib'), quiet=2, workers=0)"
"""Compiles what was installed on all cores, where pip uses one; what is not Python, such as a template, is left."""

EXTRAS = "pyqt,video,zarr,batch,genicam"
PURE = (
    "tests/processing",
    "tests/benchmarks/test_turning.py",
    "tests/benchmarks/imperfect",
    "tests/benchmarks/documents",
    "tests/benchmarks/studies",
    "tests/benchmarks/harness",
    "tests/benchmarks/rigs",
    "tests/benchmarks/test_long_process.py",
    "tests/benchmarks/test_batch.py",
    "tests/benchmarks/test_mutations.py",
    "tests/benchmarks/test_pairs.py",
    "tests/benchmarks/test_start.py",
    "tests/benchmarks/test_main.py",
    "tests/cli/files",
    "tests/workflows",
    "tests/examples/test_examples.py",
    "tests/io",
    "tests/simulation",
    "tests/acquisition/mosaic",
    "tests/safety/test_scanner_states.py",
    "tests/test_architecture.py",
    "tests/hardware/virtual",
    "tests/hardware/test_bench.py",
    "tests/examples/test_extending_registration_method.py",
    "tests/test_packaging.py",
    "tests/test_language.py",
    "tests/test_platforms.py",
    "tests/examples/test_extending_file_format.py",
    "tests/hardware/scan",
    "tests/instrument",
)
"""Tests of computation alone, with no window, device or clock: two processes share them and the doctests, and give way
to the tests in turn, which wait much."""
PATIENT = (
    "tests/widgets/test_calibration.py",
    "tests/widgets/live/test_panel.py",
    "tests/benchmarks/test_choices.py",
    "tests/widgets/analysis",
    "tests/widgets/mosaic",
    "tests/cli/rig/test_calibrate.py",
    "tests/acquisition/calibrating",
    "tests/widgets/live_mosaic/test_panel.py",
    "tests/widgets/dock",
    "tests/test_writer.py",
    "tests/cli/rig/test_acquire.py",
    "tests/widgets/test_control_extremes.py",
    "tests/acquisition/link/test_server.py",
    "tests/test_readme.py",
    "tests/acquisition/link/test_known_parking.py",
    "tests/acquisition/engine/test_watcher.py",
    "tests/examples/test_extending_calibration_step.py",
    "tests/viewing",
    "tests/test_reader.py",
    "tests/hardware/test_rigs.py",
    "tests/widgets/live/test_layers.py",
    "tests/examples/test_extending_dock_widget.py",
    "tests/test_sample_data.py",
    "tests/test_window.py",
    "tests/widgets/shared",
    "tests/widgets/test_bundle_layers.py",
    "tests/widgets/live/test_status.py",
)
"""Tests of windows and simulated rigs whose time limits are tens of seconds: on virtual screens they are shared, too.

All others, which judge times or devices, run in turn, and beside them only what gives way. The longest come first in
both groups, so that neither process ends much before the other.
"""
WINDOW_LIBRARIES = {
    "libdbus-1-3": "libdbus-1.so.3",
    "libegl1": "libEGL.so.1",
    "libgl1": "libGL.so.1",
    "libopengl0": "libOpenGL.so.0",
    "libxcb-cursor0": "libxcb-cursor.so.0",
    "libxcb-icccm4": "libxcb-icccm.so.4",
    "libxcb-image0": "libxcb-image.so.0",
    "libxcb-keysyms1": "libxcb-keysyms.so.1",
    "libxcb-randr0": "libxcb-randr.so.0",
    "libxcb-render-util0": "libxcb-render-util.so.0",
    "libxcb-shape0": "libxcb-shape.so.0",
    "libxcb-xinerama0": "libxcb-xinerama.so.0",
    "libxkbcommon-x11-0": "libxkbcommon-x11.so.0",
}
"""What a Qt window needs on Linux: Debian's package and the library that is in it."""

SCREEN_PX = "1280x1024"
"""Of the screen on which the windows are tested."""
VIRTUAL_SCREEN = {"xauth": "xauth", "xvfb": "xvfb-run"}
"""What the windows are tested on where there is no screen: Debian's package and the program that is in it."""


class Stop(Exception):
    """The end of the run: one line for the user, and the exit code."""

    def __init__(self, line: str, code: int = 1) -> None:
        super().__init__(line)
        self.code = code


# Processes ------------------------------------------------------------------------------------------------------------


def say(line: str) -> None:
    """Print at once, in step with what child processes print."""
    print(line, flush=True)


def environment(**more: str) -> dict[str, str]:
    """Give child processes our environment without what would lead them out of the .venv."""
    kept = {name: value for name, value in os.environ.items() if name not in NOT_FOR_CHILDREN}
    return {**kept, **more}


def run(command: list[str], folder: Path = ROOT, **more_environment: str) -> int:
    """Run a command to its end and give its exit code; an interruption or termination of ours reaches it."""
    child = subprocess.Popen(command, cwd=str(folder), env=environment(**more_environment))
    before = signal.signal(signal.SIGTERM, lambda *_: child.terminate())
    try:
        code = child.wait()
    except KeyboardInterrupt:  # on a terminal the child has it too, and may be parking the mirror: give it time
        try:
            child.wait(timeout=20)
        except subprocess.TimeoutExpired:
            child.terminate()
            child.wait()
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
    return code if code >= 0 else 128 - code  # as a shell counts a child that a signal ended


@contextmanager
def virtual_screen(size: str) -> Iterator[dict[str, str]]:
    """Start a virtual screen, "1280x1024", and give the environment that draws on it; it ends with us, however we end.

    Commands are not started under xvfb-run: terminated, that ends neither them nor its screen. Here it waits for the
    end of its input, which is ours.
    """
    waiting = ["sh", "-c", 'echo "$DISPLAY"; echo "$XAUTHORITY"; read -r _']
    command = ["xvfb-run", "--auto-servernum", f"--server-args=-screen 0 {size}x24", *waiting]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    screen = subprocess.Popen(command, env=environment(), text=True, start_new_session=True, **pipes)
    try:
        display, authority = (screen.stdout.readline().strip() for _ in range(2))
        if not display:
            raise Stop("run.py: no virtual screen could be started")
        yield {"DISPLAY": display, "XAUTHORITY": authority}
    finally:
        screen.communicate()


if os.name == "nt":
    GIVES_WAY = {"creationflags": subprocess.BELOW_NORMAL_PRIORITY_CLASS}
else:
    GIVES_WAY = {"preexec_fn": lambda: os.nice(10)}
"""Makes a child process, and those that it starts, give way to others; not so far that it stands still beside them."""


@contextmanager
def beside(
    command: list[str], codes: dict[str, int], name: str, *, gives_way: bool = False, **more_environment: str
) -> Iterator[None]:
    """Run a command while the body of the `with` does its work; then print what it said, and note its exit code."""
    with tempfile.TemporaryFile() as output:
        streams = {"stdout": output, "stderr": subprocess.STDOUT}
        priority = GIVES_WAY if gives_way else {}
        child = subprocess.Popen(command, cwd=str(ROOT), env=environment(**more_environment), **streams, **priority)
        try:
            yield
            codes[name] = child.wait()
        finally:
            child.kill()
            child.wait()
        output.seek(0)
        say(f"== {name}\n{output.read().decode(errors='replace')}".rstrip())


def must(what: str, command: list[str], **more_environment: str) -> None:
    """Run a command that everything after it depends on."""
    code = run(command, **more_environment)
    if code:
        raise Stop(f"run.py: {what} failed (exit {code}); what it said stands above", code)


# The .venv ------------------------------------------------------------------------------------------------------------


def python() -> str:
    """Path of the .venv's interpreter."""
    return str(VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python"))


def program() -> str:
    """Path of the plugin's command line."""
    return str(Path(python()).with_name("napari-elsplus.exe" if os.name == "nt" else "napari-elsplus"))


def fingerprint() -> str:
    """Say in one number what the .venv was made from: requirements, Python, platform, place."""
    parts = [(ROOT / name).read_bytes() for name in ("pyproject.toml", "constraints.txt")]
    parts += [text.encode() for text in (sys.version, sysconfig.get_platform(), str(ROOT))]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def installed_groups() -> set[str] | None:
    """Dependency groups that the .venv holds; None when it is absent, unfinished or stale."""
    try:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    whole = stamp.get("fingerprint") == fingerprint() and os.path.exists(python())
    return set(stamp["groups"]) if whole else None


def prepare(*groups: str) -> bool:
    """Bring the .venv up to date: the project with its Qt, and these dependency groups. Give whether it was not.

    The stamp comes last.
    """
    present = installed_groups()
    if present is not None and present.issuperset(groups):
        return False
    quiet = [] if sys.stdout.isatty() else ["-qq"]
    pip = [python(), "-m", "pip", "install", "--disable-pip-version-check", "--no-compile", *quiet]
    if present is None:
        say(f"installing into {VENV}: some minutes, the first time only")
        if importlib.util.find_spec("ensurepip") is None:
            system_packages(["python{}.{}-venv".format(*sys.version_info)], "making a .venv")
        base = getattr(sys, "_base_executable", None) or sys.executable  # this may be the .venv that is cleared
        must("making .venv", [base, "-m", "venv", "--clear", str(VENV)])
        must("upgrading pip", [*pip, "--upgrade", "pip>=25.1"])  # older ones know no dependency groups
    elif STAMP.exists():
        STAMP.unlink()
    wanted = sorted((present or set()).union(groups))
    chosen = [word for group in wanted for word in ("--group", group)]
    must("installing", [*pip, "--constraint", "constraints.txt", "--editable", f".[{EXTRAS}]", *chosen])
    run([python(), "-c", COMPILE])
    STAMP.write_text(json.dumps({"fingerprint": fingerprint(), "groups": wanted}), encoding="utf-8")
    return True


# Screen and system libraries ------------------------------------------------------------------------------------------


def warm_up(**more_environment: str) -> None:
    """Make a live and a finished mosaic: kernels are compiled, the simulated rig's calibration is remembered.

    What goes wrong is no error: the kernels are then compiled when they are needed.
    """
    say("compiling: half a minute, after an installation")
    with tempfile.TemporaryDirectory() as folder:
        raw, calibration, track, report, mosaic = (
            str(Path(folder, name))
            for name in ("raw.ome.tif", "raw.calibration.json", "track.csv", "report.json", "mosaic.ome.tif")
        )
        live = ["acquire", "--seconds", "1", "--record", raw, "--track", track, "--report", report]
        made = ["mosaic", raw, "-c", calibration, "-o", mosaic]
        if any(run([program(), *words], **more_environment) for words in (live, made)):
            say("a mosaic could not be made now: kernels are compiled when they are needed")


def screen_answers() -> bool:
    """Whether Qt, asked in a process of its own, can open a window here."""
    probe = [python(), "-m", "napari_elsplus._screen"]
    try:
        return subprocess.run(probe, env=environment(), capture_output=True, timeout=60, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def loads(library: str) -> bool:
    """Whether the system finds this shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def missing_packages(virtual_screen: bool) -> list[str]:
    """Debian packages that a window on this Linux lacks; with a virtual screen and what draws on it if asked."""
    missing = [package for package, library in WINDOW_LIBRARIES.items() if not loads(library)]
    if virtual_screen:
        if not any(map(glob.glob, ("/usr/lib/*/dri/*_dri.so", "/usr/lib*/dri/*_dri.so"))):
            missing.append("libgl1-mesa-dri")
        missing += [package for package, command in VIRTUAL_SCREEN.items() if not shutil.which(command)]
    return missing


def system_packages(packages: list[str], purpose: str) -> None:
    """Install Debian packages when root on Debian or Ubuntu; else stop with the exact line that does it."""
    install = ["apt-get", "install", "--yes", "--no-install-recommends", *packages]
    line = " ".join(install)
    if not shutil.which("apt-get"):
        raise Stop(f"run.py: {purpose} needs what Debian calls {' '.join(packages)}: install it, then start again")
    if os.geteuid() != 0:
        raise Stop(
            f"run.py: {purpose} needs system packages: run `sudo apt-get update && sudo {line}`, then start again"
        )
    say(f"{purpose} needs system packages: apt-get update && {line}")
    must("apt-get update", ["apt-get", "update", "-qq"])
    must("apt-get install", [install[0], "-qq", *install[1:]], DEBIAN_FRONTEND="noninteractive")


# The two commands -----------------------------------------------------------------------------------------------------


def start() -> int:
    """Open napari with the plugin, or run the demonstration where no window can be opened."""
    installed = prepare()
    has_window = screen_answers()
    display_named = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if not has_window and sys.platform.startswith("linux") and display_named:
        missing = missing_packages(virtual_screen=False)
        if missing:
            system_packages(missing, "a window")
            has_window = screen_answers()
    if has_window:
        if installed:
            warm_up()
        return run([python(), "-m", "napari_elsplus._window"])
    say("no screen answers: running the demonstration instead of opening napari")
    code = run([program(), "demo", "--out", str(DEMO), "--force"])
    if code == 0:
        say(f"the results lie in {DEMO}")
    return code


def test(everything: bool) -> int:
    """Lint, types, manifest and tests; every step runs, and the first failure gives the exit code."""
    prepare("lint", "test")
    pytest = [python(), "-m", "pytest", "--durations=15", *([] if everything else ["-m", "not slow"])]
    by_file, workers = ["--dist=loadfile", "--no-loadscope-reorder"], ["--numprocesses=2"]
    alone, screen = PURE, nullcontext({})
    hidden = sys.platform.startswith("linux") and not screen_answers()
    if hidden:
        missing = missing_packages(virtual_screen=True)
        if missing:
            system_packages(missing, "testing the windows")
        own = ["xvfb-run", "--auto-servernum", f"--server-args=-screen 0 {SCREEN_PX}x24", python()]
        workers = ["--tx=2*popen//python=" + shlex.join(own)]
        alone, screen = PURE + PATIENT, virtual_screen(SCREEN_PX)
    of_computation = [*pytest, *workers, *by_file, *PURE, "src"]
    in_two = [*pytest, *workers, *by_file, *PATIENT]
    in_turn = [*pytest, "tests", *(f"--ignore={path}" for path in alone)]
    steps = (
        ("ruff check", [python(), "-m", "ruff", "check", "."]),
        ("ruff format", [python(), "-m", "ruff", "format", "--check", "."]),
    )
    plugin = [python(), "-m", "npe2", "validate", "--imports", "napari-elsplus"]
    codes = {}
    with tempfile.TemporaryDirectory() as folder:
        more = {"NAPARI_CONFIG": str(Path(folder, "settings.yaml")), "NAPARI_STRICT_QT": "1"}
        cache = more["ELSPLUS_TEST_CACHE"] = str(Path(folder, "cache"))  # the simulated rig is prepared once for all
        one_core = {"OMP_NUM_THREADS": "1", **more}
        for name, command in steps:
            say(f"== {name}")
            codes[name] = run(command, **more)
        say("== mypy and npe2 validate, while kernels are compiled")
        types = beside([python(), "-m", "mypy"], codes, "mypy", **more)
        with types, beside(plugin, codes, "npe2 validate", **more):
            warm_up(ELSPLUS_CACHE=cache, ELSPLUS_CONFIG=str(Path(folder, "settings")), **more)
        say("== pytest in turn, and of computation in the time that this leaves")
        rest = beside(of_computation, codes, "pytest of computation", gives_way=True, **one_core)
        with rest, screen as display:
            codes["pytest in turn"] = run(in_turn, **more, **display)
        if hidden:
            say("== pytest in two processes")
            codes["pytest in two processes"] = run(in_two, **one_core)
    failed = [name for name, code in codes.items() if code]
    if failed:
        raise Stop(f"run.py: failed: {', '.join(failed)}", codes[failed[0]])
    return 0


def rig() -> int:
    """Run the camera's driver, and aravis, against the virtual camera on the bus of a kernel in QEMU."""
    prepare()
    return run([python(), "-m", "rig"], PYTHONPATH=str(ROOT / "tests"))


def bench(arguments: list[str]) -> int:
    """Run the benchmarks' own command line in the user's folder, so that relative paths are the user's."""
    prepare()
    return run([python(), "-m", "benchmarks", *arguments], folder=Path.cwd(), PYTHONPATH=str(ROOT))


def screens(arguments: list[str]) -> int:
    """Draw every panel, on a virtual screen, so that nothing appears on a desk and the sizes are what was asked for."""
    prepare()
    command, screen = [python(), "-m", "benchmarks.screens", *arguments], nullcontext({})
    if sys.platform.startswith("linux"):
        missing = missing_packages(virtual_screen=True)
        if missing:
            system_packages(missing, "drawing the windows")
        screen = virtual_screen("1920x1200")
    with tempfile.TemporaryDirectory() as folder, screen as display:
        settings = str(Path(folder, "settings.yaml"))
        return run(command, folder=Path.cwd(), PYTHONPATH=str(ROOT), NAPARI_CONFIG=settings, **display)


def main(arguments: list[str] | None = None) -> int:
    """Do what the command line asks and give the exit code."""
    if sys.version_info < OLDEST_PYTHON:
        print(
            "napari-elsplus needs Python {}.{} or newer, this is {}.{}: start run.py with a newer one".format(
                *OLDEST_PYTHON, *sys.version_info[:2]
            ),
            file=sys.stderr,
        )
        return 1
    parser = argparse.ArgumentParser(prog="run.py", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", metavar="test | bench | screens")
    testing = commands.add_parser("test", help="lint, types and tests")
    testing.add_argument("--all", action="store_true", help="with the slow accuracy sweeps")
    testing.add_argument("--rig", action="store_true", help="only the camera's driver on a kernel in QEMU")
    commands.add_parser("bench", help="speed against accuracy", add_help=False)
    commands.add_parser("screens", help="a picture of every panel", add_help=False)
    options, rest = parser.parse_known_args(arguments)
    if rest and options.command not in ("bench", "screens"):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    try:
        if options.command == "bench":
            return bench(rest)
        if options.command == "screens":
            return screens(rest)
        if options.command == "test":
            return rig() if options.rig else test(options.all)
        return start()
    except Stop as stop:
        print(stop, file=sys.stderr)
        return stop.code
    except KeyboardInterrupt:
        print("run.py: interrupted", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
