from __future__ import annotations

import pytest
from click.testing import CliRunner

from napari_elsplus import diagnosis
from napari_elsplus.cli.rig import doctor
from napari_elsplus.diagnosis.finding import Finding, ok, problem, warning


def told(monkeypatch: pytest.MonkeyPatch, *findings: Finding) -> tuple[int, list[str]]:
    monkeypatch.setattr(diagnosis, "diagnose", lambda: iter(findings))
    result = CliRunner().invoke(doctor.command)
    return result.exit_code, result.output.splitlines()


def test_warnings_leave_the_software_usable(monkeypatch: pytest.MonkeyPatch) -> None:
    code, lines = told(monkeypatch, ok("Python 3.12"), warning("no screen", "use a desktop"))
    assert code == 0
    assert lines == ["ok       Python 3.12", "warning  no screen: use a desktop", "ready for use (1 warning)"]


def test_a_problem_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    code, lines = told(monkeypatch, problem("numba is absent", "pip install numba"), ok("the rest"))
    assert code == 1
    assert lines[-1] == "not fit for use (1 problem)"


def test_here_every_finding_that_is_not_ok_has_a_remedy() -> None:
    findings = list(diagnosis.diagnose())
    assert len(findings) >= 10
    assert [finding for finding in findings if finding.level != "ok" and not finding.remedy] == []
