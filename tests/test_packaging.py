"""What users install: the wheel and the sdist hold what they should, and napari finds the plugin in them."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import napari_elsplus

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
INPUTS = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "napari.yaml", "src", "tests")


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a wheel, made from an sdist, made from what is committed or about to be."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for name in INPUTS:
        if (PROJECT / name).is_dir():
            shutil.copytree(PROJECT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(PROJECT / name, source / name, follow_symlinks=False)
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(built), str(source)]
    done = subprocess.run(build, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return built


@pytest.fixture(scope="module")
def wheel(distributions: Path) -> zipfile.ZipFile:
    (path,) = distributions.glob("*.whl")
    return zipfile.ZipFile(path)


def test_the_wheel_holds_the_package_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert {"napari_elsplus/py.typed", "napari_elsplus/napari.yaml", "napari_elsplus/_window.py"} <= names
    dist_info = f"napari_elsplus-{napari_elsplus.__version__}.dist-info"
    assert {name.partition("/")[0] for name in names} == {"napari_elsplus", dist_info}
    sources = {str(path.relative_to(PROJECT / "src")) for path in (PROJECT / "src").rglob("*.py")}
    assert sources == {str(Path(name)) for name in names if name.endswith(".py")}


def test_the_sdist_holds_the_tests_and_a_manifest_that_can_be_read(distributions: Path) -> None:
    (path,) = distributions.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"tests/test_packaging.py", "src/napari_elsplus/napari.yaml", "LICENSE", "README.md"} <= names


def test_napari_finds_the_plugin_in_an_installed_wheel(
    wheel: zipfile.ZipFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Away from the checkout: only what the wheel holds is on the path for ours."""
    wheel.extractall(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code = """
import json, npe2, napari_elsplus
manager = npe2.PluginManager()
manager.discover()
manifest = manager.get_manifest("napari-elsplus")
print(json.dumps([napari_elsplus.__file__, manifest.package_version, manifest.display_name]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    file, version, display_name = json.loads(done.stdout)
    assert Path(file).is_relative_to(tmp_path)
    assert version == napari_elsplus.__version__
    assert display_name == "ELS+ endomicroscopy"


def test_what_the_manifest_names_exists() -> None:
    from npe2 import PluginManifest

    manifest = PluginManifest.from_file(PROJECT / "src" / "napari_elsplus" / "napari.yaml")
    manifest.validate_imports()


def test_qt_is_asked_for_only_in_extras() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert not [need for need in project["dependencies"] if re.match(r"pyqt[56]|pyside", need, re.IGNORECASE)]
    assert set(project["optional-dependencies"]) == {"pyqt", "pyside", "genicam", "mmcore", "video", "zarr", "batch"}


def test_every_constraint_lies_within_its_bound() -> None:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    pyproject = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = (PROJECT / "constraints.txt").read_text(encoding="utf-8").split()
    pinned = {canonicalize_name(name): version for name, _, version in (line.partition("==") for line in lines)}
    extras = pyproject["project"]["optional-dependencies"]
    stated = [*pyproject["project"]["dependencies"], *extras["pyqt"], *extras["video"], *extras["zarr"]]
    stated += [*pyproject["dependency-groups"]["lint"], *pyproject["dependency-groups"]["test"]]
    needs = [Requirement(line) for line in stated]
    outside = [need for need in needs if not need.specifier.contains(pinned.get(canonicalize_name(need.name), "0"))]
    assert outside == []


def test_the_workflows_cover_what_we_promise() -> None:
    folder = PROJECT / ".github" / "workflows"
    test, release = (
        yaml.safe_load((folder / name).read_text(encoding="utf-8")) for name in ("test.yml", "release.yml")
    )
    matrix = test["jobs"]["test"]["strategy"]["matrix"]
    classifiers = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    promised = {version for line in classifiers if (version := line.rpartition(" :: ")[2]).startswith("3.")}
    assert set(matrix["python"]) == promised
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "windows", "macos"}
    assert {"pyqt", "pyside"} == {*matrix["qt"], *(extra["qt"] for extra in matrix["include"])}
    assert {"lint", "newcomer", "oldest", "distributions"} <= set(test["jobs"])
    publish = release["jobs"]["publish"]
    assert publish["permissions"] == {"id-token": "write"}
    assert not [step for step in publish["steps"] if "password" in step.get("with", {})]


def test_the_workflow_installs_the_packages_that_run_py_knows() -> None:
    names = set(re.findall(r'"((?:lib|x)[a-z0-9-]+)": "', (PROJECT / "run.py").read_text(encoding="utf-8")))
    workflow = yaml.safe_load((PROJECT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8"))
    assert set(workflow["env"]["QT_PACKAGES"].split()) == names | {"libgl1-mesa-dri"}


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = yaml.safe_load((PROJECT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == napari_elsplus.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert "enhanced line-scanning" in citation["references"][0]["title"]


def test_the_changelog_has_a_place_for_what_comes_next() -> None:
    headings = re.findall(r"^## \[(.+?)\]", (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert headings[0] == "Unreleased"


def test_the_conda_recipe_asks_for_what_the_package_needs() -> None:
    """Names differ in few places; bounds do not."""
    from packaging.requirements import Requirement

    renamed = {
        "dask": "dask-core",
        "libusb-package": "libusb",
        "matplotlib": "matplotlib-base",
        "napari": "napari-base",
        "nidaqmx": "nidaqmx-python",
        "opencv-contrib-python-headless": "py-opencv",
    }
    needs = map(Requirement, tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"])
    recipe = (PROJECT / "conda.recipe" / "meta.yaml").read_text(encoding="utf-8")
    assert f'version = "{napari_elsplus.__version__}"' in recipe
    run = recipe.partition("  run:\n")[2].partition("  run_constrained:")[0]
    asked = dict(re.findall(r"- ([\w-]+) >=([\d.]+)", run))
    bounds = {renamed.get(need.name, need.name): next(iter(need.specifier)).version for need in needs}
    assert {name for name, bound in bounds.items() if not bound.startswith(asked.get(name, "absent"))} == set()
