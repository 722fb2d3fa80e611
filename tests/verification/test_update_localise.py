"""Candidates of a deck, collinearity, Cramér-Rao bounds and error indicators,
against closed forms.
"""

from __future__ import annotations

from pathlib import Path

import localise_twin as twin
import numpy as np
import pytest
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.editor import unwritable
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import InputError, NumericalError
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.edit import apply_factors
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.expansion import ShapeReadings, expand_hybrid
from ringtrue.reduction.parametric import reduced_model
from ringtrue.reduction.static import StaticShapes
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.updating.identifiability import clusters, cosines, identifiability
from ringtrue.updating.selection import screening
from ringtrue.updating.selection.candidates import (
    CandidateSettings,
    elements_of,
    membership,
)
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.localisation import expanded_errors, strain_energies
from ringtrue.updating.selection.screening import effective


def test_candidates_know_their_elements_and_units() -> None:
    found = {
        c.name: c
        for c in generate(twin.read(twin.deck()), CandidateSettings(units="SI"))
    }
    assert found["MAT1 11 E"].elements == (100, 101)
    assert found["MAT1 11 E"].what == "Young's modulus 2e+11 Pa of 2 CBEAM"
    assert found["PSHELL 20 T"].what == "thickness 0.1 m of 4 CQUAD4"
    assert found["PBUSH 900 K4"].what.startswith("stiffness about axis 1 5e+06 N m/rad")
    assert (
        found["PSHELL 10 piece 1 E"].elements != found["PSHELL 10 piece 2 E"].elements
    )
    assert "MAT1 10 NU" not in found
    only = generate(twin.read(twin.deck()), CandidateSettings(kinds=("spring",)))
    assert {c.kind for c in only} == {"spring"}


def test_equal_springs_are_one_group_and_each_by_itself() -> None:
    text = twin.deck().replace("CBUSH,903,900", "CBUSH,903,901")
    extra = [
        ln.replace("PBUSH,900", "PBUSH,901")
        for ln in text.splitlines()
        if ln.startswith("PBUSH")
    ]
    model = twin.read(text.replace("ENDDATA", "\n".join([*extra, "ENDDATA"])))
    names = {
        c.name: c.elements
        for c in generate(model, CandidateSettings(kinds=("spring",)))
    }
    assert names["PBUSH 900-901 K1"] == (900, 901, 902, 903)
    assert names["PBUSH 901 K1"] == (903,)


def test_a_section_given_by_its_dimensions_can_be_written(tmp_path: Path) -> None:
    """A PBARL makes a PBAR that has no card of its own; a tube has no wall if one radius alone is
    doubled or halved.
    """
    nodes = [f"GRID,{i},,{i}.,0.,0." for i in range(1, 5)]
    bars = ["CBAR,1,1,1,2,0.,0.,1.", "CBAR,2,2,2,3,0.,0.,1.", "CBEAM,3,3,3,4,0.,0.,1."]
    cards = [
        "PBARL,1,1,,BOX",
        ",.2,.1,.01,.01,5.",
        "PBAR,2,1,.01,1.-5,1.-5,2.-5",
        "PBEAML,3,1,,TUBE",
        ",.1,.09",
    ]
    cards += ["MAT1,1,2.1+11,,.3,7850."]
    (tmp_path / "a.bdf").write_text(
        "\n".join(["BEGIN BULK", *nodes, *bars, *cards, "ENDDATA"])
    )
    model = read_deck(tmp_path / "a.bdf")
    found = {
        c.name: c
        for c in generate(model, CandidateSettings(kinds=("property",), units="SI"))
    }
    each = {f"PBARL 1 DIM{k}" for k in range(1, 5)}
    assert {n for n in found if n.split()[1] != "2"} == {
        "PBARL 1 DIM",
        "PBARL 1 NSM",
        "PBEAML 3 DIM",
        *each,
    }
    assert (
        found["PBARL 1 DIM3"].what
        == "dimension 3 (0.01 m) of the BOX section of 1 CBAR"
    )
    assert [t.field for t in found["PBARL 1 DIM3"].parameter.targets] == ["DIM3"]
    assert [t.field for t in found["PBARL 1 DIM"].parameter.targets] == [
        "DIM1",
        "DIM2",
        "DIM3",
        "DIM4",
    ]
    assert found["PBARL 1 DIM"].what == "all dimensions of the BOX section of 1 CBAR"
    assert found["PBARL 1 NSM"].parameter.targets[0].field == "NSM"
    one = ParameterSet((found["PBARL 1 DIM"].parameter,))
    changed = apply_factors(model, one, np.array([1.1]))["PBAR"]
    ratio = {
        f: changed[f][changed.ids == 1] / model["PBAR"][f][model["PBAR"].ids == 1]
        for f in ("A", "I1")
    }
    np.testing.assert_allclose([ratio["A"], ratio["I1"]], [[1.1**2], [1.1**4]])
    every = [t for c in found.values() for t in c.parameter.targets]
    assert not unwritable(model, every)
    (why,) = unwritable(model, [*every, CardField("PBAR", 1, "A")]).items()
    assert why[0] == CardField("PBAR", 1, "A")
    assert "it was made from a PBARL" in why[1]


def test_what_no_mode_strains_is_left_out_with_a_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the first sway mode most candidates hold less than 2 % of the energy; a material without
    element is none.
    """
    text = twin.deck().replace("ENDDATA", "MAT1,77,1.+9,,0.3,0.0\nENDDATA")
    model = twin.read(text)
    assert not any(
        "77" in c.name for c in generate(model, CandidateSettings())
    )  # no element uses it
    monkeypatch.setattr(screening, "SIZES", screening.ScreeningSizes(effective=0.02))
    with EmbeddedSolver().open(model) as analysis:
        low = analysis.eigen(ModesRequest(1))
        every = generate(model, CandidateSettings())
        keep, lost = effective(
            model, analysis.system, every, low.values[:1], low.vectors[:, :1]
        )
    assert len(keep) + len(lost) == len(every)
    assert lost
    assert all("no mode has more than" in d.reason for d in lost)


def test_unknown_kind_and_units_are_refused() -> None:
    with pytest.raises(InputError, match="no kind 'springs'"):
        CandidateSettings(kinds=("springs",))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="did you mean"):
        CandidateSettings(units="mm-t")


def test_membership_has_every_element_of_every_candidate() -> None:
    model = twin.read(twin.deck())
    found = generate(model, CandidateSettings())
    member = membership(model, found)
    ids = elements_of(model)
    assert member.shape == (len(found), ids.size)
    for i, c in enumerate(found):
        assert sorted(ids[member[[i]].indices].tolist()) == list(c.elements)


def test_clusters_are_the_collinear_columns() -> None:
    rng = np.random.default_rng(1)
    a = rng.standard_normal((40, 3))
    g = np.stack(
        [a[:, 0], a[:, 1], -2 * a[:, 0], a[:, 2], a[:, 1] + 1e-3 * a[:, 0]], axis=1
    )
    assert clusters(g).tolist() == [0, 1, 0, 2, 1]
    assert cosines(g)[0, 2] == pytest.approx(1.0)
    with pytest.raises(InputError, match="limit"):
        clusters(g, limit=0.0)


def test_bounds_of_orthogonal_columns_and_of_twins() -> None:
    g = np.array([[3.0, 0, 0], [0, 4.0, 4.0], [0, 0, 0]])
    found = identifiability(g)
    np.testing.assert_allclose(found.alone, 1 / np.sqrt(1 + np.array([9, 16, 16])))
    np.testing.assert_allclose(found.together[0], 1 / np.sqrt(10))
    # twins: variance (1 + s²) / (1 + 2 s²)
    np.testing.assert_allclose(found.together[1:], np.sqrt(17 / 33))


def test_element_energies_sum_to_the_strain_energy() -> None:
    start = twin.start()
    modes = start.analysis.eigen(ModesRequest(6))
    energy = strain_energies(
        mesh(start.model), start.analysis.system, modes.vectors[:, :6]
    )
    np.testing.assert_allclose(energy.sum(axis=0), modes.values[:6], rtol=1e-8)


@pytest.mark.parametrize("region", [12, 23, 31])
def test_errors_gather_where_the_model_is_wrong(region: int) -> None:
    """One column of the true structure has 60 % of the modulus; sensors on every node find it among
    the twelve.
    """
    start = twin.start()
    system = start.analysis.system
    with EmbeddedSolver().open(twin.read(twin.deck({region: 0.6}))) as true:
        aim = true.eigen(ModesRequest(8))
    at = np.flatnonzero(np.isin(system.free.direction, (1, 2, 3)))
    observe = np.eye(len(system.free))[at]
    mine = start.analysis.eigen(ModesRequest(20)).vectors
    f, readings, sensors = (
        aim.frequencies[:8],
        aim.vectors[at, :8],
        sparse.csr_array(observe),
    )
    matrices = system.stiffness, system.mass
    u = expand_hybrid(*matrices, ShapeReadings(sensors, readings, f, 1e-3), mine).shapes
    static = StaticShapes(system.stiffness, sensors)
    found = expanded_errors(start.model, system, f, u, mine[:, :8], static.solve)
    static.close()
    columns = [
        c
        for c in start.candidates
        if c.name.startswith("MAT1") and c.name.endswith("E") and len(c.elements) == 2
    ]
    member = membership(start.model, columns)
    share = member @ found.constitutive
    assert columns[int(np.argmax(share))].name == f"MAT1 {region} E"
    nearest = np.argsort(-(member @ found.force))[
        :3
    ]  # forces at a node belong to all that meet there
    assert f"MAT1 {region} E" in [columns[i].name for i in nearest.tolist()]
    for value in (found.force, found.constitutive, found.energy, found.strain):
        assert value.sum() == pytest.approx(1.0)
        assert (value >= 0).all()


def test_reduced_shape_sensitivities_hold_with_motions_almost_without_mass() -> None:
    """Lumped masses leave the basis with motions at 1e12 times the lowest eigenvalue; the
    derivatives stay exact.
    """
    model = twin.start().reduced
    i, h = model.parameters.names.index("MAT1 30 E"), 1e-5
    x = np.zeros(len(model.parameters))
    step = np.where(np.arange(x.size) == i, h, 0.0)
    here = model.linearise(x)
    ahead, behind = (
        m.shapes * np.sign((m.shapes * here.shapes).sum(axis=0))
        for m in map(model.modes, (step, -step))
    )
    slope = (ahead - behind)[:, :12] / (2 * h)
    np.testing.assert_allclose(
        here.d_shapes[:, :12, i], slope, atol=1e-6 * np.abs(slope).max()
    )


def test_a_point_where_the_reduced_stiffness_is_not_definite_is_said() -> None:
    """A factor on twice the stiffness that is there: at 0.1 of it, less than none is left."""
    one = sparse.eye_array(4).tocsr()
    system = AffineSystem(
        1e4 * one,
        one,
        ParameterSet((Parameter("p"),)),
        (AffineTerm(power(0), 2e4 * one, 0 * one),),
        one,
    )
    with pytest.raises(NumericalError, match="not definite"):
        reduced_model(system, 2).modes(np.log([0.1]))
