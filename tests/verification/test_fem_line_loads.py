"""Loads between the nodes of beams (PLOAD1): one element against closed forms.

y |  q a length, or P at a
  A-----------------------B  x       held ends answer qL/2 and qL²/12, P b²(3a + b)/L³ and P a b²/L²
               L                     (Roark's Formulas for Stress and Strain, table 8.1)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_loaded_deck
from ringtrue.errors import DeckError
from ringtrue.fem.element_cards import mesh
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.loads import load_vectors

E, A, I1, L, Q = 2e11, 1e-3, 2e-6, 2.0, 1000.0
SLENDER = "PBAR,1,1,1.-3,2.-6,3.-6,1.-6"
SHORT = f"{SLENDER}\n,,,,,,,,\n,.8,.8"
TAPERED = "PBEAM,1,1,2.-3,4.-6,6.-6,,2.-6\n,,,,,,,,\n,YES,1.,1.-3,2.-6,3.-6,,1.-6\n,,,,,,,,\n,0.,0."
ALONG_X = ((0.0, 0, 0), (L, 0, 0))


def written(
    path: Path,
    load: str,
    section: str = SLENDER,
    held: str = "1,2",
    more: str = "",
    ends=ALONG_X,
) -> Path:
    nodes = [
        f"GRID,{i + 1},,{','.join(str(float(c)) for c in x)}"
        for i, x in enumerate(ends)
    ]
    beam = f"{'CBEAM' if 'PBEAM' in section else 'CBAR'},1,1,1,2,0.,1.,0.{more}"
    rest = [
        beam,
        section,
        "MAT1,1,2.+11,,.3",
        load,
        f"SPC1,1,123456,{held}",
        "CELAS2,9,1.,9,1",
        "GRID,9",
    ]
    file = path / "d.bdf"
    file.write_text(
        "\n".join(["CEND", "SPC=1", "LOAD=9", "BEGIN BULK", *nodes, *rest]) + "\n"
    )
    return file


def forces(path: Path) -> Float:
    """At the two ends, (2, 6)."""
    model, cases = read_loaded_deck(path)
    return load_vectors(model, mesh(model).dofs, cases)[:12, 0].reshape(2, 6)


def tip(path: Path) -> Float:
    """The motion of node 2, (6,)."""
    model, cases = read_loaded_deck(path)
    with EmbeddedSolver().open(model) as analysis:
        return analysis.static(load_vectors(model, analysis.dofs, cases))[6:12, 0]


def point(a: float, size: float = 1.0, shear: float = 0.0) -> Float:
    """Forces and moments at both ends, (2, 2), of `size` across at a; `shear` is 12 EI/(kGA L²)."""
    b = L - a
    moments = (
        size
        * a
        * b
        / L**2
        * np.array([b + shear * L / 2, -a - shear * L / 2])
        / (1 + shear)
    )
    first = size * b / L + moments.sum() / L
    return np.array([[first, moments[0]], [size - first, moments[1]]])


@pytest.mark.parametrize(
    ("load", "want"),
    [
        (
            "FY,FR,0.,1000.,1.,1000.",
            [[Q * L / 2, Q * L**2 / 12], [Q * L / 2, -Q * L**2 / 12]],
        ),
        (
            "FYE,LE,0.,1000.,2.,1000.",
            [[Q * L / 2, Q * L**2 / 12], [Q * L / 2, -Q * L**2 / 12]],
        ),
        (
            "FYE,LE,0.,0.,2.,1000.",
            [[3 * Q * L / 20, Q * L**2 / 30], [7 * Q * L / 20, -Q * L**2 / 20]],
        ),
        ("FY,LE,.5,700.", point(0.5, 700.0)),
        ("FY,FR,.25,700.,.25", point(0.5, 700.0)),
        ("FY,FR,0.,700.", [[700, 0], [0, 0]]),
        ("FY,FR,1.,700.", [[0, 0], [700, 0]]),
        ("MZ,FR,.5,700.", [[-1.5 * 700 / L, -700 / 4], [1.5 * 700 / L, -700 / 4]]),
    ],
)
def test_held_ends(tmp_path: Path, load: str, want: Float) -> None:
    got = forces(written(tmp_path, f"PLOAD1,9,1,{load}"))
    np.testing.assert_allclose(got[:, [1, 5]], want, atol=1e-8)
    np.testing.assert_allclose(got[:, [0, 2, 3, 4]], 0, atol=1e-9)


def test_shear(tmp_path: Path) -> None:
    got = forces(written(tmp_path, "PLOAD1,9,1,FY,LE,.5,700.", SHORT))
    shear = 12 * E * I1 / (0.8 * E / 2.6 * A * L**2)
    np.testing.assert_allclose(got[:, [1, 5]], point(0.5, 700.0, shear), rtol=1e-9)


def test_a_released_end_carries_no_moment(tmp_path: Path) -> None:
    """Propped: 5qL/8 and qL²/8 at the held end."""
    got = forces(written(tmp_path, "PLOAD1,9,1,FY,FR,0.,1000.,1.,1000.", more="\n,,6"))
    np.testing.assert_allclose(
        got[:, [1, 5]], [[5 * Q * L / 8, Q * L**2 / 8], [3 * Q * L / 8, 0]], atol=1e-9
    )


@pytest.mark.parametrize("reach", [0.3, 1.0])
def test_a_tapered_cantilever(tmp_path: Path, reach: float) -> None:
    """The tip moves by ∫ M (L - x)/EI dx under a load from the root to a share of the length."""
    path = written(
        tmp_path, f"PLOAD1,9,1,FY,FR,0.,1000.,{reach},1000.", TAPERED, held="1"
    )
    loaded = reach * L
    want, _ = quad(
        lambda x: Q * (loaded - x) ** 2 / 2 * (L - x) / (E * 4e-6 * (1 - x / (2 * L))),
        0,
        loaded,
    )
    assert tip(path)[1] == pytest.approx(want, rel=1e-7)


def test_along_and_about_the_axis(tmp_path: Path) -> None:
    got = forces(
        written(tmp_path, "PLOAD1,9,1,FXE,FR,.25,700.\nPLOAD1,9,1,MXE,FR,.75,80.")
    )
    np.testing.assert_allclose(got[:, [0, 3]], [[525, 20], [175, 60]], rtol=1e-9)


def test_offsets_of_the_ends_and_a_load_in_basic(tmp_path: Path) -> None:
    """The beam lies 0.1 below its nodes: the force has an arm about them."""
    got = forces(
        written(tmp_path, "PLOAD1,9,1,FX,FR,.5,700.", more="\n,,,0.,0.,-.1,0.,0.,-.1")
    )
    np.testing.assert_allclose(got.sum(axis=0), [700, 0, 0, 0, -70, 0], atol=1e-9)


@pytest.mark.parametrize(("scale", "total"), [("FR", 500.0), ("FRPR", 400.0)])
def test_a_load_on_the_projected_length(
    tmp_path: Path, scale: str, total: float
) -> None:
    """A beam that rises 3 on 4 under snow."""
    got = forces(
        written(
            tmp_path,
            f"PLOAD1,9,1,FZ,{scale},0.,-100.,1.,-100.",
            ends=((0, 0, 0), (4, 0, 3)),
        )
    )
    np.testing.assert_allclose(got[:, :3].sum(axis=0), [0, 0, -total], atol=1e-9)


@pytest.mark.parametrize(
    ("load", "told"),
    [
        ("PLOAD1,9,1,FY,LE,0.,1.,3.,1.", "X1.* is 3; the beam ends at 2"),
        ("PLOAD1,9,7,FY,LE,0.,1.,1.,1.", "names element 7, which is no CBAR or CBEAM"),
        ("PLOAD1,9,1,FQ,LE,0.,1.,1.,1.", "FQ; allowed are FX FY"),
        ("PLOAD1,9,1,FY,XX,0.,1.,1.,1.", "XX; allowed are LE FR LEPR FRPR"),
        ("PLOAD1,9,1,FY,FR,.7,1.,.5,1.", "must be 0 <= X1 <= X2"),
        ("PLOAD1,9,1,FYE,FRPR,0.,1.,1.,1.", "is read with FX, FY and FZ"),
    ],
)
def test_what_is_refused(tmp_path: Path, load: str, told: str) -> None:
    with pytest.raises(DeckError, match=told):
        forces(written(tmp_path, load))


@pytest.mark.parametrize(
    ("kind", "section", "released"),
    [
        ("MX", "PBAR,1,1,1.-3,2.-6,3.-6", ""),
        ("FY", "PBAR,1,1,1.-3", ""),
        ("FX", SLENDER, "1,1"),
        ("MX", SLENDER, "4,4"),
    ],
)
def test_what_no_beam_can_carry(
    tmp_path: Path, kind: str, section: str, released: str
) -> None:
    """Without stiffness along the load, or free along it at both ends; a load across is carried
    then.
    """
    path = written(
        tmp_path, f"PLOAD1,9,1,{kind},FR,.5,7.", section, more=f"\n,{released}"
    )
    with pytest.raises(DeckError, match="CBAR 1: cannot carry its PLOAD1"):
        forces(path)
    if released:
        across = forces(
            written(tmp_path, "PLOAD1,9,1,FZ,FR,.5,7.", section, more=f"\n,{released}")
        )
        np.testing.assert_allclose(
            across[:, [2, 4]], [[3.5, -7 * L / 8], [3.5, 7 * L / 8]], rtol=1e-9
        )
