"""Negative stiffness: refused with card and field, or taken as it is where the deck asks for it.

A point mass m on two springs k and -c, c < k: f = sqrt((k - c) / m) / 2 pi; c > k is unstable and
refused. A cantilever of E < 0 has the eigenvalues of the one of |E| with the sign turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_cases import (
    cards,
    frequencies,
    grid,
    model,
    pshell,
    ragged,
    shells,
    spc,
    square,
    steel,
)

from ringtrue.errors import DeckError, SingularModel
from ringtrue.fem.assembly import assemble
from ringtrue.model.model import Model, Table
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

MASS = cards("CONM2", EID=[50], G=1, M=4.0)


def cantilever(E: float, **section: float) -> Model:
    x = np.zeros((4, 3))
    x[:, 0] = np.linspace(0, 1, 4)
    i = np.arange(1, 4)
    size = {"A": 1e-2, "I1": 8e-6, "I2": 5e-6, "J": 1e-5} | section
    bars = (
        cards("CBAR", EID=i, PID=1, GA=i, GB=i + 1, X2=1.0),
        cards("PBAR", PID=[1], MID=1, **size),
    )
    return model(grid(x), *bars, steel(E), spc([1], "123456"), spc=1)


@pytest.mark.parametrize("c", [30.0, 100.0, 130.0])
@pytest.mark.parametrize("kind", ["CELAS2", "PELAS", "PBUSH"])
def test_springs_below_zero_are_taken(kind: str, c: float) -> None:
    k = 100.0
    firm = cards("CELAS2", EID=[1], K=[k], G1=[1], C1=[1])
    ways = {
        "CELAS2": (cards("CELAS2", EID=[1, 2], K=[k, -c], G1=[1, 1], C1=[1, 1]),),
        "PELAS": (
            firm,
            cards("CELAS1", EID=[2], PID=9, G1=1, C1=1),
            cards("PELAS", PID=[9], K=-c),
        ),
        "PBUSH": (
            firm,
            cards("CBUSH", EID=[2], PID=9, GA=1, CID=0),
            cards("PBUSH", PID=[9], K1=-c),
        ),
    }
    m = model(grid(np.zeros((1, 3)), PS="23456"), *ways[kind], MASS)
    if c == k:  # the springs cancel: nothing stiffens the mass
        assert assemble(m).autospc.labels() == ("1+X",)
        return
    if c > k:
        with (
            EmbeddedSolver().open(m) as analysis,
            pytest.raises(
                SingularModel, match="not positive definite: a stiffness below 0"
            ),
        ):
            analysis.modes(ModesRequest(1))
        return
    with EmbeddedSolver().open(m) as analysis:
        f = analysis.modes(ModesRequest(1)).modes.frequencies
    assert f == pytest.approx([np.sqrt((k - c) / 4.0) / 2 / np.pi])


def test_a_negative_spring_alone_is_stiffness() -> None:
    """AUTOSPC does not take it for none."""
    m = model(
        grid(np.zeros((1, 3)), PS="3456"),
        cards("CELAS2", EID=[1, 2], K=[5.0, -1e-12], G1=1, C1=[1, 2]),
        MASS,
    )
    assert not len(assemble(m).autospc)


@pytest.mark.parametrize(
    "section", [{"I1": -8e-6}, {"J": -1e-5}, {"A": -1e-2}, {"I12": 7e-6}]
)
def test_sections_below_zero_are_refused(section: dict[str, float]) -> None:
    field = next(iter(section))
    with pytest.raises(
        DeckError,
        match=f"PBAR 1 field {field}: .*negative stiffness.*PARAM,NEGSTIFF,YES",
    ) as e:
        assemble(cantilever(2e11, **section))
    assert e.value.field == field


def test_a_modulus_below_zero_is_refused_or_asked_for() -> None:
    with pytest.raises(DeckError, match="MAT1 1 field E: E is -2e\\+11, below 0"):
        assemble(cantilever(-2e11))
    asked = replace(cantilever(-2e11), params={"NEGSTIFF": "YES"})
    s = assemble(asked)
    assert not len(s.autospc)
    of_plus = frequencies(assemble(cantilever(2e11)), 20)
    np.testing.assert_allclose(np.sort(-frequencies(s, 20)), of_plus, rtol=1e-9)


XYZ, QUADS = square(1, 1.0, 1.0)
MATERIALS = {
    "E1": cards("MAT8", MID=[1], E1=-1e10, E2=1e10, NU12=0.3, G12=4e9),
    "G12": cards("MAT8", MID=[1], E1=1e10, E2=1e10, NU12=0.3, G12=-4e9),
    "G11": cards(
        "MAT2", MID=[1], G11=1e10, G12=2e10, G13=0.0, G22=1e10, G23=0.0, G33=4e9
    ),
}


@pytest.mark.parametrize("field", MATERIALS)
def test_plies_that_take_energy_out_are_refused(field: str) -> None:
    laminate = cards(
        "PCOMP",
        PID=[1],
        MID=ragged([1, 1]),
        T=ragged([0.01, 0.01]),
        THETA=ragged([0.0, 90.0]),
    )
    laminate = (
        laminate.with_column("SOUT", ragged(["NO", "NO"]))
        if "SOUT" in laminate.columns
        else laminate
    )
    plate: tuple[Table, ...] = (grid(XYZ), shells(QUADS), laminate)
    with pytest.raises(DeckError, match=f"field {field}"):
        assemble(model(*plate, MATERIALS[field]))


def test_thickness_below_zero_is_refused() -> None:
    with pytest.raises(DeckError, match="PSHELL 1 field T"):
        assemble(model(grid(XYZ), shells(QUADS), pshell(-0.01), steel()))
    with pytest.raises(DeckError, match="CQUAD4 1 field T2"):
        assemble(model(grid(XYZ), shells(QUADS, T2=-0.01), pshell(0.01), steel()))
