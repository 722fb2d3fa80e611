"""Beams, bars, rods and their reductions against recorded MSC Nastran 2019 runs (see the README of
the data).

- `003_svanberg_bar/barMatrices.mat`: stiffness and mass of one CBAR, length 1.
- `cantilever_bar`: ten CBAR; whole, Guyan and Craig-Bampton reduced onto node 6, in one part and in
  two.
- `three_element_types`: CBEAM and CBAR with shear flexibility joined by CROD; whole, Guyan and
  Craig-Bampton.
- `002`, `003`: displacements under a tip force, mode shapes (MAC), from the h5 files.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import eigh

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.assembly import System, assemble
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.static import Condensed, craig_bampton
from ringtrue.shapes import mac
from ringtrue.solvers.registry import solver

FE = Path(__file__).parents[2].parent / "shared/data/fe/msc2019"
PRINTED = 2e-6  # seven digits in the f06
CANTILEVER = "superelements/cantilever_bar/no_super/noReduction.dat"
TYPES = "superelements/three_element_types/no_super/noReduction-000.dat"
pytestmark = pytest.mark.data


def path(name: str) -> Path:
    if not (FE / name).exists():
        pytest.skip(f"reference data not found: {FE / name}")
    return FE / name


def system(name: str) -> System:
    return assemble(read_deck(path(name)))


def hertz(K: Any_, M: Any_) -> Float:
    """Frequencies with massless coordinates at infinity: of M x = μ K x."""
    mu = eigh(M, K, eigvals_only=True)[::-1]
    return 1 / (2 * np.pi * np.sqrt(mu[mu > 1e-12 * mu[0]]))


def rows(s: System, node: int) -> Int:
    return np.flatnonzero(s.free.node == node)


def test_matrices_of_a_bar() -> None:
    want = loadmat(
        path("system_verification/003_svanberg_bar/nastran_runs/barMatrices.mat")
    )
    s = system("system_verification/003_svanberg_bar/nastran_runs/barmat.dat")
    np.testing.assert_allclose(
        s.stiffness.toarray(), want["k"], rtol=1e-9, atol=1e-9 * np.abs(want["k"]).max()
    )
    np.testing.assert_allclose(s.mass.toarray(), want["m"], rtol=1e-9)


def test_matrices_of_a_bar_as_direct_input(tmp_path: Path) -> None:
    """The punched DMIG of the same run, chosen by K2GG and M2GG."""
    lines = (
        path("system_verification/003_svanberg_bar/nastran_runs/barmat.pch")
        .read_text()
        .splitlines()
    )
    bulk, use = [], False
    for line in lines:
        use = (
            use
            if line.startswith("*")
            else line.startswith("GRID") or line.split()[:2][-1] in ("K10", "M10")
        )
        bulk += [line] if use else []
    head = [
        "SOL 103",
        "CEND",
        "K2GG = K10",
        "M2GG = M10",
        "BEGIN BULK",
        "PARAM,AUTOSPC,NO",
    ]
    (tmp_path / "a.bdf").write_text("\n".join([*head, *bulk, "ENDDATA", ""]))
    want = loadmat(
        path("system_verification/003_svanberg_bar/nastran_runs/barMatrices.mat")
    )
    s = assemble(read_deck(tmp_path / "a.bdf"))
    np.testing.assert_allclose(
        s.stiffness.toarray(), want["k"], rtol=1e-9, atol=1e-9 * np.abs(want["k"]).max()
    )
    np.testing.assert_allclose(s.mass.toarray(), want["m"], rtol=1e-9)


def test_three_element_types() -> None:
    """CBEAM, CBAR and CROD in one frame; shear factors of 0.85."""
    got = (
        solver("embedded")
        .open(read_deck(path(TYPES)))
        .modes(ModesRequest(10))
        .modes.frequencies
    )
    want = [
        0.1987976,
        0.3974492,
        0.7054771,
        0.8603456,
        1.717969,
        1.980850,
        2.199863,
        3.712462,
        4.380781,
        4.407542,
    ]
    np.testing.assert_allclose(got, want, rtol=PRINTED)


@pytest.mark.parametrize(
    ("deck", "nodes", "want"),
    [
        (CANTILEVER, [6], [359.0738, 2934.100]),
        (
            TYPES,
            [11, 25],
            [
                0.2233058,
                0.4464976,
                0.8407104,
                2.300993,
                4.566558,
                5.168626,
                26.57986,
                26.57986,
            ],
        ),
    ],
)
def test_guyan(deck: str, nodes: list[int], want: list[float]) -> None:
    s = system(deck)
    r = craig_bampton(
        s.stiffness, s.mass, np.concatenate([rows(s, n) for n in nodes]), 0
    )
    np.testing.assert_allclose(
        hertz(r.stiffness, r.mass)[: len(want)], want, rtol=PRINTED
    )


FIXED = [1380.011, 8287.086, 8933.322]
TYPES_FIXED = [0.4013047, 0.8020365, 1.129524, 1.559040]


@pytest.mark.parametrize(
    ("deck", "nodes", "fixed", "want"),
    [
        (CANTILEVER, [6], FIXED, [349.7303, 2168.717, 6015.472, 11974.12, 29336.18]),
        (
            TYPES,
            [11, 25],
            TYPES_FIXED,
            [
                0.1988011,
                0.3977102,
                0.7068220,
                0.8616990,
                1.887159,
                2.151777,
                2.252132,
                7.353737,
                7.599359,
                8.003438,
            ],
        ),
    ],
)
def test_craig_bampton(
    deck: str, nodes: list[int], fixed: list[float], want: list[float]
) -> None:
    s = system(deck)
    r = craig_bampton(
        s.stiffness, s.mass, np.concatenate([rows(s, n) for n in nodes]), len(fixed)
    )
    np.testing.assert_allclose(r.frequencies, fixed, rtol=PRINTED)
    np.testing.assert_allclose(
        hertz(r.stiffness, r.mass)[: len(want)], want, rtol=PRINTED
    )


@pytest.mark.parametrize(
    ("count", "want"),
    [
        (1, [349.7555, 2182.490, 6733.634, 18222.00]),
        (
            3,
            [
                349.7289,
                2167.436,
                6008.068,
                11670.88,
                19073.61,
                28653.90,
                43490.38,
                104304.1,
            ],
        ),
    ],
)
def test_craig_bampton_of_two_parts(count: int, want: list[float]) -> None:
    """Each half of the cantilever by its own modes, joined at node 6."""
    s = system(CANTILEVER)
    joint = rows(s, 6)
    parts = [np.flatnonzero(s.free.node < 6), np.flatnonzero(s.free.node > 6)]
    r = [part(s, joint, inner, count, first=i == 0) for i, inner in enumerate(parts)]
    b, n = joint.size, joint.size + 2 * count
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for i, one in enumerate(r):
        at = np.concatenate([np.arange(b), b + i * count + np.arange(count)])
        K[np.ix_(at, at)] += one.stiffness
        M[np.ix_(at, at)] += one.mass
    np.testing.assert_allclose(hertz(K, M), want, rtol=PRINTED)


def part(s: System, joint: Int, inner: Int, count: int, *, first: bool) -> Condensed:
    """The reduction of one half; what both halves have at the joint goes with the first."""
    at = np.concatenate([joint, inner])
    K, M = (A[at][:, at].tolil() for A in (s.stiffness, s.mass))
    if not first:
        K[: joint.size, : joint.size] = 0.0
        M[: joint.size, : joint.size] = 0.0
    return craig_bampton(K.tocsr(), M.tocsr(), np.arange(joint.size), count)


def test_a_condensation_is_exact_in_statics() -> None:
    s = system(CANTILEVER)
    r = craig_bampton(s.stiffness, s.mass, rows(s, 11), 0)
    load = np.array([1.0, 0.3])
    f = np.zeros(len(s.free))
    f[r.kept] = load
    np.testing.assert_allclose(
        r.transform @ np.linalg.solve(r.stiffness, load),
        np.linalg.solve(s.stiffness.toarray(), f),
        rtol=1e-9,
    )


COMPONENTS = ("X", "Y", "Z", "RX", "RY", "RZ")


def recorded(file: Path, what: str) -> Float:
    """Nodal results (result, node, 6), nodes by ascending id."""
    with h5py.File(file) as f:
        data = f[f"NASTRAN/RESULT/NODAL/{what}"][:]
    data = data[np.lexsort([data["ID"], data["DOMAIN_ID"]])]
    values = np.stack([data[c] for c in COMPONENTS], axis=1)
    return np.asarray(values.reshape(np.unique(data["DOMAIN_ID"]).size, -1, 6))


TIP = {6: 1e8 * np.array([0.25, 0.5, -1.0])}
LOADS = {  # the FORCE cards of each subcase: node, force
    "001_ten_bar_truss": [{1: [0.0, 0.0, -1.0]}, {1: [-1.0, 0.0, -1.0]}],
    "002_svanberg_beam": [TIP],
    "003_svanberg_bar": [TIP],
    "004_72_bar_truss": [
        {1: [5000.0, 5000.0, -5000.0]},
        {n: [0.0, 0.0, -5000.0] for n in (1, 2, 3, 4)},
    ],
}


@pytest.mark.parametrize("case", LOADS)
def test_static_displacements(case: str) -> None:
    folder = path(f"system_verification/{case}/nastran_runs")
    want = recorded(folder / "static.h5", "DISPLACEMENT")
    with solver("embedded").open(read_deck(folder / "modes.dat")) as analysis:
        order = np.lexsort([analysis.dofs.direction, analysis.dofs.node])
        loads = np.zeros((len(analysis.dofs), len(want)))
        for i, forces in enumerate(LOADS[case]):
            for node, force in forces.items():
                loads[np.flatnonzero(analysis.dofs.node == node)[:3], i] = force
        got = analysis.static(loads)[order].T.reshape(want.shape)
    np.testing.assert_allclose(got, want, rtol=1e-7, atol=1e-9 * np.abs(want).max())


@pytest.mark.parametrize(
    "case", ["001_ten_bar_truss", "002_svanberg_beam", "003_svanberg_bar"]
)
def test_mode_shapes(case: str) -> None:
    folder = path(f"system_verification/{case}/nastran_runs")
    want = recorded(folder / "modes.h5", "EIGENVECTOR")
    with solver("embedded").open(read_deck(folder / "modes.dat")) as analysis:
        modes, dofs = analysis.modes(ModesRequest(len(want))).modes, analysis.dofs
    got = modes.shapes[np.lexsort([dofs.direction, dofs.node])]
    np.testing.assert_allclose(
        np.diag(mac(got, want.reshape(len(want), -1).T)), 1.0, atol=1e-9
    )
