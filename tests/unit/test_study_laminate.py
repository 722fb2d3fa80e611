"""A sandwich plate on four springs whose plies are updated, and whose springs get damping that
their card did not have.

0.8 x 0.6 m, faces of 1 mm of aluminium on a core of 10 mm, on PBUSH with a line of K alone at the
corners.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.io.modes import write_modes
from ringtrue.model.edit import apply_factors
from ringtrue.model.ports import ModesRequest
from ringtrue.report.build import deliver
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.run import run_study

NX, NY = 8, 6
CORNERS = (0, NX, NY * (NX + 1), (NX + 1) * (NY + 1) - 1)
FACES = ("T1", "T3")
STUDY = """
[model]
deck = "plate.bdf"
[test]
sheet = "sensors.csv"
modes = "test.json"
[[candidate]]
name = "faces"
targets = ["PCOMP 1 T1,T3"]
[damping]
write = true
"""


def plate() -> str:
    grids = [
        f"GRID,{1 + i + j * (NX + 1)},,{i / 10},{j / 10},0."
        for j in range(NY + 1)
        for i in range(NX + 1)
    ]
    first = [1 + i + j * (NX + 1) for j in range(NY) for i in range(NX)]
    quads = [
        f"CQUAD4,{e},1,{n},{n + 1},{n + NX + 2},{n + NX + 1}"
        for e, n in enumerate(first, 1)
    ]
    springs = [f"CBUSH,{101 + k},31,{1 + n},,,,,0" for k, n in enumerate(CORNERS)]
    cards = [
        "PCOMP,1,,,,,,,",
        "+,1,.001,0.,YES,2,.01,0.,YES",
        "+,1,.001,0.,YES",
        "MAT1,1,7.+10,,.3,2700.",
        "MAT8,2,1.+6,1.+6,.3,1.+6,2.+8,1.+8,50.",
        "PBUSH,31,K,3.+5,3.+5,3.+5,10.,10.,10.",
    ]
    return "\n".join(
        ["SOL 103", "CEND", "BEGIN BULK", *grids, *quads, *springs, *cards, "ENDDATA"]
    )


def test_plies_are_updated_and_springs_get_a_line_for_their_damping(
    tmp_path: Path,
) -> None:
    (tmp_path / "plate.bdf").write_text(plate())
    deck = read_deck(tmp_path / "plate.bdf")
    faces = ParameterSet(
        (Parameter("faces", tuple(CardField("PCOMP", 1, f) for f in FACES)),)
    )
    measured = [
        1 + i + j * (NX + 1) for j in range(0, NY + 1, 2) for i in range(0, NX + 1, 2)
    ]
    sheet = [
        f"{n},{(n - 1) % (NX + 1) / 10},{(n - 1) // (NX + 1) / 10},0,Z"
        for n in measured
    ]
    (tmp_path / "sensors.csv").write_text("\n".join(["point,x,y,z,direction", *sheet]))
    with EmbeddedSolver().open(apply_factors(deck, faces, np.array([1.2]))) as analysis:
        built = analysis.modes(ModesRequest(12)).modes.rows(
            [f"{n}+Z" for n in measured]
        )
    # moves out of its plane
    seen = np.flatnonzero(np.linalg.norm(built.shapes, axis=0) > 0.1)
    test = replace(built.take(seen), damping=np.full(seen.size, 0.01))
    write_modes(tmp_path / "test.json", test)
    (tmp_path / "study.toml").write_text(STUDY)
    done = run_study(tmp_path / "study.toml")
    deliver(done)
    assert done.results["update"].updated_values["faces"] == pytest.approx(
        0.0012, rel=5e-3
    )
    thick = read_deck(done.folder / "damped" / "plate.bdf")["PCOMP"].ragged("T").row(0)
    np.testing.assert_allclose(thick, [0.0012, 0.01, 0.0012], rtol=5e-3)
    assert any(
        "PCOMP 1 T1 0.001 -> 0.00" in line for line in done.results["final"].changes
    )
    bush = read_deck(done.folder / "damped" / "plate.bdf")["PBUSH"]
    loss = done.results["damping"].regions.coefficients
    assert bush["GE"][0] == pytest.approx(loss[-1], rel=1e-4)
    assert loss[-1] > 0
    assert bush["K1"][0] == 3e5
