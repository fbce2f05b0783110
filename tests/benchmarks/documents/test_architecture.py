from __future__ import annotations

from typing import TYPE_CHECKING

from benchmarks.documents.architecture import Room, draw_architecture, layers_of, read_rooms

if TYPE_CHECKING:
    from pathlib import Path


def test_rooms_are_folders_and_loose_modules_with_what_they_import(tmp_path: Path) -> None:
    for name, text in {
        "__init__.py": "",
        "errors.py": "x = 1\n",
        "io/__init__.py": "",
        "io/files.py": "from napari_elsplus import errors\nimport numpy\n",
        "io/deep/more.py": "def f():\n    from napari_elsplus.errors import x\n",
        "cli.py": "import napari_elsplus.io.files\nlater = 'napari_elsplus.widgets.panel:Panel'\n",
        "widgets/panel.py": "from napari_elsplus.io import files\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    rooms = read_rooms(tmp_path)
    assert rooms == {
        "cli": Room(1, 2, frozenset({"io", "widgets"})),
        "errors": Room(1, 1, frozenset()),
        "io": Room(2, 4, frozenset({"errors"})),
        "widgets": Room(1, 1, frozenset({"io"})),
    }
    assert layers_of(rooms) == ([["errors"], ["io"], ["widgets"], ["cli"]], set())


def test_a_circle_shares_a_layer_and_is_counted() -> None:
    imports = {"low": (), "a": ("b", "low"), "b": ("c",), "c": ("a",), "top": ("b", "low")}
    rooms = {name: Room(1, 10, frozenset(others)) for name, others in imports.items()}
    layers, circles = layers_of(rooms)
    assert [set(layer) for layer in layers] == [{"low"}, {"a", "b", "c"}, {"top"}]
    assert circles == {("a", "b"), ("b", "c"), ("c", "a")}
    title = draw_architecture(rooms, "example").axes[0].get_title()
    assert title == "example: 5 rooms on 3 layers, 3 imports in circles; 5 modules, 50 lines"
