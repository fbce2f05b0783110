"""``run.py``: what it installs, when it installs anew, what it starts, and how it ends."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
SCRIPT = PROJECT / "run.py"

posix_only = pytest.mark.skipif(os.name == "nt", reason="signals and roots are POSIX's")


class Recorder:
    """Stands in for ``run.run``: keeps the commands, does nothing, answers with an exit code."""

    def __init__(self, module: ModuleType) -> None:
        self.module = module
        self.commands: list[list[str]] = []
        self.environments: list[dict[str, str]] = []
        self.giving_way: list[list[str]] = []
        self.failing = ""

    def __call__(self, command: list[str], **environment: str) -> int:
        self.commands.append(command)
        self.environments.append(environment)
        if "venv" in command:
            for file in (self.module.STAMP, Path(self.module.python())):
                file.parent.mkdir(parents=True, exist_ok=True)
            Path(self.module.python()).touch()
        return 3 if self.failing and self.failing in command else 0

    @contextmanager
    def beside(
        self, command: list[str], codes: dict[str, int], name: str, *, gives_way: bool = False, **environment: str
    ) -> Iterator[None]:
        codes[name] = self(command, **environment)
        if gives_way:
            self.giving_way.append(command)
        yield

    def said(self) -> list[str]:
        return [" ".join(command) for command in self.commands]


def loaded() -> ModuleType:
    """``run.py`` as a module."""
    spec = importlib.util.spec_from_file_location("run_under_test", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """``run.py`` as a module, working on an empty folder; there is no screen."""
    module = loaded()
    for name in ("pyproject.toml", "constraints.txt"):
        (tmp_path / name).write_bytes((PROJECT / name).read_bytes())
    for name in ("VENV", "STAMP", "DEMO"):
        monkeypatch.setattr(module, name, tmp_path / getattr(module, name).relative_to(PROJECT))
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "screen_answers", lambda: False)
    monkeypatch.setattr(module, "missing_packages", lambda virtual_screen: [])
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    return module


@pytest.fixture
def recorder(run: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Recorder:
    recorder = Recorder(run)
    monkeypatch.setattr(run, "run", recorder)
    monkeypatch.setattr(run, "beside", recorder.beside)
    monkeypatch.setattr(run, "virtual_screen", lambda size: nullcontext({"DISPLAY": f":{size}"}))
    return recorder


# Old Pythons


def test_it_parses_on_python_3_8_and_needs_only_the_standard_library() -> None:
    tree = ast.parse(SCRIPT.read_text(encoding="utf-8"), feature_version=(3, 8))
    imported = {
        alias.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    }
    imported |= {(node.module or "").split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported <= sys.stdlib_module_names


def test_an_old_python_is_told_in_one_line(
    run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run.sys, "version_info", (3, 8, 18, "final", 0))
    assert run.main([]) == 1
    said = capsys.readouterr().err
    assert said == "napari-elsplus needs Python 3.11 or newer, this is 3.8: start run.py with a newer one\n"
    assert recorder.commands == []


def test_the_oldest_python_is_the_one_of_the_package(run: ModuleType) -> None:
    stated = re.search(r'requires-python = ">=(\d+)\.(\d+)"', (PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    assert stated
    assert tuple(map(int, stated.groups())) == run.OLDEST_PYTHON


# The .venv


def test_pip_is_upgraded_before_dependency_groups_and_the_stamp_comes_last(run: ModuleType, recorder: Recorder) -> None:
    stamped = []
    run_of_recorder = recorder.__call__

    def watched(command: list[str], **environment: str) -> int:
        stamped.append(run.STAMP.exists())
        return run_of_recorder(command, **environment)

    run.run = watched
    run.prepare("lint", "test")
    making, upgrading, installing, compiling = recorder.said()
    assert "-m venv --clear" in making
    assert "--upgrade pip" in upgrading
    assert "--no-compile" in installing
    assert compiling.endswith(run.COMPILE)
    words = "--constraint constraints.txt --editable .[pyqt,video,zarr,batch,genicam] --group lint --group test"
    assert words in installing
    assert stamped == [False, False, False, False]
    assert run.STAMP.exists()


def test_groups_are_added_without_a_rebuild_and_kept(run: ModuleType, recorder: Recorder) -> None:
    run.prepare("lint")
    recorder.commands.clear()
    run.prepare("test")
    installing, _ = recorder.said()
    assert installing.endswith("--group lint --group test")
    assert run.installed_groups() == {"lint", "test"}


def test_what_was_installed_is_compiled_but_for_what_is_no_python(run: ModuleType, tmp_path: Path) -> None:
    installed = tmp_path / "installed"
    installed.mkdir()
    (installed / "module.py").write_text("x = 1\n")
    (installed / "template.py").write_text("x = {{ x }\n")
    code = f"import sysconfig; sysconfig.get_path = lambda name: {str(installed)!r}; {run.COMPILE}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    (compiled,) = installed.glob("__pycache__/*.pyc")
    assert compiled.name.startswith("module.")


@pytest.mark.parametrize("change", ["pyproject.toml", "constraints.txt", "python", "interpreter", "stamp", "place"])
def test_a_stale_or_unfinished_venv_is_rebuilt(
    change: str, run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.prepare()
    if change.endswith((".toml", ".txt")):
        with (run.ROOT / change).open("a", encoding="utf-8") as file:
            file.write("\n# changed\n")
    elif change == "python":
        monkeypatch.setattr(run.sys, "version", "3.99.0 (another build)")
    elif change == "interpreter":
        Path(run.python()).unlink()
    elif change == "stamp":
        run.STAMP.write_text('{"finger', encoding="utf-8")
    else:
        (run.ROOT / "moved").mkdir()
        for name in ("pyproject.toml", "constraints.txt"):
            (run.ROOT / "moved" / name).write_bytes((run.ROOT / name).read_bytes())
        monkeypatch.setattr(run, "ROOT", run.ROOT / "moved")
    recorder.commands.clear()
    run.prepare()
    assert "-m venv --clear" in recorder.said()[0]


@pytest.mark.parametrize("failing", ["venv", "--upgrade", "--editable"])
def test_an_installation_that_failed_leaves_no_stamp_and_its_exit_code(
    failing: str, run: ModuleType, recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder.failing = failing
    assert run.main([]) == 3
    assert not run.STAMP.exists()
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_an_interrupted_addition_leaves_no_stamp(run: ModuleType, recorder: Recorder) -> None:
    run.prepare()
    recorder.failing = "--editable"
    with pytest.raises(run.Stop):
        run.prepare("test")
    assert run.installed_groups() is None


def test_children_do_not_see_what_leads_them_out_of_the_venv(run: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PYTHONHOME", "PYTHONPATH", "PIP_USER", "PIP_TARGET", "PYTHONDONTWRITEBYTECODE"):
        monkeypatch.setenv(name, "elsewhere")
    assert "elsewhere" not in run.environment().values()
    assert run.environment(NAPARI_CONFIG="here")["NAPARI_CONFIG"] == "here"


# The two commands


def test_with_a_screen_napari_opens(run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "screen_answers", lambda: True)
    assert run.main([]) == 0
    assert recorder.commands[-1] == [run.python(), "-m", "napari_elsplus._window"]


@pytest.mark.parametrize(
    ("failing", "warm_up"), [("", ["acquire", "mosaic"]), ("acquire", ["acquire"]), ("mosaic", ["acquire", "mosaic"])]
)
def test_kernels_are_compiled_after_an_installation_and_napari_opens_anyway(
    run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, failing: str, warm_up: list[str]
) -> None:
    monkeypatch.setattr(run, "screen_answers", lambda: True)
    recorder.failing = failing
    assert run.main([]) == 0
    compiled = [command[1] for command in recorder.commands if command[0] == run.program()]
    assert compiled == warm_up
    assert recorder.commands[-1] == [run.python(), "-m", "napari_elsplus._window"]
    before = len(recorder.commands)
    assert run.main([]) == 0
    assert len(recorder.commands) == before + 1


def test_without_one_the_demonstration_runs_and_says_where_the_results_lie(
    run: ModuleType, recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run.main([]) == 0
    assert recorder.commands[-1][1:] == ["demo", "--out", str(run.DEMO), "--force"]
    assert capsys.readouterr().out.splitlines()[-1] == f"the results lie in {run.DEMO}"


def test_the_demonstrations_exit_code_is_passed_on(run: ModuleType, recorder: Recorder) -> None:
    recorder.failing = "demo"
    assert run.main([]) == 3


def test_a_display_that_does_not_answer_for_lack_of_libraries_gets_them(
    run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(run, "missing_packages", lambda virtual_screen: ["libegl1"])
    monkeypatch.setattr(run, "system_packages", lambda packages, purpose: recorder(["apt", *packages]))
    monkeypatch.setattr(run, "screen_answers", lambda: ["apt", "libegl1"] in recorder.commands)
    assert run.main([]) == 0
    assert recorder.commands[-1][1:] == ["-m", "napari_elsplus._window"]


@pytest.mark.parametrize(("arguments", "selects"), [(["test"], True), (["test", "--all"], False)])
def test_tests_run_every_check(arguments: list[str], selects: bool, run: ModuleType, recorder: Recorder) -> None:
    assert run.main(arguments) == 0
    said = "\n".join(recorder.said())
    for check in ("ruff check .", "ruff format --check .", "-m mypy", "npe2 validate", "-m pytest"):
        assert check in said
    assert ("-m not slow" in said) is selects
    assert recorder.environments[-1]["NAPARI_STRICT_QT"] == "1"
    assert not Path(recorder.environments[-1]["NAPARI_CONFIG"]).exists()


@pytest.mark.parametrize("screen", [True, False])
def test_every_test_runs_once_as_computation_in_two_processes_or_in_turn(
    screen: bool, run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run.sys, "platform", "linux")
    monkeypatch.setattr(run, "screen_answers", lambda: screen)
    run.main(["test"])
    (first,) = (at for at, command in enumerate(recorder.commands) if command[-1] == "mypy")
    types, plugin, live, _, *tests = recorder.commands[first:]
    assert (types[-1], plugin[3], live[1]) == ("mypy", "validate", "acquire")
    cache = recorder.environments[first + 2]["ELSPLUS_CACHE"]
    environments = recorder.environments[first + 4 :]
    assert {environment["ELSPLUS_TEST_CACHE"] for environment in environments} == {cache}
    of_computation, in_turn, *in_two = tests  # on a screen, windows would take the keyboard from each other
    assert len(in_two) == (not screen)
    assert environments[1].get("DISPLAY") == (None if screen else ":1280x1024")
    assert recorder.giving_way == [of_computation]
    assert ["OMP_NUM_THREADS" in environment for environment in environments] == [True, False, True][: len(tests)]
    assert ("src" in of_computation, "tests" in in_turn) == (True, True)
    for command in (of_computation, *in_two):
        (workers,) = (word for word in command if word.startswith(("--numprocesses=2", "--tx=2*")))
        assert ("xvfb-run" in workers) != screen
    for path in run.PURE + run.PATIENT:
        assert (PROJECT / path).exists()
        assert sum(path in command for command in tests) == (path in run.PURE or not screen)
        assert (path in of_computation) == (path in run.PURE)
        assert (f"--ignore={path}" in in_turn) == (path in run.PURE or not screen)


def test_tests_of_times_devices_and_losses_have_the_computer_alone(run: ModuleType) -> None:
    alone = (
        "acquisition/engine/test_engine.py", "acquisition/engine/test_misbehaving_clock.py",
        "acquisition/link/test_defects.py", "acquisition/link/test_in_time.py",
        "acquisition/link/test_transactions.py", "acquisition/streaming", "examples/test_live_example.py",
        "hardware/daq", "hardware/test_guardian.py", "safety/test_promises.py",
        "widgets/live/test_no_loss.py", "widgets/live/test_rehearsal.py", "widgets/live_mosaic/test_every_frame.py",
    )  # fmt: skip
    for path in alone:
        assert (PROJECT / "tests" / path).exists()
        for shared in run.PURE + run.PATIENT:
            assert not (PROJECT / "tests" / path).is_relative_to(PROJECT / shared)


def test_what_runs_beside_is_told_at_its_end_with_its_exit_code(
    run: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    codes: dict[str, int] = {}
    command = [sys.executable, "-c", "import os; print(os.environ['WORD']); raise SystemExit(4)"]
    with run.beside(command, codes, "types", WORD="told"):
        run.say("meanwhile")
    assert codes == {"types": 4}
    assert capsys.readouterr().out == "meanwhile\n== types\ntold\n"


@posix_only
@pytest.mark.parametrize("gives_way", [True, False])
def test_what_gives_way_has_a_lower_priority_with_all_that_it_starts(
    gives_way: bool, run: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    asks = "import os; print(os.nice(0))"
    command = [sys.executable, "-c", f"import subprocess; subprocess.run([{sys.executable!r}, '-c', {asks!r}])"]
    with run.beside(command, {}, "priority", gives_way=gives_way):
        pass
    own = os.nice(0)
    assert capsys.readouterr().out == f"== priority\n{min(own + 10, 19) if gives_way else own}\n"


def test_what_runs_beside_ends_with_an_interruption(run: ModuleType) -> None:
    begun_s = time.monotonic()
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    with pytest.raises(KeyboardInterrupt), run.beside(sleeping, {}, "types"):
        raise KeyboardInterrupt
    assert time.monotonic() - begun_s < 30


def test_one_check_that_fails_does_not_hide_the_others(
    run: ModuleType, recorder: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder.failing = "mypy"
    assert run.main(["test"]) == 3
    assert "-m pytest" in recorder.said()[-1]
    assert capsys.readouterr().err == "run.py: failed: mypy\n"


DRAWS = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location("run_under_test", sys.argv[1])
run = importlib.util.module_from_spec(spec)
spec.loader.exec_module(run)
drawn = "import os, time; print(os.environ['DISPLAY'], flush=True); time.sleep(60)"
with run.virtual_screen("640x480") as screen:
    run.run([sys.executable, "-c", drawn], **screen)
"""


@pytest.mark.skipif(not shutil.which("xvfb-run"), reason="no Xvfb is installed")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGKILL"])
def test_no_virtual_screen_is_left_behind(name: str) -> None:
    """Before: a run that was terminated left its screen, and the tests that were drawn on it, for ever."""
    command = [sys.executable, "-c", DRAWS, str(SCRIPT)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, start_new_session=True, **pipes) as drawing:
        assert drawing.stdout is not None
        lock = Path(f"/tmp/.X{drawing.stdout.readline().strip().removeprefix(':')}-lock")
        assert lock.exists()
        interrupted = name == "SIGINT"  # by a terminal, which interrupts all of its processes
        (os.killpg if interrupted else os.kill)(drawing.pid, getattr(signal, name))
        drawing.wait(60)
        end_s = time.monotonic() + 30
        while lock.exists() and time.monotonic() < end_s:
            time.sleep(0.05)
        assert not lock.exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has Xvfb")
def test_screens_are_drawn_on_a_virtual_screen_with_settings_of_their_own(
    run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "missing_packages", lambda virtual_screen: [])
    assert run.main(["screens", "--out", "pictures"]) == 0
    assert recorder.environments[-1]["DISPLAY"] == ":1920x1200"
    assert recorder.commands[-1] == [run.python(), "-m", "benchmarks.screens", "--out", "pictures"]
    assert not Path(recorder.environments[-1]["NAPARI_CONFIG"]).exists()


def test_the_rig_is_run_alone_and_its_exit_code_is_passed_on(run: ModuleType, recorder: Recorder) -> None:
    recorder.failing = "rig"
    assert run.main(["test", "--rig"]) == 3
    assert recorder.commands[-1] == [run.python(), "-m", "rig"]
    assert recorder.environments[-1] == {"PYTHONPATH": str(run.ROOT / "tests")}


@posix_only
def test_the_rig_without_its_packages_prints_the_line_that_installs_them(tmp_path: Path) -> None:
    paths = {"PYTHONPATH": os.pathsep.join(str(PROJECT / folder) for folder in ("src", "tests")), "PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "rig"], env=os.environ | paths, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert "sudo apt-get install --no-install-recommends qemu-system-x86 busybox-static kmod aravis-tools-cli" in line


@pytest.mark.parametrize(
    "words", [["list"], ["line", "--out", "results", "--quick"], ["docs", "--only", "line"], ["--help"]]
)
def test_benchmarks_get_their_arguments_and_run_in_the_users_folder(
    words: list[str], run: ModuleType, recorder: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run.main(["bench", *words]) == 0
    assert recorder.commands[-1] == [run.python(), "-m", "benchmarks", *words]
    assert recorder.environments[-1] == {"folder": tmp_path, "PYTHONPATH": str(run.ROOT)}


def test_a_benchmarks_exit_code_is_passed_on(run: ModuleType, recorder: Recorder) -> None:
    recorder.failing = "benchmarks"
    assert run.main(["bench", "nothing"]) == 3


def test_the_benchmarks_are_found_from_another_folder(run: ModuleType, tmp_path: Path) -> None:
    command = [sys.executable, "-c", "import benchmarks, pathlib; pathlib.Path('found').touch()"]
    assert run.run(command, folder=tmp_path, PYTHONPATH=str(PROJECT)) == 0
    assert (tmp_path / "found").exists()


def test_an_unknown_word_is_refused(run: ModuleType, recorder: Recorder) -> None:
    with pytest.raises(SystemExit) as left:
        run.main(["tset"])
    assert left.value.code == 2
    assert recorder.commands == []


# System packages


@posix_only
def test_root_has_missing_packages_installed(
    run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(run.os, "geteuid", lambda: 0)
    run.system_packages(["libegl1", "xvfb"], "a window")
    assert recorder.said()[0].startswith("apt-get update")
    assert recorder.said()[1].endswith("--no-install-recommends libegl1 xvfb")
    assert recorder.environments[1] == {"DEBIAN_FRONTEND": "noninteractive"}
    assert "apt-get install --yes --no-install-recommends libegl1 xvfb" in capsys.readouterr().out


@posix_only
@pytest.mark.parametrize(
    ("has_apt", "line"),
    [
        (True, "sudo apt-get update && sudo apt-get install --yes --no-install-recommends libegl1"),
        (False, "what Debian calls libegl1"),
    ],
)
def test_anyone_else_is_told_the_line(
    has_apt: bool, line: str, run: ModuleType, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run.shutil, "which", lambda name: f"/usr/bin/{name}" if has_apt else None)
    monkeypatch.setattr(run.os, "geteuid", lambda: 1000)
    with pytest.raises(run.Stop, match=re.escape(line)):
        run.system_packages(["libegl1"], "a window")
    assert recorder.commands == []


def test_a_library_is_missing_when_it_does_not_load(monkeypatch: pytest.MonkeyPatch) -> None:
    module = loaded()
    assert not module.loads("libnosuchthing.so.9")
    monkeypatch.setattr(module, "loads", lambda library: library != "libxcb-cursor.so.0")
    assert module.missing_packages(virtual_screen=False) == ["libxcb-cursor0"]
    monkeypatch.setattr(module.shutil, "which", lambda name: None)
    assert module.missing_packages(virtual_screen=True)[-2:] == ["xauth", "xvfb"]


# Processes


def test_a_childs_exit_code_is_ours(run: ModuleType) -> None:
    assert run.run([sys.executable, "-c", "raise SystemExit(7)"]) == 7


@posix_only
def test_a_child_that_a_signal_ended_counts_as_in_a_shell(run: ModuleType) -> None:
    assert run.run([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"]) == 137


CHILD = """
import pathlib, signal, sys, time
marks = pathlib.Path(sys.argv[1])
def end(*_):
    marks.with_suffix(".ended").touch()
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
signal.signal(signal.SIGINT, end)
marks.with_suffix(".started").touch()
time.sleep(60)
"""


@posix_only
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_ends_the_child_cleanly(number: signal.Signals, code: int, tmp_path: Path) -> None:
    marks = tmp_path / "child"
    parent = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location("run", {str(SCRIPT)!r})
run = importlib.util.module_from_spec(spec)
spec.loader.exec_module(run)
run.start = lambda: run.run([sys.executable, "-c", {CHILD!r}, {str(marks)!r}])
sys.exit(run.main([]))
"""
    process = subprocess.Popen([sys.executable, "-c", parent], start_new_session=True, stderr=subprocess.PIPE)
    until = time.monotonic() + 30
    while not marks.with_suffix(".started").exists() and time.monotonic() < until:
        time.sleep(0.02)
    if number is signal.SIGINT:
        os.killpg(process.pid, number)  # a terminal tells everyone in the foreground
    else:
        process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == code
    assert marks.with_suffix(".ended").exists()
    assert said.decode() == ("run.py: interrupted\n" if code else "")


# The files beside it


def test_constraints_are_exact_versions_and_nothing_else() -> None:
    lines = (PROJECT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.!+]+", line)] == []
    names = [line.partition("==")[0].lower() for line in lines]
    assert len(names) == len(set(names))
    assert {"napari", "numpy", "numba", "pyqt6", "pytest", "ruff"} <= set(names)


def test_continuous_integration_installs_the_dissector_and_runs_the_tests() -> None:
    lines = (PROJECT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["#!/usr/bin/env bash", "set -e"]
    assert lines[-1] == "python3 run.py test"
    installed = [line.split() for line in lines if "install" in line.split()]
    assert [line[line.index("--no-install-recommends") + 1] for line in installed] == ["tshark;"]
