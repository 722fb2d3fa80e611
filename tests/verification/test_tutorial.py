"""docs/tutorial.md does what it says: its files are written, its commands run, its figures
found.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECK = ROOT.parent / "shared/data/fe/bwb"
TUTORIAL = ROOT / "docs/tutorial.md"
BLOCK = re.compile(
    r"(?:<!-- (file|append): (\S+) -->\n)?```(\w+)\n(.*?)```\n", re.DOTALL
)

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not DECK.exists(), reason=f"no {DECK}: the tutorial is NOT run"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where everything in the tutorial has been done, in its order."""
    here = tmp_path_factory.mktemp("tutorial")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for how, name, language, text in BLOCK.findall(
        TUTORIAL.read_text(encoding="utf-8")
    ):
        if how:
            with (here / name).open(
                "a" if how == "append" else "w", encoding="utf-8"
            ) as file:
                file.write(text)
        elif language == "sh":
            script = ["bash", "-euo", "pipefail", "-c", text]
            env = os.environ | {"BWB": str(DECK), "PATH": path}
            ran = subprocess.run(
                script, cwd=here, env=env, capture_output=True, text=True, check=False
            )
            assert ran.returncode == 0, (
                f"{text}\n{ran.stdout[-2000:]}\n{ran.stderr[-2000:]}"
            )
    return here


def table(head: str) -> list[list[str]]:
    """Rows of the table of the tutorial that has this head."""
    lines = TUTORIAL.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(head))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_figures_of_the_tutorial_are_those_of_its_commands(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    for head, key in (
        ("| test, Hz | deck, Hz", "initial"),
        ("| test, Hz | delivered", "final"),
    ):
        said = table(head)
        assert len(said) == len(summary[key]) == 8
        for row, pair in zip(said, summary[key], strict=True):
            numbers = [
                pair[k]
                for k in (
                    "frequency_test_hz",
                    "frequency_fe_hz",
                    "deviation_percent",
                    "subspace_mac_percent",
                )
            ]
            for text, number, close in zip(
                row, numbers, (0.01, 0.01, 0.05, 0.5), strict=False
            ):
                assert abs(float(text.replace("−", "-")) - number) < close


def test_the_structure_as_built_is_found(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    built = {"wing and body panels": 0.85, "tail panels": 1.25, "frames": 1.0}
    for p in summary["parameters"]:
        assert (
            abs(p["factor"] - built[p["name"]])
            < 3 * p["std"] / p["updated"] * p["factor"]
        )
    assert {p["name"] for p in summary["parameters"]} >= {
        "wing and body panels",
        "tail panels",
    }
    assert max(abs(p["deviation_percent"]) for p in summary["left_out"]) < 1.0
    for p in summary["damping"]["regions"]:
        assert abs(p["value"] - 0.03) < 3 * p["std"]


def test_what_it_says_is_there_is_there(folder: Path) -> None:
    plan, results = (
        ("plan/sensors.csv", "plan/geometry.uff"),
        ("report.html", "study.h5"),
    )
    for name in (*plan, *results, "damped/bwb_geom.blk"):
        assert (folder / name).stat().st_size > 0
    old, new = (
        (folder / f / "bwb_geom.blk").read_text().splitlines() for f in (".", "updated")
    )
    assert len(old) == len(new)
    assert {a[:16].split()[0] for a, b in zip(old, new, strict=True) if a != b} <= {
        "MAT1",
        "MAT8",
    }
