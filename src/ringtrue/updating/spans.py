"""What the model has in place of a test mode in shape residuals: a mode, or a space that fades
where modes move apart.

Where test modes are close, only the space that they span is well measured. The model's modes that
stand for one are then its partner, the partners of the close ones, and what is close to it in the
model. Each of these counts less and less as it moves away, so that residuals and their
sensitivities are smooth.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.correlation.assignment import APART, PairingSettings
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import close_groups, fade, unit


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """The mean of projectors on sets of modes, each of which holds the one before.

    Attributes
    ----------
    sets : tuple (s) of (g,) int64
        Modes of the model, the pair's own first.
    weight : (s,) float64
        Sums to 1.
    slope : (s, p) float64, ∂weight/∂x
    """

    sets: tuple[Int, ...]
    weight: Float
    slope: Float

    @property
    def size(self) -> float:
        """Mean number of modes."""
        return float(self.weight @ [g.size for g in self.sets])

    def held(self) -> Span:
        """The same with weights that no longer change."""
        return replace(self, slope=np.zeros((len(self.sets), 0)))


def spans(
    frequencies: Float, used: Bool, pairs: Int, now: Linearisation, settings: PairingSettings
) -> tuple[Span, ...]:
    """The span of each pair (k, 2) of a test mode and a mode of the model; a mode at 0 Hz stands
    alone.

    Parameters
    ----------
    frequencies : (m,) float64, Hz, of the test
    used : (m,) bool
        Test modes whose partners stand for close ones, too.
    """
    partner = {t: f for t, f in pairs.tolist() if used[t]}
    near = {
        t: g for g in close_groups(frequencies, settings.close, settings.largest_group) for t in g
    }
    return tuple(
        _around(now, f, {partner[s] for s in near[t] if s in partner}, settings)
        if len(near[t]) > 1 and now.frequencies[f] > 0
        else _one(now, f)
        for t, f in pairs.tolist()
    )


def _one(now: Linearisation, f: int) -> Span:
    return Span((np.array([f]),), np.ones(1), np.zeros((1, now.d_lambda.shape[1])))


def _around(
    now: Linearisation, f: int, partners: Collection[int], settings: PairingSettings
) -> Span:
    """Mode `f`, those close to it, and partners of close test modes within `APART` times that."""
    limit = np.full(now.frequencies.size, settings.close)
    limit[list(partners)] *= APART
    here = np.flatnonzero(now.frequencies > 0)
    log = np.log(now.frequencies[here] / now.frequencies[f])
    ratio = np.where(here == f, 0.0, np.abs(log) / limit[here])
    order = np.argsort(ratio, kind="stable")[: settings.largest_group]
    order = order[fade(ratio[order])[0] > 0]
    at, (height, steep) = here[order], fade(ratio[order])
    d_log = now.d_lambda[at] / (2 * (2 * np.pi * now.frequencies[at, None]) ** 2)
    d_height = (steep * np.sign(log[order]) / limit[at])[:, None] * (d_log - d_log[:1])
    weight, slope = (
        -np.diff(height, append=0.0),
        -np.diff(d_height, axis=0, append=np.zeros((1, d_log.shape[1]))),
    )
    some = np.flatnonzero(weight > 0)
    return Span(tuple(at[: k + 1] for k in some.tolist()), weight[some], slope[some])


def span_residual(shapes: Float, now: Linearisation, t: int, span: Span) -> tuple[Float, Float]:
    """ψ − Σ w P ψ and ∂(Σ w P ψ)/∂x of test mode `t` of `shapes` (channel, m): (channel,) and
    (channel, p).
    """
    if len(span.sets) == 1:  # as nearly always
        return shape_residual(shapes, now, t, span.sets[0])
    parts = [shape_residual(shapes, now, t, g) for g in span.sets]
    rest = np.array([r for r, _ in parts])
    slope = np.einsum("s,scp->cp", span.weight, np.array([g for _, g in parts]))
    return span.weight @ rest, slope - (rest.T @ span.slope if span.slope.shape[1] else 0.0)


def shape_residual(shapes: Float, now: Linearisation, t: int, group: Int) -> tuple[Float, Float]:
    """(I − P) ψ and ∂(Pψ)/∂x with P the projector on the model's shapes; ‖(I − P) ψ‖² = 1 − MAC.

    The scale (modal scale factor) and a rotation inside the group are projected out at every point.
    """
    psi = unit(shapes[:, [t]])[:, 0]
    phi = now.shapes[:, group]
    alone = group.size == 1  # as nearly always: half the time
    plus = (
        phi.T / max(float((phi**2).sum()), np.finfo(np.float64).tiny)
        if alone
        else np.linalg.pinv(phi)
    )
    inside = phi @ (plus @ psi)
    rest = psi - inside
    d_phi = now.d_shapes[:, group, :]
    first = np.einsum("cgp,g->cp", d_phi, plus @ psi)
    first -= phi @ (plus @ first)
    second = plus.T @ np.einsum("cgp,c->gp", d_phi, rest)
    return rest, first + second
