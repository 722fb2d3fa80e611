"""Which candidates are looked at closely: what would be a series without end together is left
out.
"""

from __future__ import annotations

import localise_twin as twin
import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, spc
from scipy import sparse

from ringtrue.core.parameters import CardField, Parameter
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.derivatives import affine_terms, matrices_kept
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.parametric import KnownModes, ReducedModel, reduced_model
from ringtrue.updating.selection import screening
from ringtrue.updating.selection.candidates import (
    Candidate,
    CandidateSettings,
    parameters,
)
from ringtrue.updating.selection.generation import generate
from ringtrue.updating.selection.screening import (
    ScreenedDeck,
    close,
    screened,
    tractable,
)
from ringtrue.updating.selection.subset_search import SearchSettings


def laminate(across: float, **constants: float) -> Model:
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    return model(
        grid(x),
        cards(
            "MAT8",
            MID=[1],
            E1=1.4e11,
            E2=across,
            NU12=0.3,
            G12=5e9,
            RHO=1600.0,
            **constants,
        ),
        cards("CQUAD4", EID=[1], PID=1, G1=1, G2=2, G3=3, G4=4),
        cards(
            "PCOMP",
            PID=[1],
            MID=ragged([1, 1]),
            T=ragged([0.01, 0.02]),
            THETA=ragged([0.0, 0.0]),
        ),
        spc(np.array([1, 2]), "123456"),
        spc=1,
    )


def kept(m: Model, *, backwards: bool = False) -> list[str]:
    every = generate(m, CandidateSettings(("material",)))[:: -1 if backwards else 1]
    return [
        every[i].name.removeprefix("MAT8 1 ") for i in tractable(m, every, len(every))
    ]


def test_forms() -> None:
    """Shear in the plane is a power by itself, E1 and E2 are none; with NU12 near the root of E1/E2 the law has
    a pole.
    """
    m = laminate(1e10, G1Z=5e9, G2Z=5e9)
    e1, g12, nu = (
        Parameter(f, (CardField("MAT8", 1, f),)) for f in ("E1", "G12", "NU12")
    )
    assert matrices_kept(m, g12) == 0
    assert all(matrices_kept(m, p) for p in (e1, nu))
    assert matrices_kept(laminate(1.4e11), nu) is None
    both = matrices_kept(m, e1, nu)
    assert both
    assert [matrices_kept(m, e1, nu, most=n) for n in (both - 1, both)] == [None, both]


def test_constants_of_a_laminate() -> None:
    """All of them, in any order, though E2 of a weave comes close to the pole E1 / NU12² between
    its bounds.
    """
    every = ["E1", "E2", "G12", "RHO"]
    assert kept(laminate(1e10)) == kept(laminate(1.4e11)) == every
    assert kept(laminate(1.4e11), backwards=True) == every[::-1]


def test_no_more_constants_on_one_laminate_than_can_be_interpolated_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Counted together: all of them keep far fewer matrices than the product of what each keeps by
    itself.
    """
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    m = model(
        grid(x),
        cards(
            "MAT8",
            MID=[1, 2],
            E1=[1.4e11, 4e10],
            E2=[1e10, 9e9],
            NU12=0.3,
            G12=[5e9, 4e9],
            G1Z=5e9,
            RHO=1600.0,
        ),
        cards("CQUAD4", EID=[1], PID=1, G1=1, G2=2, G3=3, G4=4),
        cards(
            "PCOMP",
            PID=[1],
            MID=ragged([1, 2, 1]),
            T=ragged([0.01, 0.02, 0.01]),
            THETA=ragged([0.0, 45.0, 30.0]),
        ),
        spc(np.array([1, 2]), "123456"),
        spc=1,
    )
    every = generate(m, CandidateSettings(("material",)))
    assert len(tractable(m, every, len(every))) == len(every)
    assert affine_terms(m, parameters(every), assemble(m))
    with monkeypatch.context() as large:
        # in a large deck the product stands for what is not counted
        large.setattr(screening, "SIZES", screening.ScreeningSizes(elements=0))
        assert len(tractable(m, every, len(every))) < len(every)
    monkeypatch.setattr(screening, "SIZES", screening.ScreeningSizes(matrices=8))
    assert 2 < len(tractable(m, every, len(every))) < len(every)


def test_nearer_to_the_structure_more_of_what_is_wrong_is_seen() -> None:
    """Four regions of a frame are wrong, eight of 94 candidates looked at: one from the deck, more
    from nearer.
    """
    s, rng = twin.start(), np.random.default_rng(100)
    wrong = twin.truth(rng, 4)
    aim = twin.measured(wrong, rng, shape=0.02)
    model, system, found = (
        s.model,
        s.analysis.system,
        s.analysis.eigen(ModesRequest(twin.COUNT)),
    )
    observe = sparse.csr_array(s.observation.matrix @ system.transform)

    def look(some: tuple[Candidate, ...]) -> tuple[ReducedModel, ReducedModel]:
        affine = observed_system(model, system, parameters(some), s.observation)
        whole = reduced_model(
            affine, twin.COUNT, known=KnownModes(s.analysis.pencil, found)
        )
        return whole, whole

    def seen(some: tuple[Candidate, ...]) -> int:
        return sum(
            any(set(c.elements) == twin.region_elements(r) for c in some) for r in wrong
        )

    deck = ScreenedDeck(
        model, system, s.candidates, observe, found.values, found.vectors
    )
    left = deck.misfits((found.values, found.vectors), aim)
    first = tuple(s.candidates[i] for i in close(model, s.candidates, left, 8).tolist())
    kept = screened(deck, aim, look, 8, settings=SearchSettings(5))
    assert len(first) == len(kept) == 8
    assert seen(kept) > seen(first)
