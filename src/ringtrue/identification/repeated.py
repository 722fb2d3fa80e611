"""Repeated roots in ambient records: two modes nearer than the record tells, of which the plane of
shapes is known.

The poles of such a pair take another mixture of the two shapes at every order, so that no shape
stays in place; the plane of the two does. In a basis q of that plane each order gives A = C diag(λ)
C⁻¹, C = qᴴψ, free of the mixture. Its mean has the poles of the pair. Where they are no farther
apart than they are known, any turn in the plane fits as well: the shapes are then two real
orthogonal ones, and their deviations hold the turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.identification.ambient_verdict import confidence
from ringtrue.identification.poles import PoleSet, unit
from ringtrue.identification.ssi import BandPoles
from ringtrue.identification.stabilise import Candidates, groups_table, stable_poles, stacked
from ringtrue.shapes.complexity import mpc

LEAST_CHANNELS = 4  # in a plane of three channels any shape nearly lies
MOST_ORDERS = 0.3  # share that must show two poles in one plane
WITHIN = 0.8  # of a squared shape that must lie in the plane
UNLIKE = 0.05  # least eigenvalue of the Gram matrix of two unit shapes that span a plane
WEAK = 0.2  # strength of the weaker pole over that of the stronger
ANY = float(np.sqrt(0.5))
SEPARATE = 2.0  # standard deviations between poles that are told apart
DAMPING = 3.0  # ratio to that of the place within which a pole may be one of a pair


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two modes of a plane.

    Attributes
    ----------
    members : (order, 2) int64
        Positions among the poles of the band.
    basis : (ch, 2) complex128, orthonormal
    pole : (2,) complex128, rad/s, ascending
    shape : (ch, 2) complex128
    turn : float
        Standard deviation of each shape towards the other, 1/sqrt(2) where any turn in the plane is
        as good.
    """

    members: Int
    basis: Complex
    pole: Complex
    shape: Complex
    turn: float


def with_pairs(
    table: Candidates, band: BandPoles, halves: tuple[PoleSet, PoleSet], tries: int, least: float
) -> tuple[Candidates, list[tuple[int, int]]]:
    """The candidates with two more rows for each pair that they lack, and the rows of pairs that
    are not told apart.

    Rows that the two replace are agreed on by no half of the record any more.

    Parameters
    ----------
    table : Candidates
    band : BandPoles
    halves : poles of the first and the second half of the record
    tries : int
        Orders there are to try.
    least : float
        Confidence of what is reported.
    """
    free: list[tuple[int, int]] = []
    if table.shape.shape[0] < LEAST_CHANNELS:
        return table, free
    worth = table.stable | stable_poles(
        band, collinearity=0.0
    )  # a mixture of two real shapes is complex
    for f, z in _places(table):
        pair = _pair(band, worth, f, z)
        if pair is None:
            continue
        near = np.abs(table.frequencies / f - 1) < z
        own = np.flatnonzero(near & (_inside(table.shape, pair.basis) > WITHIN))
        if pair.turn < ANY and (confidence(table, tries)[own] > least).sum() > 1:
            continue
        two = _rows(band, pair, min(_seen(h, pair.basis, f, z) for h in halves))
        if confidence(two, tries).min() < least:
            continue
        doubt = table.halves.copy()
        doubt[own] = 0.0
        rows = (table.pole.size, table.pole.size + 1)
        table = stacked(replace(table, halves=doubt), two)
        free += [rows] if pair.turn == ANY else []
    return table, free


def loosened(table: Candidates, pairs: list[tuple[int, int]]) -> Candidates:
    """The candidates with every turn in the plane of the pairs among the deviations of their
    shapes.
    """
    if not pairs:
        return table
    d = np.pad(table.shape_deviation, ((0, 0), (0, 0), (0, 1)))
    for rows in pairs:
        both = table.shape[:, rows]
        inverse, size = np.linalg.pinv(both), np.linalg.norm(both, axis=0)
        for k, row in enumerate(rows):
            other = both[:, 1 - k]
            d[row] -= np.outer(other, inverse[1 - k] @ d[row])
            d[row, :, -1] = ANY * other * size[k] / size[1 - k]
    return replace(table, shape_deviation=d)


def _places(table: Candidates) -> list[tuple[float, float]]:
    """Frequency, Hz, and damping of the places to look at: the strongest candidates, a bandwidth
    apart.
    """
    out: list[tuple[float, float]] = []
    for k in np.argsort(-table.strength, kind="stable"):
        f, z = float(table.frequencies[k]), float(table.damping[k])
        if all(abs(f - g) > 2 * max(z * f, y * g) for g, y in out):
            out.append((f, z))
    return out


def _inside(shape: Complex, basis: Complex) -> Float:
    """(k,) share of the squared shapes (ch, k) that lies in the plane."""
    return np.asarray((np.abs(basis.conj().T @ shape) ** 2).sum(0) / (np.abs(shape) ** 2).sum(0))


def _near(p: PoleSet, f: float, z: float, slack: float = 1.0) -> Int:
    most = DAMPING * slack
    like = (p.damping > z / most) & (p.damping < z * most)
    return np.flatnonzero((np.abs(p.frequencies / f - 1) < slack * z) & like)


def _pair(band: BandPoles, stable: Bool, f: float, z: float) -> Pair | None:
    """The pair at a place, if enough orders show two poles in one plane."""
    p = band.poles
    near = np.intersect1d(_near(p, f, z), np.flatnonzero(stable))
    two = []
    for n in np.unique(p.order[near]):
        here = near[p.order[near] == n]
        best = here[np.argsort(p.std_frequency[here], kind="stable")[:2]]
        if best.size == 2 and band.strength[best].min() > WEAK * band.strength[best].max():
            two.append(best)
    if len(two) < MOST_ORDERS * p.orders.size:
        return None
    at = np.array(two)
    planes, size, _ = np.linalg.svd(
        np.moveaxis(p.shape[:, at], 1, 0) / np.linalg.norm(p.shape[:, at], axis=0)[:, None],
        full_matrices=False,
    )
    at, planes = at[size[:, 1] ** 2 > UNLIKE], planes[size[:, 1] ** 2 > UNLIKE]
    if len(at) < MOST_ORDERS * p.orders.size:
        return None
    basis = np.linalg.eigh(np.einsum("nik,njk->ij", planes, planes.conj()))[1][:, -2:]
    like = np.linalg.svd(basis.conj().T @ planes, compute_uv=False)[:, 1] ** 2 > WITHIN
    if like.sum() < MOST_ORDERS * p.orders.size:
        return None
    return _solved(band, at[like], basis)


def _solved(band: BandPoles, at: Int, basis: Complex) -> Pair:
    """Poles and shapes of the pair from its members at all orders."""
    p = band.poles
    c = np.moveaxis(np.tensordot(basis.conj().T, p.shape[:, at], 1), 1, 0)
    a = (c * p.pole[at][:, None]) @ np.linalg.inv(c)
    w = 1 / (np.abs(_mean_deviation(band, at)) ** 2).sum(1)
    mean = np.tensordot(w / w.sum(), a, 1)
    pole, vectors = np.linalg.eig(mean)
    std = np.sqrt(2 * (np.abs(w @ _mean_deviation(band, at) / w.sum()) ** 2).sum())
    turn = np.sqrt(2) * std / abs(pole[0] - pole[1])
    told = turn < 1 / SEPARATE
    real, size, _ = np.linalg.svd(
        np.concatenate([basis.real, basis.imag], axis=1), full_matrices=False
    )
    if not told and size[2] < 0.5 * size[1]:
        inner = real[:, :2].T @ basis
        turned = (inner @ mean @ np.linalg.inv(inner)).imag
        shape = (real[:, :2] @ np.linalg.eigh(turned + turned.T)[1]).astype(np.complex128)
    else:
        shape = basis @ (vectors if told else np.eye(2))
    rank = np.argsort(np.abs(pole))
    return Pair(at, basis, pole[rank], shape[:, rank] if told else shape, turn if told else ANY)


def _mean_deviation(band: BandPoles, at: Int) -> Complex:
    """(order, block) deviations of the mean of the two poles of each order."""
    return np.asarray(band.deviation[at].mean(axis=1))


def _rows(band: BandPoles, pair: Pair, agreed: float) -> Candidates:
    """The two rows of a pair; the poles are known as two independent ones, of which their mean is
    known.
    """
    at, p = pair.members, band.poles
    d = _mean_deviation(band, at)
    w = 1 / (np.abs(d) ** 2).sum(1)
    d = w @ d / w.sum()
    alike = np.abs((p.shape[:, at[:, 0]].conj() * p.shape[:, at[:, 1]]).sum(0))
    alike /= np.linalg.norm(p.shape[:, at[:, 0]], axis=0) * np.linalg.norm(
        p.shape[:, at[:, 1]], axis=0
    )
    table = groups_table(
        band, [at[[alike.argmin()], k] for k in (0, 1)]
    )  # the order that tells the plane best
    c = np.linalg.lstsq(table.shape, pair.shape)[0]
    outside = np.einsum("mk,mcb->kcb", c, table.shape_deviation)
    outside -= np.einsum("cd,kdb->kcb", pair.basis @ pair.basis.conj().T, outside)
    size = np.linalg.norm(pair.shape, axis=0)
    other = pair.shape[:, ::-1] * (size / size[::-1])
    outside += pair.turn * other.T[:, :, None] * (np.abs(d) / np.linalg.norm(d))
    top = np.take_along_axis(pair.shape, np.abs(pair.shape).argmax(0)[None], 0)[0]
    return replace(
        table,
        pole=pair.pole,
        deviation=np.stack([np.concatenate([d, s * d]) for s in (1.0, -1.0)]),
        shape=unit(pair.shape),
        shape_deviation=outside / top[:, None, None],
        share=np.full(2, len(at) / max(int((p.orders >= p.order[at].min()).sum()), 1)),
        orders=np.array([[len(at), p.orders.size]] * 2),
        halves=np.full(2, agreed),
        mpc=mpc(pair.shape),
        label=_labels(len(p), at),
    )


def _labels(poles: int, at: Int) -> Int:
    label = np.full(poles, -1, dtype=np.int64)
    label[at] = np.arange(2)
    return label


def _seen(h: PoleSet, basis: Complex, f: float, z: float) -> float:
    """Share of the orders of half a record that show two poles of the plane."""
    near = _near(h, f, z, 1.5)
    near = near[_inside(h.shape[:, near], basis) > WITHIN]
    psi = h.shape / np.linalg.norm(h.shape, axis=0)
    seen = 0
    for n in np.unique(h.order[near]):
        c = basis.conj().T @ psi[:, near[h.order[near] == n]]
        seen += c.shape[1] > 1 and np.linalg.eigvalsh(c @ c.conj().T)[0] > UNLIKE
    return seen / max(h.orders.size, 1)
