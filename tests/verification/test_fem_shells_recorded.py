"""Entries of element matrices that MSC Nastran wrote (EXTSEOUT, DMIGPCH), as kept in the public
repository pyCAFE, and frequencies of meshes, from ../shared/data.

One CQUAD4, E 2e5, ν 0.3, t 0.1, K6ROT 100: the square (0, 0), (2, 0), (2, 2), (0, 2), and the
trapezoid with (1.5, 2) for its third corner.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import grid, model, modes, pshell, shells, steel

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements.shell4 import build

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]])
TRAPEZOID = np.array([[0, 0, 0], [2, 0, 0], [1.5, 2, 0], [0, 2, 0.0]])
PRINTED = 2e-9  # of the largest entry: ten digits
CORPUS = Path(__file__).parents[2].parent / "shared/data/fe/corpus"


def matrix(xyz: Float) -> Float:
    quads = np.array([[1, 2, 3, 4]])
    m = model(
        grid(xyz),
        shells(quads),
        pshell(0.1, TST=5 / 6),
        steel(E=2e5, rho=7.8e-9),
        RESBEND="YES",
    )
    return np.asarray(build(mesh(m).rows("CQUAD4")).stiffness[0])


@pytest.mark.parametrize(
    ("xyz", "diagonal", "first", "drilling"),
    [
        (
            SQUARE,
            [9084.633700] * 8,
            [
                9084.633700,
                3571.236264,
                -5238.095238,
                -274.5329670,
                -5750.915751,
                -3571.236264,
                1904.377289,
                274.5329670,
            ],
            [3.076923077] * 4,
        ),
        (
            TRAPEZOID,
            [
                9902.928651,
                9523.451282,
                8941.294036,
                6776.198535,
                11011.62896,
                10337.00252,
                10049.99434,
                7589.749777,
            ],
            [
                9902.928651,
                3950.663566,
                -6056.390190,
                -653.9602695,
                -6576.827733,
                -4255.745282,
                2730.289271,
                959.0419850,
            ],
            [3.076923077, 3.076923077, 2.307692308, 2.307692308],
        ),
    ],
)
def test_membrane_and_drilling(
    xyz: Float, diagonal: list[float], first: list[float], drilling: list[float]
) -> None:
    """The diagonal and the first row of the membrane, and the drilling, which has no entry between
    two nodes.
    """
    K = matrix(xyz)
    plane = np.flatnonzero(np.tile([1, 1, 0, 0, 0, 0], 4))
    within = PRINTED * max(diagonal)
    np.testing.assert_allclose(K.diagonal()[plane], diagonal, atol=within)
    np.testing.assert_allclose(K[0, plane], first, atol=within)
    np.testing.assert_allclose(K[5::6, 5::6], np.diag(drilling), atol=2e-9)
    np.testing.assert_allclose(
        K[5, [0, 1, 6, 7]], [-0.7692307692, 0.7692307692, 0.0, -0.7692307692], atol=2e-9
    )


def test_bending_and_shear_of_the_square() -> None:
    """The first row of each of w, θx and θy."""
    out = np.flatnonzero(np.tile([0, 0, 1, 1, 1, 0], 4))
    rows = [
        [
            *(
                300.0159184,
                150.0079592,
                -150.0079592,
                -272.7768685,
                -122.7689093,
                -150.0079592,
            ),
            *(
                245.5378186,
                -122.7689093,
                122.7689093,
                -272.7768685,
                150.0079592,
                122.7689093,
            ),
        ],
        [
            *(
                150.0079592,
                157.5781668,
                -2.976190476,
                -122.7689093,
                -121.1816077,
                -0.2289377289,
            ),
            *(
                122.7689093,
                -127.5613391,
                2.976190476,
                -150.0079592,
                145.6428798,
                0.2289377289,
            ),
        ],
        [
            *(
                -150.0079592,
                -2.976190476,
                157.5781668,
                150.0079592,
                0.2289377289,
                145.6428798,
            ),
            *(
                -122.7689093,
                2.976190476,
                -127.5613391,
                122.7689093,
                -0.2289377289,
                -121.1816077,
            ),
        ],
    ]
    np.testing.assert_allclose(
        matrix(SQUARE)[np.ix_(out[:3], out)], rows, atol=PRINTED * 300
    )


def test_bending_and_shear_of_the_trapezoid() -> None:
    """Eigenvalues of the recorded matrix over w, θx and θy. The last two are of a shear that
    alternates from side to side.
    """
    out = np.flatnonzero(np.tile([0, 0, 1, 1, 1, 0], 4))
    found = np.linalg.eigvalsh(matrix(TRAPEZOID)[np.ix_(out, out)])[3:]
    want = [
        *(4.5314836, 6.5561651, 8.7438212, 12.39052, 24.989088),
        *(93.881361, 146.52098, 529.02373, 1806.376),
    ]
    np.testing.assert_allclose(found[:7], want[:7], rtol=1e-4)
    np.testing.assert_allclose(found[7:], want[7:], rtol=8e-3)


def found_in(deck: str) -> Path:
    path = CORPUS / deck
    if not path.exists():
        pytest.skip(f"reference data not found: {path}")
    return path


@pytest.mark.data
@pytest.mark.parametrize(
    ("deck", "rigid", "recorded"),
    [
        (
            "nx/sol111_solid_stress/nx_sine.bdf",  # one CQUAD4 across a strip
            0,
            [
                122.2031397,
                126.0772003,
                126.0976225,
                256.7233490,
                308.5383490,
                308.7424893,
                419.9809,
            ],
        ),
        ("plate_py/plate_py.dat", 6, [6333.01209, 7495.46117, 16238.4585, 17161.5129]),
    ],
)
def test_frequencies_of_nx_nastran(
    deck: str, rigid: int, recorded: list[float]
) -> None:
    found = modes(read_deck(found_in(deck)), rigid + len(recorded))
    np.testing.assert_allclose(found[rigid:], recorded, rtol=1e-5)


@pytest.mark.data
def test_a_triangle_of_msc_nastran() -> None:
    """One CTRIA3 beside one CQUAD4, on bars: 6 % off in the sixth elastic mode without the residual
    bending flexibility of the triangle.
    """
    recorded = [
        46.013924,
        47.388,
        147.61,
        309.85,
        441.41,
        1334.9,
        1793.5,
        2129.7,
        2781.7,
        2884.6,
    ]
    found = modes(read_deck(found_in("random/random_test_bar_plus_tri.bdf")), 13)[3:]
    np.testing.assert_allclose(found, recorded, rtol=1.5e-3)


@pytest.mark.parametrize("length", [1.0, 4.0])
def test_one_element_bends_as_a_beam(length: float) -> None:
    """ν = 0: P L³/(3 E I) + P L/S at the tip of a clamped element; the MITC4 has P L³/(4 E I) +
    P L/S.
    """
    xyz = np.array([[0, 0, 0], [length, 0, 0], [length, 1, 0], [0, 1, 0]])
    cards = (
        grid(xyz),
        shells(np.array([[1, 2, 3, 4]])),
        pshell(0.1),
        steel(E=2e5, nu=0.0),
    )
    stiffness, shear = 2e5 * 0.1**3 / 12, 1e5 * 0.1 * 0.833333
    free = np.flatnonzero(np.repeat([0, 1, 1, 0], 6))
    for params, part in (({}, 3), ({"RESBEND": "NO"}, 4)):
        K = build(mesh(model(*cards, **params)).rows("CQUAD4")).stiffness[0]
        load = np.zeros(24)
        load[[8, 14]] = 0.5
        tip = np.linalg.solve(K[np.ix_(free, free)], load[free])[2]
        assert tip == pytest.approx(
            length**3 / (part * stiffness) + length / shear, rel=1e-6
        )


def test_first_node_and_position_do_not_matter() -> None:
    """A skew element turned in space, its nodes counted from another corner."""
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    skew = np.array(
        [[0, 0, 0.02], [2, 0.3, -0.02], [1.6, 1.9, 0.02], [-0.4, 1.1, -0.02]]
    )
    K = matrix(skew)
    T = np.kron(np.eye(8), turn)
    np.testing.assert_allclose(matrix(skew @ turn.T), T @ K @ T.T, atol=1e-9 * K.max())
    order = np.roll(np.arange(24), -6)
    np.testing.assert_allclose(
        matrix(skew[[1, 2, 3, 0]]), K[np.ix_(order, order)], atol=1e-9 * K.max()
    )
