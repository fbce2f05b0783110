"""What exists on some systems only is used only there, and docs/hardware.md lists where."""

from __future__ import annotations

import ast
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "src" / "napari_elsplus"
POSIX_MODULES = {"fcntl", "resource", "termios", "pwd", "grp", "pty", "syslog"}
SYSTEM_FOLDERS = ("/proc", "/dev", "/sys")


def depends_on_the_system(path: Path) -> bool:
    """Return True if a module names its system, a module or folder of some systems, or a signal but SIGINT.

    Every system has the handlers SIG_IGN and SIG_DFL.
    """
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        match node:
            case (
                ast.Attribute(value=ast.Name(id="sys"), attr="platform")
                | ast.Attribute(value=ast.Name(id="os"), attr="name")
            ):
                return True
            case ast.Attribute(value=ast.Name(id="signal"), attr=attr) if attr.startswith("SIG") and attr not in {
                "SIGINT",
                "SIG_IGN",
                "SIG_DFL",
            }:
                return True
            case ast.Import(names=names) if {name.name for name in names} & POSIX_MODULES:
                return True
            case ast.ImportFrom(module="multiprocessing", names=names) if "resource_tracker" in {n.name for n in names}:
                return True
            case ast.Constant(value=str() as text) if text.startswith(SYSTEM_FOLDERS):
                return True
    return False


def test_the_documentation_lists_every_module_that_depends_on_the_system() -> None:
    section = (PROJECT / "docs" / "hardware.md").read_text("utf-8").partition("## Windows and macOS")[2]
    modules = [path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if depends_on_the_system(path)]
    assert len(modules) > 10
    assert [module for module in modules if f"`{module}`" not in section] == []


def test_on_windows_neither_ctrl_c_nor_a_closed_console_reaches_guardian_and_engine(monkeypatch) -> None:
    flags = {"CREATE_NEW_PROCESS_GROUP": 0x200, "CREATE_NO_WINDOW": 0x0800_0000}
    for name, value in flags.items():
        monkeypatch.setattr(subprocess, name, value, raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    detached = runpy.run_path(str(PACKAGE / "hardware" / "detached.py"))["DETACHED"]
    assert detached == {"creationflags": sum(flags.values())}


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_every_call_that_a_system_lacks_is_guarded(platform, tmp_path) -> None:
    """The types of Python's library know which functions a system has."""
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy", "--platform", platform, "--cache-dir", str(tmp_path), "src"]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout
