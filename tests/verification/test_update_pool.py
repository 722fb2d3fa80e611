"""Which candidates are looked at closely: what would be a series without end together is left out."""

from __future__ import annotations

import numpy as np
from fem_cases import cards, grid, model, ragged, spc

from ringtrue.core.parameters import Parameter, Target
from ringtrue.fem.assembly import assemble
from ringtrue.fem.dependence import form, meet
from ringtrue.update.candidates import Candidate, CandidateSettings
from ringtrue.update.generate import generate
from ringtrue.update.pool import tractable


def test_constants_of_a_laminate() -> None:
    """E1 and E2 meet in Poisson's effect, and are series; shear and density are powers, and stay."""
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    m = model(
        grid(x),
        cards("MAT8", MID=[1], E1=1.4e11, E2=1e10, NU12=0.3, G12=5e9, RHO=1600.0),
        cards("CQUAD4", EID=[1], PID=1, G1=1, G2=2, G3=3, G4=4),
        cards("PCOMP", PID=[1], MID=ragged([1, 1]), T=ragged([0.01, 0.02]), THETA=ragged([0.0, 0.0])),
        spc([1, 2], "123456"),
        spc=1,
    )
    s = assemble(m)
    e1, e2, g12 = (Parameter(f, (Target("MAT8", 1, f),)) for f in ("E1", "E2", "G12"))
    assert [form(m, p, s) for p in (e1, e2, g12)] == ["series", "series", "powers"]
    assert meet(m, e1, e2)
    assert not meet(m, e1, g12)

    def kept(some: tuple[Candidate, ...]) -> list[str]:
        return [some[i].name.removeprefix("MAT8 1 ") for i in tractable(m, s, some)]

    every = generate(m, CandidateSettings(("material",)))
    assert kept(every) == ["E1", "G12", "RHO"]
    assert kept(every[::-1]) == ["RHO", "G12", "E2"]  # the first of those that meet counts
