"""All measures of two paired sets of modes in one value, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int, freeze_fields
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.correlation.channel_faults import Suspect, suspect_channels
from ringtrue.correlation.orthogonality import (
    TRADE,
    Check,
    Gate,
    Lift,
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
from ringtrue.shapes.complexity import mcf, modal_scale_factor, mpc, mpd
from ringtrue.shapes.mac import (
    above_rounding,
    auto_mac,
    close_groups,
    principal_angles,
    worst_off_diagonal,
)

WHOLE = 30  # modes up to which whole matrices are written to JSON


@dataclass(frozen=True, slots=True)
class Subspace:
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
class CompleteCorrelation:
    """What can be said of two paired sets of modes in addition to deviation and MAC.

    Attributes
    ----------
    channels : tuple of str
    auto_mac : (2,) float64
        Largest off-diagonal auto-MAC of A and of B: near 1, the channels cannot distinguish shapes.
    comac, ecomac : (channel,) float64
    contribution : (channel,) float64
        Mean over the pairs of the share of each channel in the MAC.
    elimination : Elimination
    scale : (k,) float64 or complex128
        Modal scale factor of each pair: on B, to come closest to A.
    mpc, mpd, mcf : (m,) float64
        Of the modes of A; `mpd` in rad.
    checks : tuple of Check
        Self- and cross-orthogonality over the mass that was given, and over that of a SEREP model.
    subspaces : tuple of Subspace
        Groups of close modes.
    suspects : tuple of Suspect
    significance : Significance
        Of the deviations.
    notes : tuple of str
        What could not be done, and why.
    """

    channels: tuple[str, ...]
    auto_mac: Float
    comac: Float
    ecomac: Float
    contribution: Float
    elimination: Elimination
    scale: Any_
    mpc: Float
    mpd: Float
    mcf: Float
    checks: tuple[Check, ...]
    subspaces: tuple[Subspace, ...]
    suspects: tuple[Suspect, ...]
    significance: Significance
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(
            self, auto_mac=f, comac=f, ecomac=f, contribution=f, scale=None, mpc=f, mpd=f, mcf=f
        )

    def judges(self, check: Check) -> bool:
        """Whether a check has a verdict: one that fails has none over a mass that an ordinary test
        would fail, too.
        """
        fit = all(
            c.verdict.passed for c in self.checks if c.kind == "model" and c.mass == check.mass
        )
        return fit or check.kind == "model" or check.verdict.passed

    @property
    def cross(self) -> Check | None:
        """The first cross-orthogonality that has a verdict, or the first."""
        every = [c for c in self.checks if c.kind == "cross"]
        return next((c for c in every if self.judges(c)), every[0] if every else None)


def complete(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    *,
    mass: Any_ | sparse.csr_array | None = None,
    mass_name: str = "given",
    lift: Lift | None = None,
    gate: Gate = TRADE,
    std_a: Float | float = float("nan"),
    std_b: Float | float = float("nan"),
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> CompleteCorrelation:
    """All measures that the data allow.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired; test and model, or any two.
    pairing : Pairing
    mass : (channel, channel) float64, optional
        Of the structure at the channels of A (`reduction.static`).
    mass_name : str
        What it is called in the checks.
    lift : callable, ModeSet -> (n, m), optional
        Coordinates of shapes that the mass is over, where these are not channels (Craig-Bampton).
    gate : Gate
    std_a, std_b : (ma,), (mb,) float64 or float, Hz
        Standard deviations of the frequencies; NaN where unknown.
    settings : PairingSettings
        Those of the pairing: `close` and `largest_group` make the groups.
    """
    b = b.rows(a.channels)
    left, right = paired_shapes(a, b, pairing, settings)
    notes: list[str] = []
    checks: tuple[Check, ...] = ()
    if len(pairing):
        pairs = PairedSets(a, b, pairing.a, pairing.b, turning(a, b, pairing, settings))
        if mass is not None:
            checks = over_mass(pairs, mass, gate, name=mass_name, lift=lift)
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
    suspects: tuple[Suspect, ...] = ()
    if len(pairing) < 3:
        notes.append(f"channels not judged: {len(pairing)} pairs, at least 3 are needed")
    else:
        suspects = suspect_channels(a, b, pairing, settings=settings)
    share = mac_contribution(left, right)
    std = [
        np.broadcast_to(np.asarray(s, float), (len(m),))[i]
        for s, m, i in ((std_a, a, pairing.a), (std_b, b, pairing.b))
    ]
    if not np.isfinite(std).any():
        notes.append("deviations not judged: no standard deviation of a frequency is known")
    return CompleteCorrelation(
        channels=a.channels,
        auto_mac=np.array([worst_off_diagonal(auto_mac(above_rounding(m.shapes))) for m in (a, b)]),
        comac=comac(left, right),
        ecomac=ecomac(left, right),
        contribution=share.mean(axis=1) if len(pairing) else np.zeros(len(a.channels)),
        elimination=eliminate(left, right)
        if len(pairing)
        else Elimination(np.zeros(0, dtype=np.int64), np.zeros((1, 0))),
        scale=modal_scale_factor(left, right),
        mpc=mpc(a.shapes),
        mpd=mpd(a.shapes),
        mcf=mcf(a.shapes),
        checks=checks,
        subspaces=subspaces(a, b, pairing, settings),
        suspects=suspects,
        significance=significance(a.frequencies[pairing.a], b.frequencies[pairing.b], *std),
        notes=tuple(notes),
    )


def subspaces(
    a: ModeSet, b: ModeSet, pairing: Pairing, settings: PairingSettings
) -> tuple[Subspace, ...]:
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
        out.append(Subspace(g, theirs, tuple(angles.tolist())))
    return tuple(out)


def complete_json(c: CompleteCorrelation, pairing: Pairing) -> dict[str, Any]:
    """Plain values; modes count from 1. Matrices over more than 30 modes are left out."""
    s = c.significance
    worst = _worst(c.comac)
    total, count, chance = s.chi_square
    return {
        "auto_mac_worst": c.auto_mac.tolist(),
        "channels": [
            {"channel": name, "comac": x, "ecomac": y, "contribution": z}
            for name, x, y, z in zip(
                c.channels,
                c.comac.tolist(),
                c.ecomac.tolist(),
                c.contribution.tolist(),
                strict=True,
            )
        ],
        "worst_comac": [c.channels[i] for i in worst.tolist()],
        "elimination": [
            {"channel": c.channels[i], "mean_mac_after": x}
            for i, x in zip(c.elimination.order.tolist(), _mean(c.elimination)[1:], strict=True)
        ],
        "complexity": [
            {"mode": i + 1, "mpc": x, "mpd_deg": float(np.rad2deg(y)), "mcf": z}
            for i, (x, y, z) in enumerate(
                zip(c.mpc.tolist(), c.mpd.tolist(), c.mcf.tolist(), strict=True)
            )
        ],
        "scale": [
            {"a": i + 1, "b": j + 1, "factor": abs(x), "phase_deg": float(np.rad2deg(np.angle(x)))}
            for i, j, x in zip(
                pairing.a.tolist(), pairing.b.tolist(), c.scale.tolist(), strict=True
            )
        ],
        "orthogonality": [
            {"name": k.name, "verdict": verdict_json(k.verdict), "judged": c.judges(k)}
            | ({"matrix": k.matrix.tolist()} if max(k.matrix.shape) <= WHOLE else {})
            for k in c.checks
        ],
        "subspaces": [
            {"a": _from_one(x.a), "b": _from_one(x.b), "angles_deg": np.rad2deg(x.angles).tolist()}
            for x in c.subspaces
        ],
        "suspects": [
            {
                "channel": x.channel,
                "fault": x.fault,
                "partner": x.partner or None,
                "factor": x.factor,
                "mac_now": x.mac_now,
                "mac_mended": x.mac_mended,
                "message": x.message,
            }
            for x in c.suspects
        ],
        "significance": {
            "false_discovery_rate": s.rate,
            "chi_square": total,
            "count": count,
            "p": _number(chance),
            "pairs": [
                {
                    "a": i + 1,
                    "b": j + 1,
                    "std_hz": _number(d),
                    "z": _number(z),
                    "p": _number(p),
                    "significant": h,
                }
                for i, j, d, z, p, h in zip(
                    pairing.a.tolist(),
                    pairing.b.tolist(),
                    s.std.tolist(),
                    s.z.tolist(),
                    s.p.tolist(),
                    s.significant.tolist(),
                    strict=True,
                )
            ],
        },
        "notes": list(c.notes),
    }


def _mean(e: Elimination) -> list[float]:
    return e.mean_mac.tolist() if e.mac.shape[1] else [0.0]


def _worst(values: Float, most: int = 5) -> Int:
    return np.argsort(values, kind="stable")[:most]


def _from_one(modes: Sequence[int]) -> list[int]:
    return [i + 1 for i in modes]


def _number(x: float) -> float | None:
    return x if np.isfinite(x) else None
