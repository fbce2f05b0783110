from __future__ import annotations

from types import SimpleNamespace

import pytest

from napari_elsplus.diagnosis import software
from napari_elsplus.diagnosis.finding import Finding, Level

REAL_VERSION = software.installed_version


def pretend(monkeypatch: pytest.MonkeyPatch, **versions: str | None) -> None:
    """Let the distributions named with underscores have these versions."""
    told = {name.replace("_", "-"): found for name, found in versions.items()}
    monkeypatch.setattr(software, "installed_version", lambda name: told[name] if name in told else REAL_VERSION(name))


def only(findings: list[Finding]) -> Finding:
    (finding,) = findings
    return finding


def test_this_installation_is_whole() -> None:
    findings = [finding for check in software.CHECKS for finding in check()]
    assert [finding for finding in findings if finding.level is Level.PROBLEM] == []


def test_a_package_that_is_absent_or_too_old_is_named_with_the_command() -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        pretend(monkeypatch, numba=None, tifffile="2020.1.1")
        found = {finding.what: finding.remedy for finding in software.packages()}
    assert found == {
        "numba is absent, >=0.61 needed": 'pip install "numba>=0.61"',
        "tifffile is 2020.1.1, >=2024.12.12 needed": 'pip install "tifffile>=2024.12.12"',
    }


def test_extras_are_not_required(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, PyQt6=None, PySide6_Essentials=None, genicam=None)
    assert only(list(software.packages())).level is Level.OK


def test_a_second_opencv_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, opencv_python="4.10.0")
    finding = only(list(software.one_opencv()))
    assert finding.level is Level.WARNING
    assert finding.remedy.startswith("pip uninstall --yes opencv-python opencv-contrib-python-headless")


def test_an_opencv_without_contrib_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cv2", SimpleNamespace(__version__="4.10.0"))
    finding = only(list(software.one_opencv()))
    assert finding.level is Level.PROBLEM
    assert "reg" in finding.what


def test_without_qt_the_remedy_is_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, PyQt6=None, PySide6=None, PySide6_Essentials=None)
    finding = only(list(software.qt_binding()))
    assert (finding.level, finding.remedy) == (Level.WARNING, 'pip install "napari-elsplus[pyqt]"')


def test_a_hidden_manifest_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(software, "entry_points", lambda group: ())
    assert only(list(software.plugin())).level is Level.PROBLEM


def test_kernels_that_cannot_be_kept_are_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = SimpleNamespace(stats=SimpleNamespace(cache_path=None))
    monkeypatch.setattr("napari_elsplus.processing.compiled.kernel", lambda function: compiled)
    finding = only(list(software.kernel_cache()))
    assert finding.level is Level.WARNING
    assert "NUMBA_CACHE_DIR" in finding.remedy
