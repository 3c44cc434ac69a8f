"""The package as a whole: who may import whom, and one version in one place."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import bigtri

PACKAGE = Path(bigtri.__file__).parent

# Lowest first: a module imports from its own room and from those before it in this list. docs/architecture.md has them too.
ROOMS = (
    ("precision", "choices", "warn", "machine", "torch_private"),  # names and helpers that know nothing of bigtri
    ("reference",),
    ("fakes", "native"),
    ("ops",),
    ("scene", "check"),
    ("rendering",),
    ("hard_cases", "study"),
    ("app",),
    ("__init__", "__main__"),
)
LEVEL = {room: level for level, rooms in enumerate(ROOMS) for room in rooms}


def name_of(file: Path) -> str:
    """The module's dotted name within the package; "" for the package itself."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def imports(name: str) -> set[str]:
    """The modules of bigtri that this one imports, wherever in its text, but not those that only type checkers read."""
    file = MODULES[name]
    package = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
    package = [part for part in package if part]
    found = set()

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
            for alias in node.names:  # a name of a package is a module of it, or something that it holds
                module = ".".join([*base, alias.name])
                found.add(module if module in MODULES else ".".join(base))
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(file.read_text()))
    return found - {name}


def test_every_module_has_a_room() -> None:
    assert {(name or "__init__").split(".")[0] for name in MODULES} == set(LEVEL)


def test_no_module_imports_from_a_higher_room() -> None:
    def level(name: str) -> int:
        return LEVEL[(name or "__init__").split(".")[0]]

    climbs = [f"{name} imports {other}" for name in MODULES for other in imports(name) if level(other) > level(name)]
    # `from .. import native` asks the package for one of its modules; the package itself is asked for nothing but its version.
    assert [climb for climb in climbs if not climb.endswith("imports ")] == []


def test_the_imports_have_no_circle() -> None:
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path[path.index(name) :], name))
        if name not in done:
            for other in sorted(imports(name) - {""}):
                visit(other, (*path, name))
            done.add(name)

    for name in MODULES:
        visit(name, ())


def test_one_version_in_one_place() -> None:
    root = PACKAGE.parent
    texts = [root / "pyproject.toml", root / "CITATION.cff", PACKAGE / "__init__.py"]
    assert all(file.exists() for file in texts)
    assert re.search(r"^version: " + re.escape(bigtri.__version__) + "$", texts[1].read_text(), re.M)
    assert not re.search(r'^version = "', texts[0].read_text(), re.M), "setuptools reads it from bigtri/__init__.py"
