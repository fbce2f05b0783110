"""The package speaks the field's language: retired identifiers stay away, public functions document their parameters.

``python tests/test_language.py FOLDER`` lists functions below a folder of the package that lack a Parameters section.
"""

from __future__ import annotations

import ast
import io
import re
import statistics
import sys
import tokenize
from pathlib import Path

import pytest

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "src" / "napari_elsplus"
RETIRED = [line for line in (PROJECT / "docs" / "retired-names.txt").read_text("utf-8").splitlines() if line[:1] != "#"]
LONGEST_MODULE = 400
UNITS = {"um", "px", "rows", "cols", "s", "hz", "v", "ms", "rad", "deg", "db", "dn"}

MODULES = sorted(PACKAGE.rglob("*.py"))


def plain(argument: str, first_line: str) -> bool:
    """Whether the first line of a docstring names an argument, whatever its unit."""
    words = {word.rstrip("s") for word in re.findall(r"[a-z0-9]+", first_line.lower())}
    parts = argument.lower().strip("_").split("_")
    return {part.rstrip("s") for part in parts if part not in UNITS or len(parts) == 1} <= words


def undocumented(path: Path) -> list[str]:
    """Public functions and methods of a module with arguments that nothing explains."""
    found: list[str] = []

    def visit(body: list[ast.stmt], owner: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                visit(node.body, f"{node.name}.")
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                continue
            decorators = " ".join(ast.unparse(decorator) for decorator in node.decorator_list)
            if re.search(r"setter|overload|command|group|option", decorators):
                continue
            arguments = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            arguments = arguments[1:] if owner and "staticmethod" not in decorators else arguments
            text = ast.get_docstring(node) or ""
            if "Parameters\n" in text or re.search(r":(meth|func|class):`", text):
                continue
            first = text.partition("\n\n")[0]
            if any(not plain(argument, first) for argument in arguments):
                found.append(f"{path.relative_to(PACKAGE)}:{node.lineno} {owner}{node.name}({', '.join(arguments)})")

    visit(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return found


def test_public_functions_document_parameters_that_are_not_plain() -> None:
    assert not [line for path in MODULES for line in undocumented(path)]


def test_retired_identifiers_stay_away() -> None:
    retired, found = set(RETIRED), []
    for path in MODULES:
        if path.is_relative_to(PACKAGE / "processing" / "tracking"):
            continue
        tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
        names = {token.string for token in tokens if token.type == tokenize.NAME}
        found += [f"{path.relative_to(PACKAGE)}: {name}" for name in sorted(names & retired)]
    assert not found


def test_modules_tell_one_story() -> None:
    sizes = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES if path.stem != "__init__"}
    assert not {str(path): size for path, size in sizes.items() if size > LONGEST_MODULE}
    assert 80 <= statistics.median(sizes.values()) <= 160


if __name__ == "__main__":
    lacking = [line for path in MODULES if path.is_relative_to(PACKAGE / sys.argv[1]) for line in undocumented(path)]
    sys.stdout.write("\n".join([*lacking, f"{len(lacking)}\n"]))
