"""Made-up localisation and uncertainty, for the tests of the report only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.study import results as r
from ringtrue.updating.identifiability import Flag
from ringtrue.updating.selection.missing_members import MissingMember
from ringtrue.updating.selection.proposal import Proposal, Proposed
from ringtrue.updating.validation import Held

RNG = np.random.default_rng(11)


def parameters(names: Sequence[str]) -> ParameterSet:
    return ParameterSet(
        tuple(
            Parameter(n, (CardField("MAT1", i + 1, "E"),), 0.2, 5.0)
            for i, n in enumerate(names)
        )
    )


def _proposal(names: Sequence[str]) -> Proposal:
    because = (
        "MAT1 1 E of 24 CHEXA; without it AICc rises by 21.0 and mean |Δf| is 2.10 instead "
        "of 0.92 %"
    )
    members = tuple(
        Proposed(
            names[i],
            i,
            5.0 if i == 2 else 1.3 + i,
            0.05,
            40.0 - 9 * i,
            (names[8],) * (i == 0),
            (),
            because,
        )
        for i in range(4)
    )
    rules = ("orthogonal sensitivities", "largest sensitivities", "single gain")
    return Proposal(
        members,
        np.arange(7),
        np.array([72.0, 60.0, 51.0, 44.0, 41.0, 43.0, 47.0]),
        (names[-1],),
        np.arange(len(names)),
        np.zeros(len(names)),
        0.18,
        0.009,
        np.array([0.84, 0.96]),
        np.array([18, 20]),
        np.array([0.012, 0.04]),
        {rule: tuple(RNG.permutation(list(names))[:8].tolist()) for rule in rules},
    )


def localise(regions: Sequence[str], names: Sequence[str]) -> r.LocaliseStage:
    """Candidates made from the deck, one region without strain energy."""
    g, p = len(regions), len(names)
    strain = RNG.dirichlet(np.ones(g))
    strain[-1] = 0.0
    return r.LocaliseStage(
        r.ErrorIndicators(
            regions=tuple(regions),
            strain=strain / strain.sum(),
            force=RNG.dirichlet(np.ones(g)),
            constitutive=RNG.dirichlet(np.ones(g)),
            energy=RNG.dirichlet(np.ones(g)),
            modes=np.arange(12),
            relative=RNG.uniform(0.1, 0.9, 12),
            expansion="hybrid",
            misfit=np.zeros(0),
        ),
        r.CandidateEffects(
            parameters=parameters(names),
            what=tuple(
                f"Young's modulus 2.1e+11 Pa of {7 * i + 4} CHEXA" for i in range(p)
            ),
            elements=tuple(regions[i % g] for i in range(p)),
            effect=RNG.uniform(0.1, 30, p),
            others_known=RNG.uniform(0.02, 0.9, p),
            all_free=RNG.uniform(0.1, 1.0, p),
            explains=RNG.uniform(-0.5, 0.9, p),
        ),
        r.CandidatePool(124, ("MAT1 99 E",), tuple(f"PBAR {i} A" for i in range(40))),
        _proposal(names),
        members=(
            MissingMember(
                "brace",
                "axial",
                ((39, 78), (48, 87)),
                2.1e9,
                4e8,
                0.6,
                0.31,
                0.31,
                12.4,
                (2, 5),
            ),
            MissingMember(
                "support", "3", ((7, 0),), 4e7, 2e7, 1.0, 0.12, 0.02, -4.0, (0,)
            ),
        ),
    )


def uncertainty(
    test: np.ndarray, names: Sequence[str], left_out: Sequence[int]
) -> r.UncertaintyStage:
    """One mode without a partner, one outside of its band, one parameter that the test has not
    told.
    """
    m, p = test.size, len(names)
    used = ~np.isin(np.arange(m), list(left_out))
    found = test * (1 + 0.01 * RNG.standard_normal(m))
    found[3] = np.nan
    parts = np.tile([0.004, 3e-5, 0.012], (m, 1))
    reach = 2.1 * 0.0126 * found
    fold = np.where(used, np.cumsum(used) % 5, -1)
    held = np.where(used, found * 1.002, np.nan)
    known = Held(
        test,
        held,
        np.where(used, 0.96, np.nan),
        parts[:, 0],
        parts[:, 1],
        parts[:, 2],
        fold,
        True,
    )
    factor = RNG.uniform(0.6, 2.4, p)
    std = np.full(p, 0.06)
    interval = factor[:, None] * np.exp(np.outer(std, [-1.64, 1.64]))
    ratio = np.full(p, 0.09)
    ratio[-1] = 0.97
    close = np.eye(p) + 0.3 * (1 - np.eye(p))
    return r.UncertaintyStage(
        r.ParameterPosterior(
            parameters=parameters(names),
            factor=factor,
            std=std,
            interval=interval,
            prior=np.tile([0.32, 3.2], (p, 1)),
            ratio=ratio,
            moved=ratio < 0.7,
            correlation=close,
        ),
        r.FrequencyBands(
            test=test,
            predicted=found,
            band=np.stack([found - reach, found + reach], axis=1),
            parts=parts,
            used=used,
            inside=np.abs(found / test - 1) < 0.0126,
        ),
        0.9,
        np.array([0.012, 0.033]),
        np.array([0.01, 0.05]),
        known,
        (
            Flag(
                names[0],
                "prior",
                2.4,
                f"{names[0]}: factor 2.4 is 2.1 prior standard deviations",
            ),
        ),
        r.PosteriorChains(
            draws=factor * np.exp(0.06 * RNG.standard_normal((80, p))),
            sampled=interval * 1.01,
            acceptance=0.51,
            independent=22.0,
            converged=False,
        ),
    )
