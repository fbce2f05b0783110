"""Draw the package's rooms from its imports, layered from the lowest at the bottom to the highest at the top.

A room is the first folder below the package, or a module beside these folders. Imports are read with :mod:`ast`: those
within functions too, and names of modules in strings. A room lies one layer above the highest room that it imports;
rooms that import one another in a circle share a layer, and their arrows are red. Arrows that others imply are pale.
"""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

PACKAGE = "napari_elsplus"
_BOX = (1.0, 0.5)
"""Width and height of a box, where the layers lie 1.25 apart."""


class Room(NamedTuple):
    """A folder of modules, or a single module, with the rooms that it imports."""

    modules: int
    lines: int
    imports: frozenset[str]


def read_rooms(package: Path) -> dict[str, Room]:
    """Return the rooms of a package by name.

    Parameters
    ----------
    package : pathlib.Path
        Folder of the package's ``__init__.py``.

    Raises
    ------
    InputError
        If it is none.
    """
    if not (package / "__init__.py").is_file():
        raise InputError(f"there is no package in {package}", "name the folder of its __init__.py")
    files = [path for path in sorted(package.rglob("*.py")) if path != package / "__init__.py"]
    names = {path: path.relative_to(package).parts[0].removesuffix(".py") for path in files}
    rooms: dict[str, Room] = {}
    for path, name in names.items():
        text = path.read_text(encoding="utf-8")
        known = rooms.get(name, Room(0, 0, frozenset()))
        counted = known.modules + (path.name != "__init__.py" or path.parent == package)
        imports = known.imports | (_imported(ast.parse(text)) & {*names.values()}) - {name}
        rooms[name] = Room(counted, known.lines + len(text.splitlines()), imports)
    return rooms


def _imported(tree: ast.Module) -> set[str]:
    """Return the first names below the package that a module imports."""
    dotted: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            dotted.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            dotted.update(f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            dotted.add(node.value.partition(":")[0])
    return {name.split(".")[1] for name in dotted if name.startswith(f"{PACKAGE}.")}


def layers_of(rooms: dict[str, Room]) -> tuple[list[list[str]], set[tuple[str, str]]]:
    """Return the rooms of each layer, lowest first, and the imports that are part of a circle.

    Parameters
    ----------
    rooms : dict of str to Room
        See :func:`read_rooms`.
    """
    below = {name: _reached(rooms, name) for name in rooms}
    circles = {(a, b) for a, room in rooms.items() for b in room.imports if a in below[b]}
    height: dict[str, int] = {}
    for name in sorted(rooms, key=lambda room: len(below[room] | {room})):  # imported ones come first
        lower = [height[other] for other in below[name] - {name} if name not in below[other]]
        height[name] = 1 + max(lower, default=-1)
    layers = [[name for name in rooms if height[name] == layer] for layer in range(1 + max(height.values()))]
    place = {name: k - (len(layer) - 1) / 2 for layer in layers for k, name in enumerate(layer)}
    for _ in range(4):  # towards what they import, so that arrows cross less
        for layer in layers[1:]:
            layer.sort(key=lambda name: np.mean([place[other] for other in rooms[name].imports] or [0.0]))
            place.update({name: k - (len(layer) - 1) / 2 for k, name in enumerate(layer)})
    return layers, circles


def _reached(rooms: dict[str, Room], name: str) -> set[str]:
    found: set[str] = set()
    todo = [*rooms[name].imports]
    while todo:
        other = todo.pop()
        if other not in found:
            found.add(other)
            todo += rooms[other].imports
    return found


def draw_architecture(rooms: dict[str, Room], title: str = PACKAGE) -> Figure:
    """Draw the rooms in layers, with arrows from each to those that it imports.

    Parameters
    ----------
    rooms : dict of str to Room
        See :func:`read_rooms`.
    title : str
        Written above, with the number of rooms, layers and imports in circles.
    """
    layers, circles = layers_of(rooms)
    widest = max(map(len, layers))
    figure = Figure(figsize=(1.75 * max(widest, 5) + 0.4, 1.25 * len(layers) + 0.6), layout="constrained")
    axes = figure.subplots()
    at = {
        name: ((k - (len(layer) - 1) / 2) * 1.3 + 0.22 * (-1) ** y, 1.25 * y)
        for y, layer in enumerate(layers)
        for k, name in enumerate(layer)
    }
    reached = {name: _reached(rooms, name) for name in rooms}
    for name, room in rooms.items():
        for other in room.imports:
            circle = (name, other) in circles
            between = [third for third in room.imports if other in reached[third] and third not in reached[other]]
            _arrow(axes, at[name], at[other], "#c00000" if circle else "0.82" if between else "#33658a")
    for name, (x, y) in at.items():
        _box(axes, x, y, name, rooms[name])
    axes.set_xlim(min(x for x, _ in at.values()) - 0.75, max(x for x, _ in at.values()) + 0.75)
    axes.set_ylim(-0.5, 1.25 * (len(layers) - 1) + 0.5)
    axes.set_axis_off()
    lines, modules = sum(room.lines for room in rooms.values()), sum(room.modules for room in rooms.values())
    axes.set_title(
        f"{title}: {len(rooms)} rooms on {len(layers)} layers, {len(circles)} imports in circles; "
        f"{modules} modules, {lines:,} lines", fontsize=11,
    )  # fmt: skip
    return figure


def _box(axes: Axes, x: float, y: float, name: str, room: Room) -> None:
    width, height = _BOX
    loose = room.modules == 1
    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2), width, height, boxstyle="round,pad=0.02,rounding_size=0.06",
            facecolor="#f6f2e7" if loose else "#dceaf4", edgecolor="0.35", zorder=3,
        )
    )  # fmt: skip
    axes.text(
        x, y + 0.08, name, ha="center", va="center", fontsize=9 if len(name) < 13 else 7.5, weight="bold", zorder=4
    )
    count = "" if loose else f"{room.modules} modules, "
    axes.text(x, y - 0.12, f"{count}{room.lines:,} lines", ha="center", va="center", fontsize=6.5, zorder=4)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    pale = colour == "0.82"
    level = start[1] == end[1]
    axes.annotate(
        "", (end[0], end[1] + (0 if level else _BOX[1] / 2)), (start[0], start[1] - (0 if level else _BOX[1] / 2)),
        zorder=1 if pale else 2,
        arrowprops={
            "arrowstyle": "-|>", "color": colour, "linewidth": 0.7 if pale else 1.2, "mutation_scale": 9,
            "shrinkA": 0, "shrinkB": 1, "connectionstyle": f"arc3,rad={0.4 if level else 0.06}",
        },
    )  # fmt: skip
