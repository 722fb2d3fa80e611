"""Masses that a deck lacks, on the frame of `localise_twin`: 1.5 t more at nodes where nothing is
measured.
"""

from __future__ import annotations

import json
from pathlib import Path

import localise_twin as twin
import numpy as np
import pytest

from ringtrue.checks.materials import whole_mass
from ringtrue.cli.main import run
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.assembly import assemble
from ringtrue.model.edit import field_changes
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.updating.selection.candidates import PLACES, CandidateSettings, parameters
from ringtrue.updating.selection.generation import lumped, places

NODE, MASS = twin.node(2, 0, 1), 1500.0  # the edge of the second floor, kg
TOTAL = 30_000.0


def _with_mass(text: str) -> str:
    return text.replace("ENDDATA", f"CONM2,99999,{NODE},,{MASS}\nENDDATA")


def _measured(folder: Path, truth: str, rng: np.random.Generator) -> list[str]:
    with EmbeddedSolver().open(twin.read(truth)) as analysis:
        modes = analysis.modes(ModesRequest(twin.MODES)).modes
        seen = twin.observation(analysis.dofs, twin.channels())(modes.shapes)
    noise = 0.005 * np.abs(seen).max(axis=0)
    frequencies = modes.frequencies * (1 + 1e-3 * rng.standard_normal(twin.MODES))
    twin.write_test(
        folder, frequencies, seen + noise * rng.standard_normal(seen.shape), 1e-3, noise
    )
    return [
        "localise",
        str(folder / "frame.bdf"),
        str(folder / "modes.json"),
        "--most",
        "3",
        "--pool",
        "12",
        "--json",
        str(folder / "found.json"),
    ]


def test_a_mass_that_the_deck_lacks_is_named_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        run(_measured(tmp_path, _with_mass(twin.deck()), np.random.default_rng(5))) == 0
    )
    found = {
        m["name"]: m
        for m in json.loads((tmp_path / "found.json").read_text())["proposed"]
    }
    name = f"mass missing at {NODE}"
    assert name in found
    assert found[name]["added"] == pytest.approx(MASS, rel=0.05)
    assert sum(m.get("added", 0.0) for m in found.values()) == pytest.approx(
        MASS, rel=0.1
    )
    printed = capsys.readouterr().out
    assert "that the deck does not have" in printed
    card = next(
        line
        for line in printed.splitlines()
        if line.startswith("CONM2,") and f",{NODE},," in line
    )
    (tmp_path / "mended.bdf").write_text(
        twin.deck().replace("ENDDATA", f"{card}\nENDDATA")
    )
    assert len(read_deck(tmp_path / "mended.bdf")["CONM2"]) == 1 + len(
        twin.read(twin.deck())["CONM2"]
    )


def test_wrong_stiffnesses_are_no_lacking_masses(tmp_path: Path) -> None:
    assert (
        run(
            _measured(tmp_path, twin.deck({20: 0.7, 31: 1.5}), np.random.default_rng(6))
        )
        == 0
    )
    found = json.loads((tmp_path / "found.json").read_text())["proposed"]
    assert found
    assert not [m["name"] for m in found if "added" in m]


def test_places_change_nothing_and_are_of_no_other_element() -> None:
    model = twin.read(twin.deck())
    nodes = np.array([twin.node(1, 0, 0), NODE])
    with_places, candidates = lumped(model, nodes, TOTAL, CandidateSettings(units="SI"))
    before, after = assemble(model), assemble(with_places)
    assert abs(before.mass - after.mass).max() == 0.0
    assert abs(before.stiffness - after.stiffness).max() == 0.0
    taken = {
        i
        for t in model.tables.values()
        if t.card.startswith("C")
        for i in t.ids.tolist()
    }
    assert not taken & {e for c in candidates for e in c.elements}
    assert [c.name for c in candidates] == [
        f"mass missing at {n}" for n in nodes.tolist()
    ]
    assert all(
        c.parameter.lower < 1 < c.parameter.upper and c.parameter.lump == TOTAL
        for c in candidates
    )


def test_places_cover_the_structure_the_seen_ones_among_them() -> None:
    model = twin.read(twin.deck())
    free = np.ones(len(model["GRID"]), dtype=bool)
    free[:4] = False  # the feet
    seen = np.array([NODE, twin.node(3, 2, 2)])
    found = places(model, free, seen)
    assert found.size == min(PLACES, free.sum())
    assert np.isin(seen, found).all()
    assert not np.isin(model["GRID"].ids[:4], found).any()


def test_the_updated_deck_has_the_mass_as_a_card_and_nothing_else_changed(
    tmp_path: Path,
) -> None:
    (tmp_path / "frame.bdf").write_text(twin.deck())
    model = read_deck(tmp_path / "frame.bdf")
    with_places, candidates = lumped(
        model, np.array([NODE, 301]), TOTAL, CandidateSettings()
    )
    chosen = parameters(candidates[:1])
    changes = field_changes(with_places, chosen, np.array([1 + MASS / TOTAL]))
    written = edit_fields(with_places, changes, tmp_path / "updated")
    added = [
        line
        for line in written[0].read_text().splitlines()
        if line not in twin.deck().splitlines()
    ]
    assert [line.split()[:3] for line in added] == [
        ["CONM2", str(candidates[0].elements[0]), str(NODE)]
    ]
    truth = whole_mass(twin.read(_with_mass(twin.deck())))
    assert whole_mass(read_deck(written[0])).mass == pytest.approx(truth.mass, rel=1e-6)
