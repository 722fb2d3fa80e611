"""The objective J(p) = Δzᵀ W Δz + pᵀ W_p p: residuals of eigenvalues and mode shapes with their
sensitivities.

Friswell and Mottershead (1995), Finite Element Model Updating in Structural Dynamics, ch. 8 and 9.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Float, Int, freeze_arrays
from ringtrue.correlation.assignment import (
    NO_LOCKS,
    WORTH,
    ComparedModes,
    Followed,
    Locks,
    PairingSettings,
    Scores,
    assign,
    peak_shares,
    scores,
)
from ringtrue.correlation.one_criterion import chance_of_mac, independent_patterns
from ringtrue.errors import InputError
from ringtrue.model.ports import Linearisation
from ringtrue.shapes import above_rounding, close_groups, fade, unit

# a used mode without a partner counts like a frequency deviation of ten standard deviations
LOST = 100.0
DOUBT = 16.0  # four standard deviations, of a mode whose shape says nothing
# of the cost of a lost mode, by which a pair that the user decides is better
SURE = 1e-6


@dataclass(frozen=True, slots=True)
class Weights:
    """What a deviation costs: W⁻¹ = Σ_test + Σ_model, diagonal.

    Attributes
    ----------
    frequency : float
        Standard deviation of a relative frequency deviation that the best model of this form is
        expected to keep (model discrepancy); the test's own is added.
    mac : float
        The same for 1 − MAC.
    shape : float
        Factor on the whole shape part; 0 leaves the shapes out.
    independent : float
        Number of independent errors in a shape, each a datum: 1 for what the model lacks, which is
        smooth, the channels for noise (`uncertainty.independent_errors`).
    """

    frequency: float = 0.01
    mac: float = 0.05
    shape: float = 1.0
    independent: float = 1.0

    @property
    def of_shape(self) -> float:
        """On the square of a shape's residual, 1 − MAC; 0 without shapes."""
        return self.shape * self.independent / self.mac if self.shape else 0.0

    @property
    def data(self) -> float:
        """Number of data that a mode gives."""
        return 1 + self.independent if self.shape > 0 else 1.0


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
    rule : {"gates", "capped", "cost"}
        How modes are paired anew at each point: inside the gates of `pairing`; so, or down to half
        the MAC gate where nothing better is left, and no pair dearer than a lost mode; or where the
        objective itself is lowest. With "cost" J is a minimum over assignments and continuous where
        pairs of visible modes change; it has no gates.
    lost : float
        Cost of a used mode without a partner; with "capped" and "cost" no pair costs more.
    fixed : (pairs (k, 2), their spans (k)), optional
        Pairs that are not made anew.
    followed : Followed, optional
        Pairs that the user decides.
    frequency_only : bool
        The shapes are those of the model's own modes: they tell which mode is which, and were not
        measured.
    """

    frequencies: Float
    shapes: Float
    std: Float
    used: Bool
    weights: Weights = field(default_factory=Weights)
    pairing: PairingSettings = field(default_factory=PairingSettings)
    rule: Literal["gates", "capped", "cost"] = "gates"
    lost: float = LOST
    fixed: tuple[Int, tuple[Span, ...]] | None = None
    followed: Followed | None = None
    frequency_only: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)
        m = self.frequencies.size
        sizes = (self.shapes.shape[1], self.std.size, self.used.size)
        if sizes != (m, m, m):
            raise InputError(f"{m} frequencies; shapes, std and used of {sizes} modes")

    def doubting(self, spread: float = 1.0) -> Target:
        """The same for a point near the end: a mode that costs more than `doubt` has no partner.

        A test mode that the model does not have then pulls no more than one without a partner.
        Shapes say which modes belong together: in a dense band some mode always has the right
        frequency. `spread` is what the pairs deviate by, in units of what the best model is
        expected to keep. Pairs without measured shapes stay: none was measured that could look
        otherwise.
        """
        if self.frequency_only:
            return self
        return replace(self, rule="capped", lost=self.doubt(spread))

    def doubt(self, spread: float = 1.0) -> float:
        """What a pair at the MAC gate costs at most: more means that the model lacks the mode.

        Four standard deviations, and −2 ln of the probability that the shape of a mode that the
        model lacks matches one of its modes by chance (`unexpected`). With many sensors shapes that
        match are of one mode, however far its frequency is off; with few they say little.
        """
        deviation = DOUBT * spread**2 * max(self.weights.data / 2, 1.0)
        return deviation + float(self.unexpected(np.array(self.pairing.mac_gate)))

    def unexpected(self, mac: Float) -> Float:
        """−2 ln of the probability that a mode which the model lacks has a MAC as large with one of
        its modes; of these as many are near as were measured. 0 without measured shapes.
        """
        if self.frequency_only or not self.shapes.any():
            return np.zeros(mac.shape)
        chance = (
            chance_of_mac(mac, independent_patterns(self.shapes))
            * self.frequencies.size
        )
        return -2 * np.log(np.clip(chance, np.finfo(np.float64).tiny, 1.0))

    def compared(self, now: Linearisation) -> Scores:
        """Each test mode with each mode of the model."""
        modes = ComparedModes(
            self.frequencies, self.shapes, now.frequencies, now.shapes
        )
        return scores(modes, self.pairing)

    def lowest(self, count: int) -> Target:
        """The same up to the highest of so many used modes, the lowest; pairs are made anew."""
        used = np.sort(self.frequencies[self.used])
        if used.size <= count:
            return self
        at = np.flatnonzero(self.frequencies <= used[count - 1])
        return replace(
            self,
            frequencies=self.frequencies[at],
            shapes=self.shapes[:, at],
            std=self.std[at],
            used=self.used[at],
            fixed=None,
            followed=self.followed and self.followed.among(at),
        )

    def settled(self, now: Linearisation, spread: float = 1.0) -> Target:
        """The same with the pairs that `doubting` makes at a point, for good; modes without a
        partner are not used.

        J is then smooth: pairs and groups of close modes no longer change from step to step. Where
        no used mode has a partner near enough, the point is no end, and the pairs are those of the
        own rule.
        """
        for aim in (self.doubting(spread), self):
            pairs, _, spread_out = match(aim, now)
            used = self.used & np.isin(np.arange(self.used.size), pairs[:, 0])
            if used.any():
                break
        return replace(
            self, used=used, fixed=(pairs, tuple(s.held() for s in spread_out))
        )


def match(
    target: Target, now: Linearisation, held: Bool | None = None
) -> tuple[Int, Float, tuple[Span, ...]]:
    """Pairs (k, 2), their MAC (k,) and what stands for each test mode, by one assignment over MAC
    and frequency.

    Test modes in `held` (m,) keep a partner down to half the MAC gate: one that stands at the gate
    must not come and go from step to step. With the rule "capped" these are all.
    """
    if target.fixed is not None:
        pairs, of = target.fixed
        rest, _ = span_residuals(target.shapes, now, pairs, of)
        return pairs, 1 - (rest**2).sum(axis=0), of
    s = target.compared(now)
    locks = (
        target.followed.locks(now.shapes) if target.followed is not None else NO_LOCKS
    )
    if target.rule == "cost":
        pairs = _cheapest(target, now, s, locks)
    elif target.rule == "capped":
        pairs = _gated(target, now, s, locks, np.ones(target.used.size, dtype=np.bool_))
        forced, _ = locks.mask((target.used.size, now.frequencies.size))
        # a shape that matches by less than the gate says less against the deviation
        gate = np.array(target.pairing.mac_gate)
        less = target.unexpected(gate) - target.unexpected(np.minimum(s.merged, gate))
        pairs = pairs[
            ((_costs(target, s) < target.lost - less) | forced)[tuple(pairs.T)]
        ]
    else:
        pairs = _gated(target, now, s, locks, held)
    of = spans(target.frequencies, target.used, pairs, now, target.pairing)
    return pairs, s.merged[pairs[:, 0], pairs[:, 1]], of


def _gated(
    target: Target, now: Linearisation, s: Scores, locks: Locks, held: Bool | None
) -> Int:
    """Pairs (k, 2) inside the gates, those of modes in `held` (m,) inside wider ones."""
    every = np.ones(target.frequencies.size, dtype=np.bool_)
    usable = _usable(now)
    trust = _trust(target, now, s)
    rows, cols = assign(
        s,
        target.pairing,
        usable_a=every,
        usable_b=usable,
        locks=locks,
        trust=trust,
    )
    pairs = np.stack([rows, cols], axis=1)
    if held is None:
        held = ~every
    lost = held & ~np.isin(np.arange(every.size), rows)
    if lost.any():
        keep = held[rows]  # a mode that had no partner gives way
        free = usable & ~np.isin(np.arange(usable.size), cols[keep])
        gates = target.pairing
        wide = replace(
            gates,
            mac_gate=WORTH.hold * gates.mac_gate,
            frequency_gate=gates.frequency_gate / WORTH.hold,
        )
        barred = Locks((), locks.forbidden)
        found = assign(s, wide, usable_a=lost, usable_b=free, locks=barred, trust=trust)
        more = np.stack(found, axis=1)
        keep |= ~np.isin(cols, more[:, 1])
        pairs = np.concatenate([pairs[keep], more])
        pairs = pairs[np.argsort(pairs[:, 0])]
    return pairs


def _usable(now: Linearisation) -> Bool:
    """Modes of the model that are elastic and move the sensors by more than rounding, (n,)."""
    return (now.frequencies > 0) & above_rounding(now.shapes).any(axis=0)


def _trust(target: Target, now: Linearisation, s: Scores) -> Float:
    """How far each pair is trusted, (m, n): less than 1 with a mode that the sensors see little of.

    Near a global mode such a local one has nearly its shape at the sensors, and the test sees the
    global one. What counts is how much better than the best of the visible modes in reach it
    matches: a test that has measured the faint mode itself has its shape, and with exact data the
    trust is 1. Without shapes all are trusted.
    """
    faint = peak_shares(now.shapes) < target.pairing.faint
    trust = np.ones(s.error.shape)
    if not faint.any() or np.isnan(s.merged).any():
        return trust
    rest = np.maximum(1 - s.merged, 0.0)
    in_reach = (
        (np.abs(s.error) <= target.pairing.frequency_gate)
        & ~faint
        & (now.frequencies > 0)
    )
    visible = np.where(in_reach, rest, np.inf).min(axis=1, keepdims=True)
    better = rest < visible
    trust[:, faint] = np.where(better, 1 - rest / np.where(better, visible, 1.0), 0.0)[
        :, faint
    ]
    return trust


def _cheapest(target: Target, now: Linearisation, s: Scores, locks: Locks) -> Int:
    """Pairs (k, 2) of least total cost, `lost` for a mode without a partner: first the used modes,
    then the others.
    """
    gain = target.lost - np.minimum(_costs(target, s), target.lost)
    cost = target.lost - gain * _trust(target, now, s)
    cost[:, ~_usable(now)] = target.lost
    forced, free = locks.mask((cost.shape[0], cost.shape[1]))
    cost = np.where(free, cost, target.lost)
    cost[forced] = np.minimum(cost[forced], (1 - SURE) * target.lost)
    found: list[tuple[int, int]] = []
    for rows in (np.flatnonzero(target.used), np.flatnonzero(~target.used)):
        free = np.setdiff1d(np.arange(now.frequencies.size), [j for _, j in found])
        alone = np.full((rows.size, rows.size), target.lost)
        i, j = linear_sum_assignment(np.hstack([cost[np.ix_(rows, free)], alone]))
        keep = j < free.size
        found += zip(rows[i[keep]].tolist(), free[j[keep]].tolist(), strict=True)
    pairs = np.array(sorted(p for p in found if cost[p] < target.lost), dtype=np.int64)
    return pairs.reshape(-1, 2)


def _costs(target: Target, s: Scores) -> Float:
    """What each pair adds to J, (m, n)."""
    w = target.weights
    root = 0.5 / np.sqrt(w.frequency**2 + target.std**2)
    shape = w.of_shape * (1 - s.merged)
    return (root[:, None] * ((1 + s.error) ** 2 - 1)) ** 2 + shape


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
    frequencies: Float,
    used: Bool,
    pairs: Int,
    now: Linearisation,
    settings: PairingSettings,
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
    groups = close_groups(frequencies, settings.close, settings.largest_group)
    near = {t: g for g in groups for t in g}
    out = []
    for t, f in pairs.tolist():
        if len(near[t]) > 1 and now.frequencies[f] > 0:
            partners = {partner[s] for s in near[t] if s in partner}
            out.append(_around(now, f, partners, settings))
        else:
            still = np.zeros((1, now.d_lambda.shape[1]))
            out.append(Span((np.array([f]),), np.ones(1), still))
    return tuple(out)


def _around(
    now: Linearisation, f: int, partners: Collection[int], settings: PairingSettings
) -> Span:
    """Mode `f`, those close to it, and partners of close test modes within a multiple of that."""
    limit = np.full(now.frequencies.size, settings.close)
    limit[list(partners)] *= WORTH.close
    here = np.flatnonzero(now.frequencies > 0)
    log = np.log(now.frequencies[here] / now.frequencies[f])
    ratio = np.where(here == f, 0.0, np.abs(log) / limit[here])
    order = np.argsort(ratio, kind="stable")[: settings.largest_group]
    order = order[fade(ratio[order])[0] > 0]
    at, (height, steep) = here[order], fade(ratio[order])
    d_log = now.d_lambda[at] / (2 * (2 * np.pi * now.frequencies[at, None]) ** 2)
    d_height = (steep * np.sign(log[order]) / limit[at])[:, None] * (d_log - d_log[:1])
    weight = -np.diff(height, append=0.0)
    slope = -np.diff(d_height, axis=0, append=np.zeros((1, d_log.shape[1])))
    some = np.flatnonzero(weight > 0)
    return Span(tuple(at[: k + 1] for k in some), weight[some], slope[some])


def span_residuals(
    shapes: Float, now: Linearisation, pairs: Int, of: Sequence[Span]
) -> tuple[Float, Float]:
    """ψ − Σ w P ψ and ∂(Σ w P ψ)/∂x of test modes ψ: (channel, k) and (channel, k, p).

    Parameters
    ----------
    shapes : (channel, m) float64
        Of the test.
    now : Linearisation
    pairs : (k, 2) int64
        Test modes and their partners.
    of : sequence (k) of Span
    """
    t, f = pairs.T
    psi = unit(shapes[:, t])
    phi = now.shapes[:, f]
    size = np.maximum((phi**2).sum(axis=0), np.finfo(np.float64).tiny)
    share = (phi * psi).sum(axis=0) / size
    rest = psi - share * phi
    d_phi = now.d_shapes[:, f]
    slope = share[:, None] * d_phi
    along = np.einsum("ckp,ck->kp", d_phi, rest) - np.einsum("ckp,ck->kp", slope, phi)
    slope += phi[:, :, None] * (along / size[:, None])
    for k in (k for k, span in enumerate(of) if span.size > 1):  # few pairs
        span = of[k]
        parts = [shape_residual(shapes, now, t[k], g) for g in span.sets]
        rests = np.array([r for r, _ in parts])
        rest[:, k] = span.weight @ rests
        slope[:, k] = np.einsum(
            "s,scp->cp", span.weight, np.array([g for _, g in parts])
        )
        if span.slope.shape[1]:
            slope[:, k] -= rests.T @ span.slope
    return rest, slope


def shape_residual(
    shapes: Float, now: Linearisation, t: int, group: Int
) -> tuple[Float, Float]:
    """(I − P) ψ and ∂(Pψ)/∂x with P the projector on the model's shapes; ‖(I − P) ψ‖² = 1 − MAC.

    The scale (modal scale factor) and a rotation inside the group are projected out at every point.
    """
    psi = unit(shapes[:, [t]])[:, 0]
    phi = now.shapes[:, group]
    plus = np.linalg.pinv(phi)
    inside = phi @ (plus @ psi)
    rest = psi - inside
    d_phi = now.d_shapes[:, group, :]
    first = np.einsum("cgp,g->cp", d_phi, plus @ psi)
    first -= phi @ (plus @ first)
    second = plus.T @ np.einsum("cgp,c->gp", d_phi, rest)
    return rest, first + second
