"""Checks of a deck: each fault alone in an otherwise sound model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.checks.deck import DeckReport, check_deck
from ringtrue.checks.elements import free_edges_in_words, shell_edges
from ringtrue.checks.materials import (
    GroundCheck,
    from_rigid_body_mass,
    ground_check,
    ground_findings,
    mass_properties,
    unconstrained,
    whole_mass,
)
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.errors import InputError, NumericalError
from ringtrue.fem.assembly import assemble

DATA = Path(__file__).parents[2].parent / "shared/data/fe"
SQUARE = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,1.,1.,0.\nGRID,4,,0.,1.,0.\n"
SOUND = SQUARE + "CQUAD4,1,1,1,2,3,4\nPSHELL,1,1,.01,1\nMAT1,1,2.1+11,,.3,7850.\n"
CUBE = (
    SQUARE
    + "GRID,5,,0.,0.,1.\nGRID,6,,1.,0.,1.\nGRID,7,,1.,1.,1.\nGRID,8,,0.,1.,1.\n"
    + "MAT1,1,2.1+11,,.3,7850.\nPSOLID,1,1\n"
)


def report(folder: Path, text: str, units: str = "SI") -> DeckReport:
    path = folder / "a.bdf"
    path.write_text(text)
    return check_deck(survey(path).model, units)


@pytest.mark.parametrize(("across", "found"), [(1, ["CQUAD4 1 and 2 more"]), (2, [])])
def test_strips_of_one_element_between_free_edges(
    tmp_path: Path, across: int, found: list[str]
) -> None:
    nodes = "".join(
        f"GRID,{10 * i + j},,{i}.,{j}.,0.\n" for i in range(1, 5) for j in range(3)
    )
    corners = [10 * i + j for j in range(across) for i in range(1, 4)]
    quads = "".join(
        f"CQUAD4,{e},1,{n},{n + 10},{n + 11},{n + 1}\n"
        for e, n in enumerate(corners, 1)
    )
    got = report(tmp_path, nodes + quads + "PSHELL,1,1,.1,1\nMAT1,1,2.1+11,,.3,7850.\n")
    strips = [f.text for f in got.findings if "between two free edges" in f.text]
    assert [text.split(":")[0] for text in strips] == found


def test_a_sound_deck_has_no_findings(tmp_path: Path) -> None:
    got = report(tmp_path, SOUND)
    assert got.ok
    assert not got.findings
    assert got.cards == {"CQUAD4": 1, "GRID": 4, "MAT1": 1, "PSHELL": 1}


@pytest.mark.parametrize(
    ("extra", "severity", "line", "text"),
    [
        ("GRID,9,,5.,5.,0.\n", "warning", 8, "GRID 9: no element is connected to it"),
        ("CROD,2,7,1,2\n", "error", 8, "CROD 2: PID names PROD 7: not there"),
        ("PROD,7,1,1.\n", "info", 8, "PROD 7: nothing uses it"),
        ("MAT1,2,7.+10,,.3\n", "info", 8, "MAT1 2: nothing uses it"),
        ("CTRIA3,2,1,1,2,2\n", "error", 8, "CTRIA3 2: is collapsed"),
        ("CQUAD4,2,1,1,3,2,4\n", "error", 8, "CQUAD4 2: is collapsed"),
        ("GRID,9,,.9,.9,.5\nCQUAD4,2,1,1,2,9,4\n", "warning", 9, "CQUAD4 2: is warped"),
        ("GRID,9,,.2,.2,0.\nCQUAD4,2,1,1,2,9,4\n", "error", 9, "CQUAD4 2: has a corner of 180"),
        ("GRID,9,,.5,.001,0.\nCTRIA3,2,1,1,2,9\nGRID,8,,.5,-9.,0.\nCTRIA3,3,1,1,8,9\nGRID,7,,.501,-9.,0.\nCTRIA3,4,1,1,8,7\n",
         "warning", 13, "CTRIA3 4: has an aspect ratio over 20"),
        ("CQUAD4,2,1,3,4,1,2\n", "warning", 8, "CQUAD4 2: it has the nodes, the property and the "
                                               "offsets of another"),
        ("CONM2,2,4,,2.\n,1.,,30.\n", "warning", 8, "CONM2 2: its radius of gyration is 3.87, "
                                                    "the model 1.41 in size"),
        ("CBAR,2,7,1,2,0.,0.,1.\nPBAR,7,1,.1\n", "info", 9, "PBAR 7: I1 and I2 are 0: no "
                                                            "stiffness in bending"),
        ("GRID,9,,1.,1.,0.\nCELAS2,2,1.,9,1\n", "warning", 3, "GRID 3: at one place with another "
                                                              "node"),
        ("PROD,7,1,1.\nGRID,9,,1.,1.,0.\nCROD,2,7,3,9\n", "error", 10, "CROD 2: has no length"),
        ("CELAS2,2,1.,1,1\nMAT1,2,1.,,.6\n", "warning", 9, "MAT1 2: Poisson's ratio 0.6"),
        ("CELAS2,2,1.,1,1\nMAT1,2,7.2+10,6.4+10,.3\n", "warning", 9, "MAT1 2: E / (2 (1 + NU) G) "
                                                                     "is 0.433, not 1"),
        ("CROD,2,7,1,3\nPROD,7,1,-.1\n", "error", 9, "PROD 7: A is -0.1, below 0"),
        ("CQUAD4,2,7,1,2,3,4\nPCOMP,7\n,1,.01,0.,,1,-.02,0.\n", "error", 9, "PCOMP 7: T is "
                                                                            "-0.02, below 0"),
        ("CELAS2,2,-3.,1,1\n", "warning", 8, "CELAS2 2: K is -3, below 0: taken as a negative "
                                             "stiffness"),
        ("CROD,2,7,1,3\nPROD,7,1,-.1\nPARAM,NEGSTIFF,YES\n", "warning", 9, "PROD 7: A is "
                                                                           "-0.1, below 0"),
        ("PBAR,2,1,1.,2.,2.,1.\n,,,,,,,,,\n,,,-3.\n", "error", 8, "PBAR 2: I12 -3 is over the "
                                                                  "root of I1 I2"),
        ("MAT8,2,1.,1.,1.,1.\n", "error", 8, "MAT8 2: NU12 1 is not below sqrt(E1/E2) = 1"),
        ("MAT8,2,1.,,.3,1.\n", "error", 8, "MAT8 2: E1 and E2 must not be 0"),
        ("MAT2,2,1.,2.,,1.,,1.\n", "error", 8, "MAT2 2: its elasticity matrix has a negative"),
        ("GRID,9,,.51,.51,0.\nCQUAD4,2,1,1,2,9,4\n", "warning", 9, "CQUAD4 2: has corner "
                                                                   "Jacobians"),
        ("GRID,9,,.1,0.,0.\nCTRIA6,2,1,1,2,3,9\n", "error", 9, "CTRIA6 2: has a mid-side node "
                                                               "outside"),
        ("PSOLID,2,1\nGRID,9,,0.,0.,1.\nCTETRA,2,2,1,2,4,9\n", "warning", 10, "CTETRA 2: has "
                                                                              "four nodes"),
        ("CTRIA3,1,1,1,2,3\n", "warning", 8, "CTRIA3 1: CQUAD4 has the same number"),
        ("SNORM,1,,0.,0.,1.\n", "info", 0, "SNORM: kept, not applied"),
        ("DESVAR,1,T,2.\n", "info", 0, "DESVAR: kept, not applied"),
        ("MDLPRM,OFFDEF,NOMASS\n", "info", 0, "MDLPRM: kept, not applied"),
        ("CTRIA3,2,1,1,2,3\n", "info", 0, "2 shell edges between elements of opposite normals, "
                                          "at nodes 1 2 3"),
    ],
)  # fmt: skip
def test_each_fault_is_found(
    tmp_path: Path, extra: str, severity: str, line: int, text: str
) -> None:
    found = report(tmp_path, SOUND + extra, "").findings
    hits = [f for f in found if f.text.startswith(text)]
    assert len(hits) == 1, found
    assert (hits[0].severity, hits[0].line, hits[0].file) == (
        severity,
        line,
        str(tmp_path / "a.bdf") if line else "",
    )
    place = f"{tmp_path / 'a.bdf'}:{line}: " if line else ""
    assert str(hits[0]).startswith(f"{severity}: {place}{text}")


def test_coincident_nodes_that_are_joined_are_meant(tmp_path: Path) -> None:
    text = (
        SOUND + "GRID,9,,1.,1.,0.\nCBUSH,2,2,3,9,,,,0\nPBUSH,2,K,1.\nCELAS2,3,1.,9,1\n"
    )
    assert not report(tmp_path, text).findings
    by_way = (
        SOUND
        + "GRID,9,,1.,1.,0.\nGRID,10,,1.,1.,0.\nRBE2,2,3,123456,10\nCBUSH,3,2,10,9,,,,0\nPBUSH,2,K,1.\n"
    )
    assert not report(tmp_path, by_way).findings


@pytest.mark.parametrize(
    ("card", "nodes", "turned"),
    [
        ("CHEXA", [1, 2, 3, 4, 5, 6, 7, 8], [5, 6, 7, 8, 1, 2, 3, 4]),
        ("CPENTA", [1, 2, 3, 5, 6, 7], [5, 6, 7, 1, 2, 3]),
        ("CPYRAM", [1, 2, 3, 4, 5], [4, 3, 2, 1, 5]),
        ("CTETRA", [1, 2, 3, 5], [2, 1, 3, 5]),
    ],
)
def test_solids_inside_out(
    tmp_path: Path, card: str, nodes: list[int], turned: list[int]
) -> None:
    def text(n: list[int]) -> str:
        fields = [str(x) for x in n]
        return (
            CUBE
            + f"{card},1,1,{','.join(fields[:6])}\n"
            + (f",{','.join(fields[6:])}\n" if fields[6:] else "")
        )

    assert not [
        f for f in report(tmp_path, text(nodes)).findings if f.severity == "error"
    ]
    errors = [
        f.text for f in report(tmp_path, text(turned)).findings if f.severity == "error"
    ]
    assert errors == [f"{card} 1: is inside out: negative volume"]


@pytest.mark.parametrize(
    ("modulus", "density", "units", "hint"),
    [
        ("2.1+11", "7.85-9", "", "they are so in no unit system"),
        ("2.1+11", "7.85-9", "SI", "they are so in no unit system"),
        ("2.1+11", "7850.", "mm-t-s", "they would be in SI"),
        ("2.1+5", "7.85-9", "SI", "they would be in mm-t-s"),
        ("2.1+8", "7.85-6", "mm-t-s", "they would be in mm-kg-s"),
    ],
)
def test_units_that_cannot_be(
    tmp_path: Path, modulus: str, density: str, units: str, hint: str
) -> None:
    text = SOUND.replace("2.1+11", modulus).replace("7850.", density)
    assert any(
        hint in f.text and f.severity == "warning"
        for f in report(tmp_path, text, units).findings
    )


def test_wtmass_counts_and_sizes_are_judged(tmp_path: Path) -> None:
    inches = (
        SOUND.replace("2.1+11", "3.+7").replace("7850.", ".283")
        + "PARAM,WTMASS,.00259\n"
    )
    assert not report(tmp_path, inches, "in-lbf-s").findings
    millimetres = (
        SOUND.replace("2.1+11", "2.1+5")
        .replace("7850.", "7.85-9")
        .replace("1.,", "9999.,")
    )
    assert not report(tmp_path, millimetres, "mm-t-s").findings
    assert not report(
        tmp_path,
        millimetres.replace("2.1+5", "2.1+8").replace("7.85-9", "7.85-6"),
        "mm-kg-s",
    ).findings
    assert any(
        "long in SI" in f.text
        for f in report(tmp_path, SOUND.replace("1.,", "9999.,"), "SI").findings
    )
    with pytest.raises(InputError, match="did you mean 'mm-t-s'"):
        report(tmp_path, SOUND, "mm-t")


def test_mass_of_a_block_of_point_masses() -> None:
    """Closed form: points m_i at x_i with R = [I, -[x]]."""
    rng = np.random.default_rng(3)
    x, m = rng.normal(size=(7, 3)), rng.uniform(1, 2, 7)
    rigid = np.zeros((6, 6))
    for xi, mi in zip(x, m, strict=True):
        cross = np.array([[0, xi[2], -xi[1]], [-xi[2], 0, xi[0]], [xi[1], -xi[0], 0]])
        R = np.hstack([np.eye(3), cross])
        rigid += mi * R.T @ R
    got = from_rigid_body_mass(rigid)
    cg = m @ x / m.sum()
    d = x - cg
    inertia = (
        m[:, None, None]
        * (
            (d**2).sum(axis=1)[:, None, None] * np.eye(3)
            - d[:, :, None] * d[:, None, :]
        )
    ).sum(axis=0)
    assert got.mass == pytest.approx(m.sum(), rel=1e-14)
    assert got.even
    np.testing.assert_allclose(got.cg, cg, atol=1e-14)
    np.testing.assert_allclose(got.inertia, inertia, atol=1e-12)
    with pytest.raises(NumericalError, match="no mass"):
        from_rigid_body_mass(np.zeros((6, 6)))


def test_mass_of_a_plate_held_and_whole(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text(
        "CEND\nSPC=1\nBEGIN BULK\n" + SOUND + "SPC1,1,123456,1,2\nPARAM,WTMASS,.5\n"
    )
    model = read_deck(tmp_path / "a.bdf")
    whole = whole_mass(model)
    assert whole.mass == pytest.approx(7850 * 0.01 * 0.5, rel=1e-12)
    np.testing.assert_allclose(whole.cg, [0.5, 0.5, 0.0], atol=1e-12)
    assert mass_properties(assemble(model)).mass == pytest.approx(
        whole.mass / 2, rel=1e-12
    )  # lumped: two nodes are held


@pytest.mark.data
def test_mass_against_the_recorded_grid_point_weight_generator() -> None:
    """MSC Nastran 2020, GRDPNT 0 of noreduction-000.f06: mass, centre of gravity and I(S), seven
    digits printed.
    """
    path = (
        DATA / "msc2019/superelements/three_element_types/no_super/noReduction-000.dat"
    )
    if not path.exists():
        pytest.skip(f"needs {path}")
    got = whole_mass(read_deck(path))
    assert got.mass == pytest.approx(6.635254e3, rel=1e-6)
    np.testing.assert_allclose(got.cg, [1.860574e3, -180.0, 0.0], rtol=1e-6, atol=1e-9)
    assert got.inertia[0, 0] == pytest.approx(2.151230e8, rel=1e-6)


def ground(folder: Path, text: str) -> tuple[GroundCheck, list[str]]:
    """The ground check of a deck, and the severities of its findings."""
    (folder / "a.bdf").write_text(text)
    model = read_deck(folder / "a.bdf")
    check = ground_check(assemble(unconstrained(model)))
    return check, [f.severity for f in ground_findings(model, check)]


def test_a_free_structure_passes_the_ground_check_far_from_the_origin(
    tmp_path: Path,
) -> None:
    far = SOUND.replace("1.,", "9.+4,")
    check, found = ground(
        tmp_path, "CEND\nSPC=1\nBEGIN BULK\n" + far + "SPC1,1,123456,1\n"
    )
    assert check.ok
    assert not found
    assert check.worst == ((),) * 6


def test_the_energy_of_a_grounded_spring(tmp_path: Path) -> None:
    """k/2 for a unit shift; the arm about the centre of the nodes is half a side: k/8 for a unit
    turn.
    """
    check, found = ground(tmp_path, SOUND + "CELAS2,2,1.+6,2,3\n")
    np.testing.assert_allclose(
        check.energy, [0, 0, 0.5e6, 0.125e6, 0.125e6, 0], rtol=1e-6, atol=1e-3
    )
    assert found == ["info"] * 3
    assert check.worst[2][0] == "2+Z"


def test_a_spring_between_nodes_apart_is_no_rigid_link(tmp_path: Path) -> None:
    """It joins z of nodes one side apart: k/2 for a unit turn about y, of which x and z shifts know
    nothing.
    """
    check, found = ground(tmp_path, SOUND + "CELAS2,2,1.+6,1,3,2,3\n")
    np.testing.assert_allclose(
        check.energy, [0, 0, 0, 0, 0.5e6, 0], rtol=1e-6, atol=1e-3
    )
    assert found == ["warning"]


def test_a_direction_without_stiffness_holds_only_rounding(tmp_path: Path) -> None:
    """Bars on a line that bend in one plane alone, in a frame turned against basic."""
    nodes = "".join(f"GRID,{i},1,0.,{0.572 * i:.3f},0.,1\n" for i in range(1, 12))
    bars = "".join(f"CBAR,{i},1,{i},{i + 1},0.,0.,1.\n" for i in range(1, 11))
    frame = "CORD2R,1,,0.,0.,0.,0.,0.,1.\n,.96593,-.25882,0.\n"
    check, found = ground(
        tmp_path,
        frame + nodes + bars + "PBAR,1,1,.07175,9.83-6,,3.68-5\nMAT1,1,1.04+7,3.9+6\n",
    )
    assert check.ok
    assert not found


def test_free_edges_and_their_chains(tmp_path: Path) -> None:
    """A ring of eight quads around a hole: 12 outer and 4 inner free edges, 8 shared."""
    grid = [
        f"GRID,{10 * i + j + 11},,{i}.,{j}.,0.\n" for i in range(4) for j in range(4)
    ]
    cells = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    quads = [
        f"CQUAD4,{k},1,{10 * i + j + 11},{10 * i + j + 21},{10 * i + j + 22},{10 * i + j + 12}\n"
        for k, (i, j) in enumerate(cells, 1)
    ]
    (tmp_path / "a.bdf").write_text(
        "".join([*grid, *quads, "PSHELL,1,1,.01,1\nMAT1,1,2.1+11,,.3,7850.\n"])
    )
    edges = shell_edges(read_deck(tmp_path / "a.bdf"))
    assert edges.number == 24
    assert len(edges.free) == 16
    assert sorted(np.bincount(edges.part).tolist()) == [4, 12]
    assert not len(edges.flipped)
    words = "16 of 24 shell edges are free, in 2 chains; the shortest has 4, at nodes 22 23 32 33"
    assert free_edges_in_words(edges) == words


def test_a_folded_brick(tmp_path: Path) -> None:
    text = (
        CUBE.replace("GRID,7,,1.,1.,1.", "GRID,7,,.3,.3,.3")
        + "CHEXA,1,1,1,2,3,4,5,6\n,7,8\n"
    )
    assert any("is folded" in f.text for f in report(tmp_path, text).findings)


def test_a_brick_without_its_nodes(tmp_path: Path) -> None:
    text = CUBE + "CHEXA,1,1,11,2,3,4,5,6\n,7,8\n"
    assert [
        f.text for f in report(tmp_path, text).findings if f.severity == "error"
    ] == ["CHEXA 1: G1 names GRID or SPOINT 11: not there"]


def test_tables_of_properties_are_told(tmp_path: Path) -> None:
    """PELAST, PBUSHT, PDAMPT: the nominal values hold, and the check says so."""
    deck = tmp_path / "t.bdf"
    deck.write_text(
        "BEGIN BULK\nGRID,1\nGRID,2,,1.\nCELAS1,1,2,1,1,2,1\nPELAS,2,3.\nPELAST,2,,,4\nENDDATA\n"
    )
    assert any(
        f.severity == "info" and f.text.startswith("PELAST: kept")
        for f in check_deck(read_deck(deck)).findings
    )
