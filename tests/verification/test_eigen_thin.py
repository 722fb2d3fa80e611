"""Free structures so thin that the first guess of the shift lies far beyond all modes that are
asked for.

Bending frequencies go with the thickness, λ = t² c; the membrane, which sets the guess, does not.
Lanczos must find a shift that tells the modes apart: a handful of blocks a structure, as for a
thick one.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import cards, grid, model, pshell, shells, square, steel

from ringtrue.eigen import lanczos
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.engines import installed
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model

COUNTING = [m for m in installed() if m != "dense"]
MOST = 40  # blocks; without a move of the shift it takes hundreds
# rounding of the membrane in the bending of the thinnest plate, ε (a/t)², and the shear of the
# thickest
NOISE = 5e-4
COARSE = 0.02  # of λ, of the 20th mode on 24 cells, of one element and the other


def shell(t: float) -> Model:
    xyz, quads = square(30, 1.0, 0.7)
    return model(grid(xyz), shells(quads), pshell(t), steel())


def beam(length: float) -> Model:
    n, h = 300, 0.1
    i, x = np.arange(1, n + 1), np.zeros((n + 1, 3))
    x[:, 0] = np.linspace(0, length, n + 1)
    section = {"A": h * h, "I1": h**4 / 12, "I2": h**4 / 6, "J": h**4 / 6}
    p = cards(
        "PBEAM", PID=[1], MID=1, **section, **{f"{k}B": v for k, v in section.items()}
    )
    return model(
        grid(x),
        cards("CBEAM", EID=i, PID=1, GA=i, GB=i + 1, X2=1.0),
        p,
        steel(),
        COUPMASS=1,
    )


def solved(
    m: Model, method: str, monkeypatch: pytest.MonkeyPatch
) -> tuple[EigenModes, int]:
    system = assemble(m)
    count = [0]
    step = lanczos.Krylov.step

    def counted(self: lanczos.Krylov) -> None:
        count[0] += 1
        step(self)

    monkeypatch.setattr(lanczos.Krylov, "step", counted)
    return solve_modes(Pencil(system.stiffness, system.mass, method=method), 20), count[
        0
    ]


@pytest.mark.parametrize("method", COUNTING)
@pytest.mark.parametrize("t", [1e-4, 1e-5])
def test_plates(t: float, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    thick, _ = solved(shell(1e-3), method, monkeypatch)
    monkeypatch.undo()
    thin, blocks = solved(shell(t), method, monkeypatch)
    assert thin.complete
    assert blocks <= MOST
    np.testing.assert_allclose(
        thin.values[6:] / t**2, thick.values[6:] / 1e-6, rtol=NOISE
    )


@pytest.mark.parametrize("method", COUNTING)
def test_a_foil_of_solids(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """λ of the rigid-body modes is rounding, ε k/m = 0.05, not far below the first bending mode; the
    elements, 200 times as wide as thick, bend and twist as a shell does.
    """
    xyz, quads = square(24, 1.0, 0.7)
    n, t = len(xyz), 2e-4
    g = {f"G{i + 1}": np.hstack([quads, quads + n])[:, i] for i in range(8)}
    nodes = grid(np.vstack([xyz, np.add(xyz, [0, 0, t])]))
    hexa = cards("CHEXA", EID=np.arange(1, len(quads) + 1), PID=1, **g)
    found, blocks = solved(
        model(nodes, hexa, cards("PSOLID", PID=[1], MID=1), steel()),
        method,
        monkeypatch,
    )
    assert found.complete
    assert blocks <= MOST
    assert np.abs(found.values[:6]).max() < 0.2 * found.values[6]
    plate, _ = solved(shell(t), method, monkeypatch)
    np.testing.assert_allclose(found.values[6:], plate.values[6:], rtol=COARSE)


@pytest.mark.parametrize("method", COUNTING)
def test_a_long_beam(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """β L = 4.73004, 7.85320 of a free beam; λ = β⁴ EI/ρA in both planes."""
    length = 300.0
    m = beam(length)
    found, blocks = solved(m, method, monkeypatch)
    assert found.complete
    assert blocks <= MOST
    first = np.array([4.730041, 7.853205]) ** 4 / length**4 * 2e11 * 0.1**2 / 12 / 8000
    want = np.sort(np.concatenate([first[:1], 2 * first[:1], first[1:], 2 * first[1:]]))
    np.testing.assert_allclose(
        found.values[6 : 6 + 4], want, rtol=1e-3
    )  # ε λmax/λ of so slender a beam
