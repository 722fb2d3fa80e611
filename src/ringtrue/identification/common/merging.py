"""One set of modes from several records of one structure, with some channels in common.

Frequencies and damping are means by inverse variance. Shapes are glued by least squares on the
common channels (PoSER, Döhler et al. 2010), with the scale of every record from all records before
it. The shapes of a mode agree on common channels whatever excited it: a channel that is turned or
exchanged in one record breaks that in all modes, and undoing the fault mends all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import InputError
from ringtrue.shapes.mac import mac

NEAR = 0.02  # relative distance of frequencies that may be one mode
LEAST = 0.02  # mean 1 − MAC that calls for a reason
CURED = 0.3  # of it that may be left
# modes that must be mended, or all that are in common: one or two may have poor shapes for another
# reason
SEEN = 3
MOST = 3  # faults that are looked for
WIDEST = 40  # common channels
EXACT = 1e-4  # of the largest component: a deviation is no smaller


@dataclass(frozen=True, slots=True)
class CommonFault:
    """A channel that is turned in one record, or two that are exchanged.

    Attributes
    ----------
    record : int
        Position of the record.
    channels : tuple of str
        One that is turned, or two that are exchanged.
    before, after : float
        Mean MAC of the modes of this record with those of the others on the common channels, as
        they are and mended.
    certain : bool
        Whether this record is the one; of two records either may be.
    """

    record: int
    channels: tuple[str, ...]
    before: float
    after: float
    certain: bool

    def describe(self, names: Sequence[str]) -> str:
        """One line."""
        which = names[self.record] if self.certain else " or ".join(names[:2])
        what = "looks turned" if len(self.channels) == 1 else "look exchanged"
        return (
            f"{' and '.join(self.channels)} of {which} {what}: undone (MAC with the other "
            f"records {self.before:.3f} "
            f"before, {self.after:.3f} after)"
        )


def common_faults(records: Sequence[ModeSet]) -> tuple[CommonFault, ...]:
    """Turned and exchanged channels between records of one structure, the surest first.

    Parameters
    ----------
    records : sequence of ModeSet
        With three or more channels and two or more modes in common.
    """
    now = list(records)
    out = []
    for _ in range(MOST):
        best: CommonFault | None = None
        for r in range(1 if len(now) == 2 else 0, len(now)):
            before = _misfits(now, r, now[r])
            if not _mean(before) > LEAST:
                continue
            for channels in _trials(now, r):
                after = _misfits(now, r, undone(now[r], channels))
                gain = _mean(before) - _mean(after)
                if _cured(before, after) and (best is None or gain > best.after - best.before):
                    best = CommonFault(
                        record=r,
                        channels=channels,
                        before=1 - _mean(before),
                        after=1 - _mean(after),
                        certain=len(now) > 2,
                    )
        if best is None:
            break
        now[best.record] = undone(now[best.record], best.channels)
        out.append(best)
    return tuple(out)


def _cured(before: Float, after: Float) -> bool:
    """Whether most of the misfit goes, and not in one or two modes alone."""
    mended = (before > LEAST) & (after < CURED * before)
    return _mean(after) < CURED * _mean(before) and bool(
        mended.sum() >= min(SEEN, np.isfinite(before).sum())
    )


def undone(modes: ModeSet, channels: tuple[str, ...]) -> ModeSet:
    """The modes with one channel turned, or two exchanged."""
    at = [modes.channels.index(c) for c in channels]
    shapes = np.array(modes.shapes)
    shapes[at] = -shapes[at] if len(at) == 1 else shapes[at[::-1]]
    return replace(modes, shapes=shapes)


def _trials(records: Sequence[ModeSet], r: int) -> Iterator[tuple[str, ...]]:
    others = {c for k, m in enumerate(records) if k != r for c in m.channels}
    shared = [c for c in records[r].channels if c in others][:WIDEST]
    if len(shared) > 2:
        yield from ((c,) for c in shared)
        yield from combinations(shared, 2)


def _misfits(records: Sequence[ModeSet], r: int, changed: ModeSet) -> Float:
    """(m,) 1 − MAC of each mode of a record, mean over all others that it shares three channels
    with; NaN: in none.
    """
    others = [m for k, m in enumerate(records) if k != r]
    misfits = np.array([_one_minus_mac(changed, m) for m in others]).reshape(
        len(others), len(changed)
    )
    known = np.isfinite(misfits)
    misfits = misfits[known.sum(axis=1) > 1]
    known = known[known.sum(axis=1) > 1]
    count = known.sum(axis=0)
    total = np.where(known, misfits, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0))


def _mean(misfits: Float) -> float:
    known = misfits[np.isfinite(misfits)]
    return float(known.mean()) if known.size else 0.0


def _one_minus_mac(a: ModeSet, b: ModeSet) -> Float:
    """(a,) of the modes that two records share, matched by shape among those of like frequency; NaN
    without a match.
    """
    out = np.full(len(a), np.nan)
    shared = [c for c in a.channels if c in b.channels]
    if len(shared) < 3 or not len(a) or not len(b):
        return out
    rows_a = _rows_of(a, shared)
    rows_b = _rows_of(b, shared)
    misfit = 1 - mac(a.shapes[rows_a], b.shapes[rows_b])
    near = np.abs(a.frequencies[:, None] / b.frequencies - 1) < NEAR
    i, j = linear_sum_assignment(np.where(near, misfit, 10.0))
    out[i[near[i, j]]] = misfit[i, j][near[i, j]]
    return out


def _rows_of(modes: ModeSet, channels: Sequence[str]) -> Int:
    return np.array([modes.channels.index(c) for c in channels], dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """The modes of one record, with their uncertainty and a name."""

    modes: ModeSet
    uncertainty: Uncertainty
    name: str


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one record gave to a merged mode.

    Attributes
    ----------
    record : str
    mode : int
        Position in the record's modes.
    frequency, damping : float
    mac : float
        With the merged shape on the record's channels; NaN for fewer than two.
    outlier : bool
        Farther from the merged value than its standard deviation explains; left out of frequency
        and damping.
    why : str
    """

    record: str
    mode: int
    frequency: float
    damping: float
    mac: float
    outlier: bool
    why: str


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """How modes of different records are matched.

    Attributes
    ----------
    frequency : float
        Largest relative distance.
    mac : float
        Smallest MAC on the common channels, where there are two or more.
    weak : float
        The same where frequencies agree within `spread`: a mode that the channels see little of has
        a poor shape.
    outlier : float
        Standard deviations from the median beyond which a record is flagged.
    spread : float
        A relative difference of frequency that records may have by themselves (temperature,
        amplitude).
    mend : bool
        Undo channels that are turned or exchanged in one record (`identify.common`), and say so.
    """

    frequency: float = 0.05
    mac: float = 0.5
    weak: float = 0.3
    outlier: float = 4.0
    spread: float = 2e-3
    mend: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Merged modes; `provenance` lists for each mode what every record gave, `notes` what was
    undone in a record.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    provenance: tuple[tuple[Contribution, ...], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Modes of different records that are one: (record, mode), frequency, and the shape glued so
    far.
    """

    members: tuple[tuple[int, int], ...]
    frequency: float
    shape: Complex
    var: Float


def _rows(record: Record, channels: Sequence[str]) -> Int:
    at = {c: i for i, c in enumerate(channels)}
    return np.array([at.get(c, -1) for c in record.modes.channels], dtype=np.int64)


def _spread_out(record: Record, rows: Int, n: int) -> tuple[Complex, Float]:
    """Shapes and their variances on all channels (n, m), NaN where the record has none."""
    m = len(record.modes)
    psi = np.full((n, m), np.nan, dtype=np.complex128)
    var = np.full((n, m), np.nan)
    here = rows >= 0
    psi[rows[here]] = record.modes.shapes[here]
    size = np.abs(record.modes.shapes).max(0, initial=1e-300)
    v = np.where(np.isfinite(record.uncertainty.shape), record.uncertainty.shape, 0.02 * size) ** 2
    var[rows[here]] = np.maximum(v, (EXACT * size) ** 2)[here]
    return psi, var


def _match(group: _Group, psi: Complex, freqs: Float, settings: MergeSettings) -> Float:
    """(m,) cost of joining each mode of a record to a group, infinite where it may not."""
    df = np.abs(freqs / group.frequency - 1)
    both = (
        np.isfinite(group.shape) & np.isfinite(psi).all(1)
        if psi.shape[1]
        else np.zeros(group.shape.size, bool)
    )
    like = mac(group.shape[both, None], psi[both])[0] if both.sum() > 1 else np.ones(freqs.size)
    least = np.where(df < settings.spread, settings.weak, settings.mac)
    ok = (df < settings.frequency) & (like >= least)
    return np.where(ok, df / settings.frequency + 1 - like, np.inf)


def _glue(group: _Group, psi: Complex, var: Float, member: tuple[int, int], freq: float) -> _Group:
    """Bring `psi` to the scale of the group by least squares on the common channels, and
    average.
    """
    both = np.isfinite(group.shape) & np.isfinite(psi)
    if (
        not both.any()
    ):  # nothing in common: neither scale nor sign is known, the shape stays as it is
        return _Group((*group.members, member), group.frequency, group.shape, group.var)
    ratio = (np.abs(group.shape[both]) ** 2).sum() / np.maximum(
        (np.abs(psi[both]) ** 2).sum(), 1e-300
    )
    w = 1 / (group.var[both] + ratio * var[both])
    scale = (w * psi[both].conj() * group.shape[both]).sum() / (w * np.abs(psi[both]) ** 2).sum()
    # the scale is no better known than the common channels tell it
    new = psi * scale
    v = var * np.abs(scale) ** 2 + np.abs(psi) ** 2 / (w * np.abs(psi[both]) ** 2).sum()
    wa = np.where(np.isfinite(group.var), 1 / group.var, 0.0)
    wb = np.where(np.isfinite(v), 1 / v, 0.0)
    total = wa + wb
    inverse = np.divide(1.0, total, out=np.full(total.shape, np.nan), where=total > 0)
    mean = (wa * np.nan_to_num(group.shape) + wb * np.nan_to_num(new)) * np.nan_to_num(inverse)
    shape = np.where(total > 0, mean, np.nan).astype(np.complex128)
    k = len(group.members)
    return _Group((*group.members, member), (k * group.frequency + freq) / (k + 1), shape, inverse)


def _assign(
    groups: list[_Group], record: Record, index: int, full: tuple[Complex, Float], s: MergeSettings
) -> None:
    """Join each mode of a record to the group it fits best, each group once; the others begin a
    group.
    """
    psi, var = full
    freqs = record.modes.frequencies
    cost = np.array([_match(g, psi, freqs, s) for g in groups]).reshape(len(groups), freqs.size)
    left = set(range(freqs.size))
    while cost.size and np.isfinite(cost.min()):
        g, k = (int(x) for x in np.unravel_index(int(np.argmin(cost)), cost.shape))
        groups[g] = _glue(
            groups[g], psi[:, k], var=var[:, k], member=(index, k), freq=float(freqs[k])
        )
        cost[g], cost[:, k] = np.inf, np.inf
        left.discard(k)
    groups.extend(
        _Group(((index, k),), float(freqs[k]), psi[:, k], var[:, k]) for k in sorted(left)
    )


def _average(x: Float, sd: Float, s: MergeSettings, spread: float) -> tuple[float, float, Bool]:
    """Mean by inverse variance, its standard deviation, and who is an outlier from the median."""
    sd = np.where(
        np.isfinite(sd) & (sd > 0),
        sd,
        np.nanmax(sd) if np.isfinite(sd).any() else max(spread, 1e-12),
    )
    middle = float(np.median(x))
    distance = np.abs(x - middle) / np.hypot(sd, spread)
    out = (distance > s.outlier) & (x.size > 2)
    w = np.where(out, 0.0, 1 / sd**2)
    mean = float(w @ x / w.sum())
    chi = float(w @ (x - mean) ** 2) / max(int((~out).sum()) - 1, 1)
    # Birge: records that differ by more than they say make the mean less certain
    return mean, float(np.sqrt(max(chi, 1.0) / w.sum())), np.asarray(out)


def _contributions(
    records: Sequence[Record],
    group: _Group,
    full: Sequence[tuple[Complex, Float]],
    s: MergeSettings,
) -> tuple[tuple[float, float, float, float], tuple[Contribution, ...]]:
    """Merged frequency, std, damping, std; and what each record gave."""
    f = np.array([records[r].modes.frequencies[k] for r, k in group.members])
    z = np.array([records[r].modes.damping[k] for r, k in group.members])
    sf = np.array([records[r].uncertainty.frequency[k] for r, k in group.members])
    sz = np.array([records[r].uncertainty.damping[k] for r, k in group.members])
    mf, df, out = _average(f, sf, s, s.spread * group.frequency)
    mz, dz, _ = _average(z[~out], sz[~out], s, 0.0)
    said = []
    for (r, k), fk, zk, o in zip(group.members, f, z, out, strict=True):
        psi = full[r][0][:, k]
        on = np.isfinite(psi) & np.isfinite(group.shape)
        like = float(mac(psi[on, None], group.shape[on, None])[0, 0]) if on.sum() > 1 else np.nan
        why = f"{100 * (fk / mf - 1):+.2f} % in frequency, {100 * (zk / mz - 1):+.0f} % in damping"
        said.append(
            Contribution(
                record=records[r].name,
                mode=k,
                frequency=float(fk),
                damping=float(zk),
                mac=like,
                outlier=bool(o),
                why=why + (": outlier" if o else ""),
            )
        )
    return (mf, df, mz, dz), tuple(said)


def merge_modes(
    records: Sequence[tuple[ModeSet, Uncertainty, str]],
    channels: Sequence[str] | None = None,
    settings: MergeSettings | None = None,
) -> Merged:
    """Merge the modes of several records with partly common channels.

    The record with the most modes is the first to be built on; a mode that a single record shows is
    kept. Shape rows that no record measured for a mode are NaN.

    Parameters
    ----------
    records : sequence of (ModeSet, Uncertainty, name)
    channels : sequence of str
        Rows of the merged shapes; None: all channels in order of appearance.
    settings : MergeSettings

    Raises
    ------
    InputError
        Without records, or if a channel is in no record.
    """
    s = settings or MergeSettings()
    all_records = [Record(*r) for r in records]
    if not all_records:
        raise InputError("no record to merge")
    faults = common_faults([r.modes for r in all_records]) if s.mend else ()
    for fault in faults:
        all_records[fault.record] = _mended(all_records[fault.record], fault.channels)
    known = tuple(dict.fromkeys(c for r in all_records for c in r.modes.channels))
    rows = tuple(channels) if channels is not None else known
    if lost := [c for c in rows if c not in known]:
        raise InputError(
            f"channels in no record: {' '.join(lost[:8])}; there are {' '.join(known[:40])}"
        )
    # gluing uses every channel; the caller's choice is cut out at the end
    full = [_spread_out(r, _rows(r, known), len(known)) for r in all_records]
    groups: list[_Group] = []
    for i in sorted(range(len(all_records)), key=lambda i: (-len(all_records[i].modes), i)):
        _assign(groups, all_records[i], index=i, full=full[i], s=s)
    found = _result(
        all_records, groups, full=full, pick=[known.index(c) for c in rows], channels=rows, s=s
    )
    return replace(found, notes=tuple(x.describe([r.name for r in all_records]) for x in faults))


def _mended(record: Record, channels: tuple[str, ...]) -> Record:
    std = np.array(record.uncertainty.shape)
    at = [record.modes.channels.index(c) for c in channels]
    std[at] = std[at[::-1]]
    return Record(
        undone(record.modes, channels), replace(record.uncertainty, shape=std), record.name
    )


def _of_unit(shape: Complex, var: Float) -> Float:
    """Variances (ch, m) of shapes (ch, m) whose largest component is to be the unit: those of this
    one are theirs.
    """
    if not shape.size:
        return var
    size = np.nan_to_num(np.abs(shape))
    at = (size.argmax(axis=0), np.arange(size.shape[1]))
    out = var + (size / np.maximum(size[at], 1e-300)) ** 2 * var[at]
    out[at] = (EXACT * size[at]) ** 2
    return np.asarray(out)


def _result(
    records: Sequence[Record],
    groups: list[_Group],
    full: Sequence[tuple[Complex, Float]],
    pick: list[int],
    channels: tuple[str, ...],
    s: MergeSettings,
) -> Merged:
    both = [(_contributions(records, g, full, s), g) for g in groups]
    both.sort(key=lambda x: x[0][0][0])
    values = np.array([x[0][0] for x in both]).reshape(len(both), 4)
    n = len(channels)
    shape = (
        np.stack([g.shape[pick] for _, g in both], axis=1)
        if both
        else np.empty((n, 0), np.complex128)
    )
    var = np.stack([g.var[pick] for _, g in both], axis=1) if both else np.empty((n, 0))
    top = np.nan_to_num(np.abs(shape)).max(axis=0, initial=0.0)
    top = np.where(top > 0, top, 1.0)
    var = _of_unit(shape, var)
    confidence = np.array(
        [max(records[r].modes.confidence[k] for r, k in g.members) for _, g in both]
    )
    names = " + ".join(r.name for r in records)
    modes = ModeSet(
        values[:, 0], values[:, 2], shape / top, channels, source=names, confidence=confidence
    )
    std = Uncertainty.independent(values[:, 1], values[:, 3], np.sqrt(var) / top)
    return Merged(modes, std, tuple(x[0][1] for x in both))
