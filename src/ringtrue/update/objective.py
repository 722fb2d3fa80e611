"""The objective J(p) = Δzᵀ W Δz + pᵀ W_p p: residuals of eigenvalues and mode shapes with their sensitivities.

Friswell and Mottershead (1995), Finite Element Model Updating in Structural Dynamics, ch. 8 and 9.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.correlate.assign import PairingSettings, assign, scores
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import unit
from ringtrue.shapes.subspace import close_groups

LOST = 100.0  # a used mode without a partner counts like a frequency deviation of ten standard deviations
HOLD = 0.5  # of the MAC gate, and of 1/frequency gate, for modes that are paired already


@dataclass(frozen=True, slots=True)
class Weights:
    """What a deviation costs: W⁻¹ = Σ_test + Σ_model, diagonal.

    Attributes
    ----------
    frequency : float
        Standard deviation of a relative frequency deviation that the best model of this form is expected to keep
        (model discrepancy); the test's own is added.
    mac : float
        The same for 1 − MAC.
    shape : float
        Factor on the whole shape part; 0 leaves the shapes out.
    """

    frequency: float = 0.01
    mac: float = 0.1
    shape: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """What the model is updated to.

    Attributes
    ----------
    frequencies : (m,) float64, Hz
    shapes : (channel, m) float64
        Real; any scale.
    std : (m,) float64
        Relative standard deviation of the frequencies.
    used : (m,) bool
        False: left out of the updating, to judge it by.
    weights : Weights
    pairing : PairingSettings
    """

    frequencies: Float
    shapes: Float
    std: Float
    used: Bool
    weights: Weights = field(default_factory=Weights)
    pairing: PairingSettings = field(default_factory=PairingSettings)

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, frequencies=f, shapes=f, std=f, used=np.bool_)
        m = self.frequencies.size
        if self.shapes.ndim != 2 or self.shapes.shape[1] != m or self.std.shape != (m,) or self.used.shape != (m,):
            raise InputError(
                f"{m} frequencies, shapes {self.shapes.shape}, std {self.std.shape}, used {self.used.shape}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Weighted residuals and their sensitivities at one point, pairs fixed.

    Attributes
    ----------
    value : (r,) float64
        √W Δz with Δz = z_test − z_model.
    slope : (r, p) float64
        √W ∂z_model/∂x.
    pairs : (k, 2) int64
        Test mode and FE mode.
    mac : (k,) float64
        Of the pair, or of its subspace.
    frequency_error : (k,) float64
        (f_FE − f_test)/f_test, of all pairs.
    used : (k,) bool
        Pairs that the residual holds.
    """

    value: Float
    slope: Float
    pairs: Int
    mac: Float
    frequency_error: Float
    used: Bool


def match(
    target: Target, now: Linearisation, held: Bool | None = None
) -> tuple[Int, Float, tuple[tuple[int, ...], ...]]:
    """Pairs (k, 2), their MAC (k,) and the close groups of the model, by one assignment over MAC and frequency.

    Test modes in `held` (m,) keep a partner down to half the MAC gate: one that stands at the gate must not come and
    go from step to step.
    """
    s = scores(target.frequencies, target.shapes, now.frequencies, now.shapes, target.pairing)
    every = np.ones(target.frequencies.size, dtype=np.bool_)
    elastic = now.frequencies > 0
    gates = target.pairing
    if held is not None and held.any():
        inside = (s.merged >= gates.mac_gate) & (np.abs(s.error) <= gates.frequency_gate)
        s = replace(s, merged=np.where(inside | held[:, None], s.merged, -1.0))
        gates = replace(gates, mac_gate=HOLD * gates.mac_gate, frequency_gate=gates.frequency_gate / HOLD)
    rows, cols = assign(s, gates, every, elastic)
    return np.stack([rows, cols], axis=1), s.merged[rows, cols], s.groups_b


def residual(target: Target, now: Linearisation, held: Bool | None = None) -> Residual:
    """Residuals of the used pairs at a point, modes paired anew; `held` (m,) as in `match`."""
    pairs, mac, groups = match(target, now, held)
    test, fe = pairs[:, 0], pairs[:, 1]
    used = target.used[test]
    error = now.frequencies[fe] / target.frequencies[test] - 1
    w = target.weights
    lam_test = (2 * np.pi * target.frequencies[test[used]]) ** 2
    lam = (2 * np.pi * now.frequencies[fe[used]]) ** 2
    # a relative deviation of λ is twice that of f
    root = 0.5 / np.sqrt(w.frequency**2 + target.std[test[used]] ** 2)
    value = [root * (1 - lam / lam_test)]
    slope = [root[:, None] * now.d_lambda[fe[used]] / lam_test[:, None]]
    if w.shape > 0:
        group_of = {j: g for g in groups for j in g}
        for t, f in pairs[used].tolist():  # over pairs: each has its own subspace
            r, g = _shape(target, now, t, np.array(_group(target, now, t, f, group_of)))
            value.append(np.sqrt(w.shape / w.mac) * r)
            slope.append(np.sqrt(w.shape / w.mac) * g)
    return Residual(np.concatenate(value), np.concatenate(slope), pairs, mac, error, used)


def _group(target: Target, now: Linearisation, t: int, f: int, group_of: dict[int, tuple[int, ...]]) -> tuple[int, ...]:
    """The FE modes that stand for test mode t: the pair's own, or its close group where the test is close, too."""
    near = close_groups(target.frequencies, target.pairing.close, target.pairing.largest_group)
    alone = next(len(g) for g in near if t in g) == 1
    return (f,) if alone else group_of.get(f, (f,))


def _shape(target: Target, now: Linearisation, t: int, group: Int) -> tuple[Float, Float]:
    """(I − P) ψ and ∂(Pψ)/∂x with P the projector on the model's shapes; ‖(I − P) ψ‖² = 1 − MAC.

    The scale (modal scale factor) and a rotation inside the group are projected out at every point.
    """
    psi = unit(target.shapes[:, [t]])[:, 0]
    phi = now.shapes[:, group]
    plus = np.linalg.pinv(phi)
    inside = phi @ (plus @ psi)
    rest = psi - inside
    d_phi = now.d_shapes[:, group, :]
    first = np.einsum("cgp,g->cp", d_phi, plus @ psi)
    first -= phi @ (plus @ first)
    second = plus.T @ np.einsum("cgp,c->gp", d_phi, rest)
    return rest, first + second


def objective(target: Target, r: Residual, x: Float, prior_std: Float) -> float:
    """J = Δzᵀ W Δz + pᵀ W_p p, and `LOST` for each used mode that has no partner."""
    lost = int(target.used.sum()) - int(r.used.sum())
    return float(r.value @ r.value + (x / prior_std) @ (x / prior_std) + LOST * lost)


def shared_cost(r: Residual, others: Residual) -> float | None:
    """Δzᵀ W Δz over the test modes that `others` uses; None if one of them has no partner in `r`.

    Points with different pairs are compared by this: a mode that has just found a partner must not count against a
    point, and losing one must not pay.
    """
    mine, theirs = r.pairs[r.used, 0], others.pairs[others.used, 0]
    if not np.isin(theirs, mine).all():
        return None
    square = r.value**2
    k = mine.size
    cost = square[:k] + square[k:].reshape(k, -1).sum(axis=1) if k else square
    return float(cost[np.isin(mine, theirs)].sum())
