"""The documentation's pages: all in the navigation and the index, links lead somewhere, references can be imported."""

from __future__ import annotations

import re
import unicodedata
from importlib import import_module
from pathlib import Path

import pytest
import yaml

pytestmark = pytest.mark.checkout

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = sorted(path.name for path in DOCS.glob("*.md"))


def navigation(entries: object) -> set[str]:
    if isinstance(entries, str):
        return {entries}
    values = entries.values() if isinstance(entries, dict) else entries
    return {page for value in values for page in navigation(value)}  # type: ignore[union-attr]


def test_every_page_is_in_the_navigation_and_in_the_index() -> None:
    nav = navigation(yaml.safe_load((DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    assert nav == set(PAGES)
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\(([a-z-]+\.md)\)", index)) | {"index.md"} == set(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_lead_somewhere(page: str) -> None:
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", (DOCS / page).read_text(encoding="utf-8"))
    assert [target for target in targets if "://" not in target and not (DOCS / target).exists()] == []


def headings(page: Path) -> set[str]:
    """The anchors of a page's headings, as Python-Markdown makes them."""
    found = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = (unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode() for text in found)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", text).strip().lower()) for text in plain}


@pytest.mark.parametrize("page", [*PAGES, "../README.md"])
def test_links_to_a_part_of_a_page_name_a_heading_of_it(page: str) -> None:
    links = re.findall(r"\]\(([\w/-]*(?:\.md)?)#([\w-]+)\)", (DOCS / page).read_text(encoding="utf-8"))
    assert [link for link in links if link[1] not in headings((DOCS / page).parent / (link[0] or DOCS / page))] == []


@pytest.mark.parametrize("page", PAGES)
def test_tests_that_a_page_names_exist(page: str) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (DOCS / page).read_text(encoding="utf-8"))
    sources = {path: (DOCS.parent / path).read_text(encoding="utf-8") for path, _ in named}
    assert [name for path, name in named if name and f"def {name}(" not in sources[path]] == []


def test_the_expectations_are_complete_and_each_is_shown() -> None:
    page = (DOCS / "napari.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \|(.*)\|(.*)\|$", page, re.MULTILINE)
    assert [int(number) for number, _, _ in rows] == list(range(1, 21))
    assert all("tests/" in shown or "images/" in shown for _, _, shown in rows)
    traps = page.split("##")[1]
    assert traps.count("\n| ") == 1 + 11, "a header and eleven traps"


@pytest.mark.parametrize("page", ["reference.md", "modules.md"])
def test_references_can_be_imported(page: str) -> None:
    for name in re.findall(r"^::: (\S+)", (DOCS / page).read_text(encoding="utf-8"), re.MULTILINE):
        module, _, attribute = name.rpartition(".")
        try:
            import_module(name)
        except ModuleNotFoundError:
            assert hasattr(import_module(module), attribute), name
