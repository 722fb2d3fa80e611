"""Parsers of others are reached by one door, `ringtrue.io.foreign`, with its limits and its
errors.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src" / "ringtrue"
DOOR = SRC / "io" / "foreign"
MODULES = {
    "openpyxl",
    "tomllib",
    "nptdms",
    "pyuff",
    "yaml",
    "pickle",
    "marshal",
    "shelve",
    "xml",
    "zipfile",
}
# reading calls by the module that has them; h5py's types and what writes may be used anywhere
CALLS = {
    "json": {"load", "loads", "JSONDecoder"},
    "h5py": {"File", "is_hdf5"},
    "numpy": {"load", "loadtxt", "genfromtxt", "fromfile"},
    "scipy.io": {
        "loadmat",
        "mmread",
        "hb_read",
        "netcdf_file",
        "readsav",
        "whosmat",
        "wavfile",
    },
    "scipy.sparse": {"load_npz"},
}
ALLOWED = {
    ("report/build.py", "json.loads"): "text that plotly made a line above",
    ("study/run.py", "json.loads"): "text that json made in the same line",
    (
        "solvers/wire.py",
        "json.loads",
    ): "runs without ringtrue; a pipe of its parent or child",
    ("solvers/wire.py", "numpy.load"): "runs without ringtrue; a file of its own",
    (
        "solvers/slepc.py",
        "pickle",
    ): "writes what its ranks read, in a folder of its own",
    (
        "core/side_by_side.py",
        "pickle",
    ): "what this process and its workers have written",
    ("solvers/slepc_share.py", "pickle"): "files of its parent, in a folder of that",
    (
        "io/delimited.py",
        "numpy.loadtxt",
    ): "lines of text that the reader has taken apart",
}
FILES = [p for p in sorted(SRC.rglob("*.py")) if DOOR not in p.parents]


def names_of(tree: ast.AST) -> dict[str, str]:
    """What each imported name stands for: `np` numpy, `loads` json.loads, `io` scipy.io."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {
                a.asname or a.name.split(".")[0]: a.name
                if a.asname
                else a.name.split(".")[0]
                for a in node.names
            }
        elif isinstance(node, ast.ImportFrom):
            found |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    return found


def dotted(node: ast.expr, names: dict[str, str]) -> str:
    if isinstance(node, ast.Name):
        return names.get(node.id, "")
    if isinstance(node, ast.Attribute) and (stem := dotted(node.value, names)):
        return f"{stem}.{node.attr}"
    return ""


def writes(call: ast.Call) -> bool:
    """Whether a file is opened to be written: `h5py.File(path, "w")`."""
    return (
        len(call.args) > 1
        and isinstance(call.args[1], ast.Constant)
        and call.args[1].value in ("w", "x")
    )


def foreign_calls(text: str) -> set[str]:
    """The parsers that a module reaches past the door."""
    tree = ast.parse(text)
    names = names_of(tree)
    found = {name for name in names.values() if name.split(".")[0] in MODULES}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            module, _, function = dotted(node.func, names).rpartition(".")
            if function in CALLS.get(module, ()) and not writes(node):
                found.add(f"{module}.{function}")
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SRC)))
def test_nobody_reads_past_the_door(path: Path) -> None:
    name = path.relative_to(SRC).as_posix()
    past = {
        call for call in foreign_calls(path.read_text()) if (name, call) not in ALLOWED
    }
    assert not past, f"{name} reads by {past}: use ringtrue.io.foreign"


def test_what_is_allowed_is_there() -> None:
    for name, call in ALLOWED:
        assert call in foreign_calls((SRC / name).read_text())


@pytest.mark.parametrize(
    "text",
    [
        "import json\njson.loads('1')",
        "from json import load as l\nl(1)",
        "import h5py as h\nh.File('a')",
        "import h5py\nh5py.File('a', 'r')",
        "from scipy import io as s\ns.mmread('a')",
        "from scipy.io import loadmat\nloadmat('a')",
        "from scipy.sparse import load_npz\nload_npz('a')",
        "import numpy as np\nnp.load('a')",
        "import tomllib",
        "from openpyxl import load_workbook",
    ],
)
def test_ways_past_the_door_are_seen(text: str) -> None:
    assert foreign_calls(text)


def test_writing_is_no_reading() -> None:
    assert not foreign_calls("import h5py, json\nh5py.File('a', 'w')\njson.dumps(1)")
