"""An import points down: ARCHITECTURE.md's floors, enforced on the syntax trees."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import measures
import pytest

import ringtrue

SRC = Path(__file__).parents[2] / "src" / "ringtrue"
FLOORS = [
    {"core", "errors"},
    {"eigen", "model", "shapes"},
    {"fem", "reduction", "signal", "identification", "correlation", "io", "decks"},
    {"solvers", "planning", "updating", "virtual", "checks"},
    {"study"},
    {"plots", "viewer"},
    {"report"},
    {"demos", "testing"},
    {"api"},
    {"cli", "studio"},
    {"__main__"},
]
SIDEWAYS = {
    ("core", "errors"),
    ("reduction", "fem"),
    ("identification", "signal"),
    ("planning", "virtual"),
    ("decks", "io"),
    ("plots", "viewer"),
    ("cli", "studio"),  # its command opens it
}
THIRD_PARTY = {  # above numpy and scipy, which every floor may use
    "core": {"distributed"},  # work of every floor runs side by side
    "decks": {"h5py"},
    "io": {"h5py", "nptdms", "openpyxl", "pyuff"},
    "eigen": {"pymklpardiso", "rslab"},
    "signal": {"h5py"},
    "virtual": {"h5py"},
    # wire: without ringtrue, by its file
    "solvers": {"mpi4py", "petsc4py", "slepc4py", "wire"},
    "study": {"h5py", "pydantic"},
    "plots": {"plotly"},
    "viewer": {"anywidget", "traitlets"},
    "report": {"docx", "jinja2", "plotly"},
    "cli": {"typer", "rich", "click"},
    "demos": {"h5py"},
    "studio": {"nicegui", "plotly", "pydantic", "starlette", "tomlkit"},
}
SHALLOW = {"api", "core", "demos", "errors", "io", "plots", "report", "study", "viewer"}
STDLIB_OK = set(__import__("sys").stdlib_module_names) | {"numpy", "scipy", "ringtrue"}


PUBLIC = set(ringtrue.__all__)


def floor(package: str) -> int:
    return next(i for i, names in enumerate(FLOORS) if package in names)


def package_of(path: Path) -> str:
    top = path.relative_to(SRC).parts[0]
    return top.removesuffix(".py")


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
            if node.module == "ringtrue":
                found |= {f"ringtrue.{a.name}" for a in node.names}
    return found


FILES = [
    p for p in sorted(SRC.rglob("*.py")) if p.name != "__init__.py" or p.parent != SRC
]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SRC)))
def test_imports_point_down(path: Path) -> None:
    here = package_of(path)
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "ringtrue":
            if len(parts) == 1 or parts[1] in ("__version__", here, *PUBLIC):
                continue
            there = parts[1]
            ok = floor(there) < floor(here) or (here, there) in SIDEWAYS
            assert ok, (
                f"{path.relative_to(SRC)} imports {name}: {here} may not see {there}"
            )
        else:
            ok = parts[0] in STDLIB_OK or parts[0] in THIRD_PARTY.get(here, set())
            assert ok, (
                f"{path.relative_to(SRC)} imports {name}: not allowed on this floor"
            )


@pytest.mark.parametrize(
    "path",
    [p for p in FILES if package_of(p) == "studio"],
    ids=lambda p: str(p.relative_to(SRC)),
)
def test_the_studio_is_thin(path: Path) -> None:
    """Pages and events: what it shows comes from the public API or the stored study; types of
    results may be named.
    """
    module = next(m for m in measures.modules() if m.path == path)
    below = {
        name.split(".")[1] for name in module.imports if name.startswith("ringtrue.")
    }
    deep = below - SHALLOW - {"studio", "__version__"} - PUBLIC
    assert not deep, f"{path.relative_to(SRC)} imports {deep}"


def test_one_door_leads_upward() -> None:
    """`.plot()` of a result: `core.display` names one module by text, which registers the
    drawings.
    """
    by_name = [
        p.relative_to(SRC).as_posix()
        for p in FILES
        if package_of(p) == "core" and "import_module(" in p.read_text()
    ]
    assert by_name == ["core/display.py"]
    assert (
        'DRAWINGS = "ringtrue.plots.results"' in (SRC / "core/display.py").read_text()
    )


LARGE = [
    d
    for d in (SRC, *sorted(SRC.rglob("*/")))
    if d != SRC and len(list(d.glob("*.py"))) > 20
]


@pytest.mark.parametrize("package", LARGE, ids=lambda p: str(p.relative_to(SRC)))
def test_a_large_package_tells_where_each_module_has_its_place(package: Path) -> None:
    modules = {p.stem for p in package.glob("*.py")} | {
        p.parent.name for p in package.glob("*/__init__.py")
    }
    told = re.findall(
        r"`(\w+)`",
        ast.get_docstring(ast.parse((package / "__init__.py").read_text())) or "",
    )
    assert sorted(told) == sorted(modules - {"__init__"})
