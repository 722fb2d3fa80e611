"""All measures of two paired sets of modes in one value, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Float, FrozenArrays
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.correlation.channel_faults import Suspect, suspect_channels
from ringtrue.correlation.orthogonality import (
    OrthogonalityCheck,
    OrthogonalityTest,
    PairedSets,
    over_mass,
    over_serep_mass,
    verdict_json,
)
from ringtrue.correlation.paired_shapes import (
    Elimination,
    comac,
    ecomac,
    eliminate,
    mac_contribution,
    paired_shapes,
    turning,
)
from ringtrue.correlation.pairing import Pairing
from ringtrue.correlation.table import Significance, significance
from ringtrue.errors import InputError
from ringtrue.shapes import (
    above_rounding,
    auto_mac,
    close_groups,
    mcf,
    modal_scale_factor,
    mpc,
    mpd,
    principal_angles,
    worst_off_diagonal,
)


@dataclass(frozen=True, slots=True)
class CloseSubspace:
    """Close modes compared as spaces; positions count from 0.

    Attributes
    ----------
    a, b : tuple of int
    angles : tuple of float, rad
        Principal angles, ascending: 0 where one set can be turned into the other.
    """

    a: tuple[int, ...]
    b: tuple[int, ...]
    angles: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ChannelMeasures(FrozenArrays):
    """How far each channel agrees over all pairs.

    Attributes
    ----------
    comac, ecomac : (channel,) float64
    contribution : (channel,) float64
        Mean over the pairs of the share of each channel in the MAC.
    elimination : Elimination
    """

    comac: Float
    ecomac: Float
    contribution: Float
    elimination: Elimination


@dataclass(frozen=True, slots=True, eq=False)
class ShapeComplexity(FrozenArrays):
    """How far the shapes of a set are from real ones.

    Attributes
    ----------
    mpc, mcf : (m,) float64, 0..1
        Modal phase collinearity and complexity factor.
    mpd : (m,) float64, rad
        Mean phase deviation.
    """

    mpc: Float
    mpd: Float
    mcf: Float


@dataclass(frozen=True, slots=True, eq=False)
class CompleteCorrelation(FrozenArrays):
    """What can be said of two paired sets of modes in addition to deviation and MAC.

    Attributes
    ----------
    channels : tuple of str
    auto_mac : (2,) float64
        Largest off-diagonal auto-MAC of A and of B: near 1, the channels cannot distinguish shapes.
    by_channel : ChannelMeasures
    scale : (k,) float64 or complex128
        Modal scale factor of each pair: on B, to come closest to A.
    complexity : ShapeComplexity
        Of the modes of A.
    checks : tuple of OrthogonalityCheck
        Self- and cross-orthogonality over the mass that was given, and over that of a SEREP model.
    subspaces : tuple of CloseSubspace
        Groups of close modes.
    suspects : tuple of Suspect
    significance : Significance
        Of the deviations.
    notes : tuple of str
        What could not be done, and why.
    """

    channels: tuple[str, ...]
    auto_mac: Float
    by_channel: ChannelMeasures
    scale: Any_
    complexity: ShapeComplexity
    checks: tuple[OrthogonalityCheck, ...]
    subspaces: tuple[CloseSubspace, ...]
    suspects: tuple[Suspect, ...]
    significance: Significance
    notes: tuple[str, ...]

    def judges(self, check: OrthogonalityCheck) -> bool:
        """Whether a check has a verdict: one that fails has none over a mass that an ordinary test
        would fail, too.
        """
        fit = all(
            c.verdict.passed
            for c in self.checks
            if c.kind == "model" and c.mass == check.mass
        )
        return fit or check.kind == "model" or check.verdict.passed

    @property
    def cross(self) -> OrthogonalityCheck | None:
        """The first cross-orthogonality that has a verdict, or the first."""
        every = [c for c in self.checks if c.kind == "cross"]
        return next((c for c in every if self.judges(c)), every[0] if every else None)


def complete(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    *,
    orthogonality: OrthogonalityTest = OrthogonalityTest(),  # noqa: B008  frozen
    std: tuple[Float | float, Float | float] = (float("nan"), float("nan")),
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> CompleteCorrelation:
    """All measures that the data allow.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired; test and model, or any two.
    pairing : Pairing
    orthogonality : OrthogonalityTest
    std : ((ma,) float64 or float, (mb,) float64 or float), Hz
        Standard deviations of the frequencies of A and B; NaN where unknown.
    settings : PairingSettings
        Those of the pairing: `close` and `largest_group` make the groups.
    """
    b = b.rows(a.channels)
    notes: list[str] = []
    of_pairs = [
        np.broadcast_to(np.asarray(s, float), (len(m),))[i]
        for s, m, i in zip(std, (a, b), (pairing.a, pairing.b), strict=True)
    ]
    if not np.isfinite(of_pairs).any():
        notes.append(
            "deviations not judged: no standard deviation of a frequency is known"
        )
    suspects: tuple[Suspect, ...] = ()
    if len(pairing) >= 3:
        suspects = suspect_channels(a, b, pairing, settings=settings)
    else:
        notes.append(
            f"channels not judged: {len(pairing)} pairs, at least 3 are needed"
        )
    checks: tuple[OrthogonalityCheck, ...] = ()
    if len(pairing):
        pairs = PairedSets(a, b, pairing.a, pairing.b, turning(a, b, pairing, settings))
        gate = orthogonality.gate
        if orthogonality.mass is not None:
            name, lift = orthogonality.name, orthogonality.lift
            checks = over_mass(pairs, orthogonality.mass, gate, name=name, lift=lift)
        if b.norm is Norm.MASS:
            try:
                checks += over_serep_mass(pairs, gate)
            except InputError as e:
                notes.append(f"orthogonality over the SEREP mass not checked: {e}")
        elif not checks:
            notes.append(
                "orthogonality not checked: no mass given, and the shapes of the second set are "
                "not mass-normalised"
            )
    else:
        notes.append("orthogonality not checked: no mode has a partner")
    left, right = paired_shapes(a, b, pairing, settings)
    return CompleteCorrelation(
        channels=a.channels,
        auto_mac=np.array(
            [worst_off_diagonal(auto_mac(above_rounding(m.shapes))) for m in (a, b)]
        ),
        by_channel=_by_channel(left, right),
        scale=modal_scale_factor(left, right),
        complexity=ShapeComplexity(
            mpc=mpc(a.shapes),
            mpd=mpd(a.shapes),
            mcf=mcf(a.shapes),
        ),
        checks=checks,
        subspaces=subspaces(a, b, pairing, settings),
        suspects=suspects,
        significance=significance(
            a.frequencies[pairing.a], b.frequencies[pairing.b], *of_pairs
        ),
        notes=tuple(notes),
    )


def _by_channel(left: Any_, right: Any_) -> ChannelMeasures:
    """Of paired shapes (n, k)."""
    n, pairs = left.shape
    contribution = np.zeros(n)
    elimination = Elimination(np.zeros(0, dtype=np.int64), np.zeros((1, 0)))
    if pairs:
        contribution = mac_contribution(left, right).mean(axis=1)
        elimination = eliminate(left, right)
    return ChannelMeasures(
        comac=comac(left, right),
        ecomac=ecomac(left, right),
        contribution=contribution,
        elimination=elimination,
    )


def subspaces(
    a: ModeSet, b: ModeSet, pairing: Pairing, settings: PairingSettings
) -> tuple[CloseSubspace, ...]:
    """Principal angles between each close group of A (B) and its partners."""
    partner = dict(zip(pairing.a.tolist(), pairing.b.tolist(), strict=True))
    groups = [
        tuple(i for i in group if i in partner)
        for group in close_groups(a.frequencies, settings.close, settings.largest_group)
    ]
    back = {j: i for i, j in partner.items()}
    for group in close_groups(b.frequencies, settings.close, settings.largest_group):
        mine = tuple(sorted(back[j] for j in group if j in back))
        if not any(set(mine) & set(g) for g in groups if len(g) > 1):
            groups.append(mine)
    out = []
    for g in (g for g in groups if len(g) > 1):
        theirs = tuple(partner[i] for i in g)
        angles = principal_angles(a.shapes[:, list(g)], b.shapes[:, list(theirs)])
        out.append(CloseSubspace(g, theirs, tuple(angles.tolist())))
    return tuple(out)


def complete_json(c: CompleteCorrelation, pairing: Pairing) -> dict[str, Any]:
    """Plain values; modes count from 1. Matrices over more than 30 modes are left out."""
    channels = c.by_channel
    worst = np.argsort(channels.comac, kind="stable")[:5]
    removed = channels.elimination.order.tolist()
    after = channels.elimination.mean_mac.tolist()[1:] if removed else []
    # 30: modes up to which whole matrices are written to JSON
    return {
        "auto_mac_worst": c.auto_mac.tolist(),
        "channels": _rows(
            channel=c.channels,
            comac=channels.comac,
            ecomac=channels.ecomac,
            contribution=channels.contribution,
        ),
        "worst_comac": [c.channels[i] for i in worst],
        "elimination": _rows(
            channel=[c.channels[i] for i in removed], mean_mac_after=after
        ),
        "complexity": _rows(
            mode=np.arange(1, c.complexity.mpc.size + 1),
            mpc=c.complexity.mpc,
            mpd_deg=np.rad2deg(c.complexity.mpd),
            mcf=c.complexity.mcf,
        ),
        "scale": _rows(
            a=pairing.a + 1,
            b=pairing.b + 1,
            factor=np.abs(c.scale),
            phase_deg=np.rad2deg(np.angle(c.scale)),
        ),
        "orthogonality": [
            {"name": k.name, "verdict": verdict_json(k.verdict), "judged": c.judges(k)}
            | ({"matrix": k.matrix.tolist()} if max(k.matrix.shape) <= 30 else {})
            for k in c.checks
        ],
        "subspaces": [
            {
                "a": [i + 1 for i in x.a],
                "b": [i + 1 for i in x.b],
                "angles_deg": np.rad2deg(x.angles).tolist(),
            }
            for x in c.subspaces
        ],
        "suspects": [asdict(x) | {"partner": x.partner or None} for x in c.suspects],
        "significance": _significance_json(c.significance, pairing),
        "notes": list(c.notes),
    }


def _significance_json(s: Significance, pairing: Pairing) -> dict[str, Any]:
    total, count, chance = s.chi_square
    pairs = _rows(
        a=pairing.a + 1,
        b=pairing.b + 1,
        std_hz=s.std,
        z=s.z,
        p=s.p,
        significant=s.significant,
    )
    return {
        "false_discovery_rate": s.rate,
        "chi_square": total,
        "count": count,
        "p": _number(chance),
        "pairs": [
            {name: _number(value) for name, value in pair.items()} for pair in pairs
        ],
    }


def _rows(**columns: Sequence[Any] | Any_) -> list[dict[str, Any]]:
    """Columns of one length as one dict a row, with plain values."""
    plain = [
        c.tolist() if isinstance(c, np.ndarray) else list(c) for c in columns.values()
    ]
    return [dict(zip(columns, row, strict=True)) for row in zip(*plain, strict=True)]


def _number(x: Any) -> Any:
    """None for what is not finite."""
    return x if np.isfinite(x) else None
