"""Meshes refined once: the same as one made with elements of half the size, and the same
structure.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import fem_cases
import numpy as np
import pytest
from fem_cases import cards, grid, model, pshell, ragged, spc, square, steel
from shell_cases import net, rectangle, shell
from solid_meshes import box, cut, elements, psolid

from ringtrue.checks.mesh import mesh_errors
from ringtrue.core.arrays import Float, Int
from ringtrue.errors import UnsupportedError
from ringtrue.fem.assembly import assemble
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Table, stacked
from ringtrue.model.ports import ModesRequest
from ringtrue.model.refine import refined
from ringtrue.solvers.embedded import EmbeddedSolver

SAME = 1e-8  # of frequencies of one mesh with its nodes in another order
FIRST = 2e-4  # the same where a curved triangle of six nodes begins at another corner


def frequencies(m: Model, count: int = 8) -> Float:
    with EmbeddedSolver().open(m) as analysis:
        return analysis.modes(ModesRequest(count)).modes.frequencies


def plate(n: int, triangles: bool = False) -> Model:
    """n x n elements, 1 m x 0.7 m, two sides clamped, one of quadrilaterals on rollers by its PS
    fields.
    """
    xyz, quads = square(n, 1.0, 0.7)
    held = np.where((xyz[:, 1] == 0.7) & (not triangles), "3", "")
    table = fem_cases.triangles(quads) if triangles else fem_cases.shells(quads)
    edge = np.flatnonzero((xyz[:, 0] == 0) | (xyz[:, 1] == 0)) + 1
    return model(
        grid(xyz, PS=held), table, pshell(0.01), steel(), spc(edge, "123456"), spc=1
    )


@pytest.mark.parametrize("triangles", [False, True])
def test_a_plate_refined_is_that_of_twice_the_elements(triangles: bool) -> None:
    again = refined(plate(3, triangles))
    np.testing.assert_allclose(
        frequencies(again), frequencies(plate(6, triangles)), rtol=SAME
    )


def solid(name: str, n: int) -> Model:
    """A block of 0.5 x 0.3 x 0.2 m, clamped at x = 0."""
    xyz, nodes = cut(name, *box(2 * n, n, n, (0.5, 0.3, 0.2)))
    card = name.rstrip("0123456789")
    return model(
        grid(xyz),
        elements(card, nodes),
        psolid(),
        steel(),
        spc(np.flatnonzero(xyz[:, 0] == 0) + 1, "123"),
        spc=1,
    )


@pytest.mark.parametrize("name", ["CHEXA8", "CPENTA6", "CHEXA20", "CPENTA15"])
def test_solids_refined_are_those_of_twice_the_elements(name: str) -> None:
    np.testing.assert_allclose(
        frequencies(refined(solid(name, 1))), frequencies(solid(name, 2)), rtol=SAME
    )


@pytest.mark.parametrize("card", ["CQUAD8", "CTRIA6"])
@pytest.mark.parametrize("curved", [False, True])
def test_shells_of_the_second_order_refined_are_those_of_twice_the_elements(
    card: str, curved: bool
) -> None:
    """Thicker from corner to corner; bent to a parabola, on which the new nodes lie, too."""

    def made(n: int) -> Model:
        xyz, nodes, _ = net(card, n, n, rectangle(1.0, 0.7))
        xyz[:, 2] = 0.3 * xyz[:, 0] ** 2 if curved else 0.0
        corners = xyz[nodes[:, : 3 if card == "CTRIA6" else 4] - 1, 0]
        thick = {
            f"T{k + 1}": 0.01 + 0.005 * corners[:, k] for k in range(corners.shape[1])
        }
        edge = np.flatnonzero(xyz[:, 0] == 0) + 1
        return model(
            grid(xyz),
            shell(card, nodes, **thick),
            pshell(0.01),
            steel(),
            spc(edge, "123456"),
            spc=1,
        )

    tolerance = FIRST if curved and card == "CTRIA6" else SAME
    np.testing.assert_allclose(
        frequencies(refined(made(2))), frequencies(made(4)), rtol=tolerance
    )


def test_shells_on_solids_of_the_second_order_share_their_new_nodes() -> None:
    """A skin on the face x = 0.5 of bricks, clamped at x = 0: coarse or refined, it has no node of
    its own.
    """
    m = solid("CHEXA20", 1)
    t = m["CHEXA"]
    end = np.flatnonzero(positions(m)[m["GRID"].find(t["G2"])][:, 0] == 0.5)
    face = {
        f"G{k + 1}": t[f"G{g}"][end] for k, g in enumerate((2, 3, 7, 6, 10, 15, 18, 14))
    }
    skin = cards("CQUAD8", EID=900 + np.arange(end.size), PID=2, **face)
    fine = refined(
        replace(m, tables={**m.tables, "CQUAD8": skin, "PSHELL": pshell(0.001, pid=2)})
    )
    assert len(fine["GRID"]) == len(refined(m)["GRID"])
    assert len(fine["CQUAD8"]) == 4 * end.size


@pytest.mark.parametrize("name", ["CTETRA4", "CTETRA10"])
def test_tetrahedra_fill_the_same_space_and_come_nearer(name: str) -> None:
    coarse = solid(name, 1)
    fine = refined(coarse)
    assert len(fine["CTETRA"]) == 8 * len(coarse["CTETRA"])
    x = positions(fine)[fine["GRID"].find(fine["CTETRA"].stack("G1", "G2", "G3", "G4"))]
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    np.testing.assert_allclose(volumes, 0.03 / len(volumes), rtol=1e-9)
    exact = frequencies(solid("CTETRA10", 4), 3)
    off, less = (np.abs(frequencies(m, 3) / exact - 1) for m in (coarse, fine))
    assert (less < 0.9 * off).all()


@pytest.mark.parametrize("joint", ["RBE2", "RBAR", "RBAR1", "MPC"])
def test_edges_joined_node_by_node_stay_joined(joint: str) -> None:
    m = plate(4)
    x = positions(m)
    cantilever = {
        "GRID": grid(x),
        "SPC1": spc(np.flatnonzero(x[:, 0] == 0) + 1, "123456"),
    }
    m = replace(m, tables={**m.tables, **cantilever})
    seam, (xyz, quads) = np.flatnonzero(x[:, 0] == 0.5), square(4, 1.0, 0.7)
    twin = np.arange(1, seam.size + 1) + len(
        x
    )  # of the nodes of the seam, for the elements beyond it
    beyond = xyz[quads - 1, 0].mean(axis=1) > 0.5
    other = np.arange(len(x) + 1)
    other[seam + 1] = twin
    quads[beyond] = other[quads[beyond]]
    number, ends = np.arange(500, 500 + seam.size), {"GA": seam + 1, "GB": twin}
    tied = ragged(
        *np.repeat(np.stack([twin, seam + 1], axis=1), 6, axis=0)
    )  # six motions a pair
    motion = ragged(*np.tile(np.arange(1, 7), seam.size)[:, None].repeat(2, axis=1))
    rigid = {
        "RBE2": lambda: cards(
            "RBE2", EID=number, GN=seam + 1, CM="123456", GM=ragged(*twin[:, None])
        ),
        "RBAR": lambda: cards("RBAR", EID=number, CNA="123456", CMB="123456", **ends),
        "RBAR1": lambda: cards("RBAR1", EID=number, CB="123456", **ends),
        "MPC": lambda: cards(
            "MPC",
            SID=np.full(6 * seam.size, 3),
            G=tied,
            C=motion,
            A=ragged(*[[1.0, -1.0]] * 6 * seam.size),
        ),
    }[joint]()
    apart = {
        "GRID": grid(np.vstack([x, x[seam]])),
        "CQUAD4": fem_cases.shells(quads),
        joint: rigid,
    }
    case = replace(m.case, mpc=3 if joint == "MPC" else 0)
    joined = replace(m, tables={**m.tables, **apart}, case=case)
    np.testing.assert_allclose(frequencies(joined), frequencies(m), rtol=SAME)
    np.testing.assert_allclose(
        frequencies(refined(joined)), frequencies(refined(m)), rtol=SAME
    )


@pytest.mark.parametrize("name", ["CTETRA10", "CPENTA15", "CHEXA20"])
def test_midside_nodes_of_curved_solids_lie_on_their_curves(name: str) -> None:
    m = solid(name, 1)
    bent = m["GRID"]
    for axis, slope in (("X2", 0.3), ("X3", -0.2)):
        bent = bent.with_column(
            axis, bent[axis] + slope * bent["X1"] ** 2
        )  # within the shape functions
    fine, straight = (
        refined(replace(m, tables={**m.tables, "GRID": bent})),
        positions(refined(m)),
    )
    x = positions(fine)
    np.testing.assert_allclose(x[:, 0], straight[:, 0], atol=1e-12)
    np.testing.assert_allclose(x[:, 1], straight[:, 1] + 0.3 * x[:, 0] ** 2, atol=1e-12)
    np.testing.assert_allclose(x[:, 2], straight[:, 2] - 0.2 * x[:, 0] ** 2, atol=1e-12)


def frame(**bars: object) -> Model:
    """Five CBAR along an arc, nodes with displacements in a cylindrical frame about z."""
    angle = np.radians(np.linspace(0, 50, 6))
    xyz = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0.1 * np.arange(6)], axis=1)
    ends = np.array(list(pairwise(range(1, 7))))
    given = {"X1": 0.0, "X2": 0.0, "X3": 1.0} | bars
    table = cards(
        "CBAR", EID=np.arange(1, 6), PID=1, GA=ends[:, 0], GB=ends[:, 1], **given
    )
    round_ = cards("CORD2C", CID=[5], B3=1.0, C1=1.0)
    bar = cards(
        "PBAR", PID=[1], MID=1, A=1e-3, I1=4e-7, I2=1e-7, J=2e-7, K1=0.8, K2=0.7
    )
    return model(
        grid(xyz, CD=5),
        table,
        round_,
        bar,
        steel(),
        spc(np.array([1, 6]), "123456"),
        spc=1,
    )


def condensed(m: Model, nodes: Int) -> Float:
    """Stiffness on the six DOFs of some nodes, in basic."""
    system = assemble(m)
    full = system.transform @ np.linalg.solve(
        system.stiffness.toarray(), system.transform.T.toarray()
    )
    at = (6 * m["GRID"].find(nodes)[:, None] + np.arange(6)).ravel()
    return np.linalg.inv(full[np.ix_(at, at)])


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"X1": 1.0, "X2": 0.3, "X3": 0.1},
        {"OFFT": "BGG", "X1": 0.2, "X2": 0.1, "X3": 1.0},
        {"G0": np.array([3, 4, 5, 6, 1]), "X3": 0.0},
        {"W1A": 0.05, "W2A": -0.02, "W3A": 0.03, "W1B": 0.04, "W3B": 0.06},
        {"PB": np.array(["", "56", "", "4", ""])},
    ],
)
def test_bars_in_halves_are_as_stiff(given: dict[str, object]) -> None:
    m, ends = frame(**given), np.arange(2, 6)
    fine = refined(m)
    assert len(fine["CBAR"]) == 10
    whole = condensed(m, ends)
    np.testing.assert_allclose(
        condensed(fine, ends), whole, atol=1e-7 * np.abs(whole).max()
    )


def test_beams_with_unlike_ends_and_rods_by_themselves_stay_whole() -> None:
    m = frame()
    beams = cards("CBEAM", EID=[11, 12], PID=[2, 3], GA=[1, 2], GB=[3, 4], X3=1.0)
    ends = cards("PBEAM", PID=[2, 3], MID=1, A=1e-3, I1=1e-7, I2=1e-7, J=1e-7, AB=[1e-3, 2e-3], I1B=1e-7, I2B=1e-7,
                 JB=1e-7, **{k: ragged([], []) for k in ("X", "AX", "I1X", "I2X", "I12X", "JX", "NSMX")})  # fmt: skip
    rods = cards("CROD", EID=[21, 22], PID=4, G1=[1, 1], G2=[6, 2])
    rod = cards("PROD", PID=[4], MID=1, A=1e-3)
    fine = refined(
        Model(
            dict(m.tables) | {t.card: t for t in (beams, ends, rods, rod)}, {}, m.case
        )
    )
    assert len(fine["CBEAM"]) == 3  # that of equal ends in halves
    assert fine["CROD"].ids[:2].tolist() == [21, 22]
    assert len(fine["CROD"]) == 3  # that along a bar in halves
    assert (
        np.unique(np.concatenate([fine[c].ids for c in ("CBAR", "CBEAM", "CROD")])).size
        == 16
    )


def test_new_nodes_are_in_the_rigid_elements_of_those_about_them() -> None:
    m = plate(2)
    at = positions(m)
    edge = m["GRID"].ids[at[:, 0] == 1.0]
    hub = cards("GRID", ID=[90, 91], X1=1.2, X2=0.35)
    rigid = cards("RBE2", EID=[50], GN=90, CM="123456", GM=ragged(edge))
    mean = cards("RBE3", EID=[51], REFGRID=91, REFC="123456", G=ragged(edge), C=ragged(["123"] * edge.size),
                 WT=ragged(1.0 + np.arange(edge.size)), GM=ragged([]), CM=ragged(np.array([], dtype="U6")))  # fmt: skip
    more: dict[str, Table] = {"RBE2": rigid, "RBE3": mean}
    fine = refined(
        Model(dict(m.tables) | more | {"GRID": stacked(m["GRID"], hub)}, {}, m.case)
    )
    on_edge = fine["GRID"].ids[positions(fine)[:, 0] == 1.0]
    np.testing.assert_array_equal(
        np.sort(fine["RBE2"].ragged("GM").row(0)), np.sort(on_edge)
    )
    joined, weights = fine["RBE3"].ragged("G").row(0), fine["RBE3"].ragged("WT").row(0)
    y = dict(
        zip(fine["GRID"].ids.tolist(), positions(fine)[:, 1].tolist(), strict=True)
    )
    np.testing.assert_allclose(weights, [1 + y[i] / 0.35 for i in joined.tolist()])


def test_what_is_not_split_is_refused() -> None:
    with pytest.raises(UnsupportedError, match="CPYRAM: not refined"):
        refined(solid("CPYRAM5", 1))
    m = solid("CTETRA10", 1)
    holed = m["CTETRA"].with_column("G7", 0 * m["CTETRA"]["G7"])
    with pytest.raises(UnsupportedError, match="CTETRA without some midside nodes"):
        refined(replace(m, tables={**m.tables, "CTETRA": holed}))


@pytest.mark.parametrize("kind", ["quadrilaterals", "triangles", "bricks"])
def test_the_mesh_error_is_that_against_a_fine_mesh(kind: str) -> None:
    coarse, fine = {
        "quadrilaterals": (plate(5), plate(40)),
        "triangles": (plate(6, triangles=True), plate(36, triangles=True)),
        "bricks": (solid("CHEXA8", 2), solid("CHEXA8", 7)),
    }[kind]
    with EmbeddedSolver().open(coarse) as analysis:
        modes = analysis.modes(ModesRequest(3)).modes
    found = mesh_errors(coarse, modes, EmbeddedSolver())
    true = modes.frequencies / frequencies(fine, 3) - 1
    assert (np.abs(true) > 0.002).all()
    ratio = found.relative / true
    assert (
        (ratio > 0.5) & (ratio < 2)
    ).all()  # an estimate: the order is not reached on meshes this coarse
    assert found.nodes[1] > 2 * found.nodes[0]


def test_rigid_body_modes_have_no_mesh_error() -> None:
    m = plate(4)
    free = Model(
        {c: t for c, t in m.tables.items() if c != "SPC1"}
        | {"GRID": grid(positions(m))},
        {},
    )
    with EmbeddedSolver().open(free) as analysis:
        found = mesh_errors(
            free, analysis.modes(ModesRequest(9)).modes, EmbeddedSolver()
        )
        alone = mesh_errors(
            free, analysis.modes(ModesRequest(6)).modes, EmbeddedSolver()
        )
        below = analysis.modes(
            ModesRequest(band=(0.0, 0.1 * float(found.frequencies[6])))
        )
    assert len(below.modes) == 6
    assert "rounding" not in below.proof  # which is all that they are
    assert np.isnan(alone.relative).all()
    assert np.isnan(found.relative[:6]).all()
    assert np.isfinite(found.relative[6:]).all()


def test_a_truss_has_nothing_to_split() -> None:
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    rods = cards("CROD", EID=[1, 2], PID=1, G1=[1, 1], G2=[2, 3])
    m = model(
        grid(xyz),
        rods,
        cards("PROD", PID=[1], MID=1, A=1e-3),
        steel(),
        spc(np.array([2, 3]), "123"),
        spc=1,
    )
    with EmbeddedSolver().open(m) as analysis:
        found = mesh_errors(m, analysis.modes(ModesRequest(2)).modes, EmbeddedSolver())
    assert not found.off.size
    assert found.in_words().startswith("no element of the deck would be split")
