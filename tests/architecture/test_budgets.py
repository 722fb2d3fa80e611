"""The source tree grows only on purpose: budgets that fall with every clean-up (CONTRIBUTING.md)."""

from __future__ import annotations

from pathlib import Path

import measures
import pytest

NOW = measures.measured(measures.modules())
ALLOWED = measures.budgets()
FIGURES = [(part, name) for part, figures in NOW.items() for name in figures]
ROOM = 0.03  # of a budget, by which it may stand above what is there
LEAST_ROOM = {"counts": 3, "tokens": measures.TOKEN_STEP}


@pytest.mark.parametrize(("part", "name"), FIGURES, ids=lambda x: str(x))
def test_a_figure_is_within_its_budget(part: str, name: str) -> None:
    assert name in ALLOWED[part], (
        f"{name}: no budget; python tests/architecture/measures.py --lower"
    )
    assert NOW[part][name] <= ALLOWED[part][name], (
        f"{name}: {NOW[part][name]:,} over the budget of {ALLOWED[part][name]:,}; take as much out, "
        "or raise the budget in a commit of its own that names what is bought"
    )


@pytest.mark.parametrize(("part", "name"), FIGURES, ids=lambda x: str(x))
def test_a_budget_falls_with_what_it_bounds(part: str, name: str) -> None:
    room = max(ROOM * ALLOWED[part].get(name, 0), LEAST_ROOM[part])
    assert ALLOWED[part].get(name, 0) - NOW[part][name] <= room, (
        f"{name}: lower its budget: python tests/architecture/measures.py --lower"
    )


def test_no_budget_is_left_behind() -> None:
    assert {part: set(figures) for part, figures in ALLOWED.items()} == {
        part: set(figures) for part, figures in NOW.items()
    }


def package(tmp_path: Path, **texts: str) -> dict[str, int]:
    """Counts of a package of these modules."""
    root = tmp_path / "house"
    root.mkdir()
    for name, text in texts.items():
        (root / f"{name}.py").write_text(text, encoding="utf-8")
    return measures.measured(measures.modules(root))["counts"]


FIELDS = "\n".join(f"    x{k}: int" for k in range(13))
COUNTED = {
    "functions of many parameters": "def f(a, b, c, d, e, f, g):\n    return a\n",
    "calls with many positional arguments": "print(1, 2, 3, 4, 5, 6)\n",
    "dataclasses of many fields": f"@dataclass(frozen=True)\nclass Many:\n{FIELDS}\n",
    "short private functions called once": "def _f():\n    return 1\n\n\nx = _f()\n",
    "private words": "told = 1\n",
    "sentences read by code": 'late = note.text.startswith("late")\n',
    "modules of many numeric constants": "A, B, C, D, E, F, G, H, I = 1, 2, 3, 4, 5, 6, 7, 8, 9.0\n",
}


@pytest.mark.parametrize("what", COUNTED)
def test_what_is_counted(what: str, tmp_path: Path) -> None:
    assert package(tmp_path, a=COUNTED[what])[what] == 1


def test_numbers_with_a_name_are_counted_alone(tmp_path: Path) -> None:
    text = 'A = 1\nB, C = 2.0, "two"\nD: float = 0.5\nE = True\n'
    assert package(tmp_path, a=text)["numeric constants"] == 3


def test_comments_and_docstrings_cost_nothing(tmp_path: Path) -> None:
    text = '"""A docstring\nof two lines."""\n\n# a comment\nx = 1\n'
    counts = package(tmp_path, a=text)
    assert counts["tokens"] == 3
    assert counts["tokens in ten code lines"] == 30


def test_modules_that_import_each_other(tmp_path: Path) -> None:
    ring = {
        "a": "from house.b import x\n",
        "b": "import house.c\n",
        "c": "from house import a\n",
    }
    typed = "if TYPE_CHECKING:\n    from house.d import y\n"
    counts = package(tmp_path, **ring, d="from house.e import z\n", e=typed)
    assert counts["modules in cycles"] == 3
    assert counts["short modules with one importer"] == 4


def test_class_names_defined_twice(tmp_path: Path) -> None:
    one = "class Target:\n    pass\n"
    assert package(tmp_path, a=one, b=one)["class names defined twice"] == 1
