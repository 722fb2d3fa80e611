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

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.modes import ModeSet, OtherCandidates, Uncertainty, joined_modes
from ringtrue.errors import InputError
from ringtrue.shapes import mac


@dataclass(frozen=True, slots=True)
class SensorFaultLimits:
    """When a common channel is turned or exchanged in one record.

    Attributes
    ----------
    frequency : float
        Relative distance of frequencies that may be one mode.
    misfit : float
        Mean 1 − MAC that calls for a reason.
    left : float
        Share of it that may be left when the fault is undone.
    modes : int
        That must be mended, or all that are in common: one or two may have poor shapes for another
        reason.
    faults : int
        That are looked for.
    channels : int
        Common channels that are tried.
    """

    frequency: float = 0.02
    misfit: float = 0.02
    left: float = 0.3
    modes: int = 3
    faults: int = 3
    channels: int = 40


@dataclass(frozen=True, slots=True)
class MergeLimits:
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
    exact : float
        Of the largest component: a deviation is no smaller.
    """

    frequency: float = 0.05
    mac: float = 0.5
    weak: float = 0.3
    outlier: float = 4.0
    spread: float = 2e-3
    exact: float = 1e-4


FAULTS = SensorFaultLimits()
LIMITS = MergeLimits()


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
    """

    record: int
    channels: tuple[str, ...]
    before: float
    after: float

    def describe(self, names: Sequence[str]) -> str:
        """One line; of two records either may be the one."""
        which = names[self.record] if len(names) > 2 else " or ".join(names)
        what = "looks turned" if len(self.channels) == 1 else "look exchanged"
        return (
            f"{' and '.join(self.channels)} of {which} {what}: undone (MAC with the other "
            f"records {self.before:.3f} before, {self.after:.3f} after)"
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
    for _ in range(FAULTS.faults):
        best: CommonFault | None = None
        for r in range(1 if len(now) == 2 else 0, len(now)):
            before = _misfits(now, r, now[r])
            if not _mean(before) > FAULTS.misfit:
                continue
            for channels in _trials(now, r):
                after = _misfits(now, r, undone(now[r], channels))
                mended = (before > FAULTS.misfit) & (after < FAULTS.left * before)
                most = mended.sum() >= min(FAULTS.modes, np.isfinite(before).sum())
                if not most or _mean(after) >= FAULTS.left * _mean(before):
                    continue
                fault = CommonFault(r, channels, 1 - _mean(before), 1 - _mean(after))
                if (
                    best is None
                    or fault.after - fault.before > best.after - best.before
                ):
                    best = fault
        if best is None:
            break
        now[best.record] = undone(now[best.record], best.channels)
        out.append(best)
    return tuple(out)


def undone(modes: ModeSet, channels: tuple[str, ...]) -> ModeSet:
    """The modes with one channel turned, or two exchanged."""
    at = [modes.channels.index(c) for c in channels]
    shapes = np.array(modes.shapes)
    shapes[at] = -shapes[at] if len(at) == 1 else shapes[at[::-1]]
    return replace(modes, shapes=shapes)


def _trials(records: Sequence[ModeSet], r: int) -> Iterator[tuple[str, ...]]:
    others = {c for k, m in enumerate(records) if k != r for c in m.channels}
    shared = [c for c in records[r].channels if c in others][: FAULTS.channels]
    if len(shared) > 2:
        yield from ((c,) for c in shared)
        yield from combinations(shared, 2)


def _misfits(records: Sequence[ModeSet], r: int, changed: ModeSet) -> Float:
    """(m,) 1 − MAC of each mode of a record, mean over all others that it shares three channels
    with; NaN: in none.
    """
    others = [_one_minus_mac(changed, m) for k, m in enumerate(records) if k != r]
    shared = [x for x in others if np.isfinite(x).sum() > 1]
    misfits = np.array(shared).reshape(len(shared), len(changed))
    known = np.isfinite(misfits)
    count = known.sum(axis=0)
    total = np.where(known, misfits, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


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
    misfit = 1 - mac(a.rows(shared).shapes, b.rows(shared).shapes)
    near = np.abs(a.frequencies[:, None] / b.frequencies - 1) < FAULTS.frequency
    i, j = linear_sum_assignment(np.where(near, misfit, 10.0))
    good = near[i, j]
    out[i[good]] = misfit[i, j][good]
    return out


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one record gave to a merged mode.

    Attributes
    ----------
    record : str
    position : int
        Of the record among those that are merged.
    mode : int
        Position in the record's modes.
    outlier : bool
        Farther from the merged value than its standard deviation explains; left out of frequency
        and damping.
    why : str
    """

    record: str
    position: int
    mode: int
    outlier: bool
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Merged modes; `provenance` lists for each mode what every record gave, `notes` and `faults`
    what was undone in a record.
    """

    modes: ModeSet
    uncertainty: Uncertainty
    provenance: tuple[tuple[Contribution, ...], ...]
    notes: tuple[str, ...] = ()
    faults: tuple[CommonFault, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class MergeRecord:
    """The modes of one record, with shapes and their variances on all channels (n, m), NaN where
    the record has none.
    """

    name: str
    modes: ModeSet
    std: Uncertainty
    psi: Complex
    var: Float

    @classmethod
    def of(
        cls, modes: ModeSet, std: Uncertainty, name: str, channels: Sequence[str]
    ) -> MergeRecord:
        at = [channels.index(c) for c in modes.channels]
        psi = np.full((len(channels), len(modes)), np.nan, dtype=np.complex128)
        var = np.full(psi.shape, np.nan)
        psi[at] = modes.shapes
        size = np.abs(modes.shapes).max(0, initial=1e-300)
        stated = np.where(np.isfinite(std.shape), std.shape, 0.02 * size)
        var[at] = np.maximum(stated, LIMITS.exact * size) ** 2
        return cls(name, modes, std, psi, var)


@dataclass(frozen=True, slots=True, eq=False)
class _GluedMode:
    """Modes of different records that are one: (record, mode), frequency, and the shape glued so
    far.
    """

    members: tuple[tuple[int, int], ...]
    frequency: float
    shape: Complex
    var: Float

    def cost(self, record: MergeRecord) -> Float:
        """(m,) of joining each mode of a record, infinite where it may not."""
        freqs = record.modes.frequencies
        df = np.abs(freqs / self.frequency - 1)
        both = np.isfinite(self.shape) & np.isfinite(record.psi).all(1)
        like = np.ones(freqs.size)
        if both.sum() > 1 and freqs.size:
            like = mac(self.shape[both, None], record.psi[both])[0]
        least = np.where(df < LIMITS.spread, LIMITS.weak, LIMITS.mac)
        ok = (df < LIMITS.frequency) & (like >= least)
        return np.where(ok, df / LIMITS.frequency + 1 - like, np.inf)

    def joined(self, record: MergeRecord, index: int, mode: int) -> _GluedMode:
        """With one more mode, brought to this scale by least squares on the common channels."""
        psi = record.psi[:, mode]
        var = record.var[:, mode]
        members = (*self.members, (index, mode))
        both = np.isfinite(self.shape) & np.isfinite(psi)
        # nothing in common: neither scale nor sign is known, the shape stays as it is
        if not both.any():
            return replace(self, members=members)
        own = np.abs(psi[both]) ** 2
        ratio = (np.abs(self.shape[both]) ** 2).sum() / np.maximum(own.sum(), 1e-300)
        w = 1 / (self.var[both] + ratio * var[both])
        scale = (w * psi[both].conj() * self.shape[both]).sum() / (w * own).sum()
        new = psi * scale
        # the scale is no better known than the common channels show it
        v = var * np.abs(scale) ** 2 + np.abs(psi) ** 2 / (w * own).sum()
        wa = np.where(np.isfinite(self.var), 1 / self.var, 0.0)
        wb = np.where(np.isfinite(v), 1 / v, 0.0)
        total = wa + wb
        inverse = np.divide(
            1.0, total, out=np.full(total.shape, np.nan), where=total > 0
        )
        mean = (wa * np.nan_to_num(self.shape) + wb * np.nan_to_num(new)) * inverse
        k = len(self.members)
        frequency = (k * self.frequency + float(record.modes.frequencies[mode])) / (
            k + 1
        )
        return _GluedMode(members, frequency, mean.astype(np.complex128), inverse)


def merge_modes(records: Sequence[tuple[ModeSet, Uncertainty, str]]) -> Merged:
    """Merge the modes of several records with partly common channels.

    The record with the most modes is the first to be built on; a mode that a single record shows is
    kept. Shape rows that no record measured for a mode are NaN. Channels that are turned or
    exchanged in one record are mended, and the notes say so.

    Parameters
    ----------
    records : sequence of (ModeSet, Uncertainty, name)
        The rows of the merged shapes are all channels in order of appearance.

    Raises
    ------
    InputError
        Without records.
    """
    if not records:
        raise InputError("no record to merge")
    channels = tuple(
        dict.fromkeys(c for modes, _, _ in records for c in modes.channels)
    )
    names = [name for _, _, name in records]
    faults = common_faults([modes for modes, _, _ in records])
    full = [MergeRecord.of(*record, channels) for record in mended(records, faults)]
    glued: list[_GluedMode] = []
    for index in sorted(range(len(full)), key=lambda i: (-len(full[i].modes), i)):
        _join(glued, full[index], index)
    found = [_contributions(full, mode) for mode in glued]
    rank = sorted(range(len(glued)), key=lambda k: found[k][0][0])
    f, std_f, z, std_z = np.array([found[k][0] for k in rank]).reshape(-1, 4).T
    shape = np.empty((len(channels), len(glued)), dtype=np.complex128)
    var = np.empty(shape.shape)
    confidence = np.empty(len(glued))
    for column, k in enumerate(rank):
        mode = glued[k]
        shape[:, column] = mode.shape
        var[:, column] = mode.var
        confidence[column] = max(full[r].modes.confidence[i] for r, i in mode.members)
    top = np.nan_to_num(np.abs(shape)).max(axis=0, initial=0.0)
    top = np.where(top > 0, top, 1.0)
    merged = ModeSet(
        f, z, shape / top, channels, source=" + ".join(names), confidence=confidence
    )
    std = Uncertainty.independent(std_f, std_z, np.sqrt(_of_unit(shape, var)) / top)
    notes = tuple(fault.describe(names) for fault in faults)
    return Merged(merged, std, tuple(found[k][1] for k in rank), notes, faults)


def mended(
    records: Sequence[tuple[ModeSet, Uncertainty, str]], faults: Sequence[CommonFault]
) -> list[tuple[ModeSet, Uncertainty, str]]:
    """The records without the faults."""
    out = list(records)
    for fault in faults:
        modes, std, name = out[fault.record]
        deviations = np.array(std.shape)
        at = [modes.channels.index(c) for c in fault.channels]
        deviations[at] = deviations[at[::-1]]
        out[fault.record] = (
            undone(modes, fault.channels),
            replace(std, shape=deviations),
            name,
        )
    return out


def join_candidates(
    records: Sequence[OtherCandidates], merged: ModeSet
) -> OtherCandidates:
    """The candidates of all records, each once: the most confident of those of one frequency and
    shape, and none that is a merged mode.

    Parameters
    ----------
    records : sequence of OtherCandidates
        Those of a single record stay as they are.
    merged : ModeSet
        Natural modes of all records.

    Returns
    -------
    OtherCandidates
        Rows of the shapes as in `merged`, where it has modes; NaN where a record has no such
        channel.
    """
    if len(records) == 1:
        return records[0]
    channels = merged.channels if len(merged) else ()
    channels = channels or tuple(
        dict.fromkeys(c for r in records for c in r.modes.channels)
    )
    every, std = joined_modes([_widened(r, channels) for r in records])
    classes = [kind for r in records for kind in r.classes]
    notes = [note for r in records for note in r.notes]
    frequency = merged.frequencies.tolist()
    shapes = list(merged.shapes.T) if frequency else []
    kept: list[int] = []
    for k in np.argsort(-every.confidence, kind="stable").tolist():  # a few
        f = float(every.frequencies[k])
        half = max(float(every.damping[k]), LIMITS.spread) * f
        shape = every.shapes[:, k]
        near = [s for g, s in zip(frequency, shapes, strict=True) if abs(g - f) <= half]
        if all(_common_mac(shape, s) <= LIMITS.mac for s in near):
            kept.append(k)
            frequency.append(f)
            shapes.append(shape)
    kept.sort(key=lambda k: float(every.frequencies[k]))
    return OtherCandidates(
        every.take(kept),
        std.take(kept),
        tuple(classes[k] for k in kept),
        tuple(notes[k] for k in kept),
    )


def _widened(
    own: OtherCandidates, channels: Sequence[str]
) -> tuple[ModeSet, Uncertainty]:
    """Candidates with rows as in `channels`, NaN where a row is not among theirs."""
    here = {c: k for k, c in enumerate(own.modes.channels)}
    there = [k for k, c in enumerate(channels) if c in here]
    at = [here[channels[k]] for k in there]
    shapes = np.full((len(channels), len(own)), np.nan, dtype=np.complex128)
    shapes[there] = own.modes.shapes[at]
    deviations = np.full(shapes.shape, np.nan)
    deviations[there] = own.uncertainty.shape[at]
    std = own.uncertainty
    return (
        replace(own.modes, shapes=shapes, labels=tuple(channels), source=""),
        Uncertainty.independent(std.frequency, std.damping, deviations),
    )


def _common_mac(a: Complex, b: Complex) -> float:
    """MAC of two shapes (ch,) on the rows that both have; 0 without two of these."""
    both = np.isfinite(a) & np.isfinite(b)
    return float(mac(a[both, None], b[both, None])[0, 0]) if both.sum() > 1 else 0.0


def _join(glued: list[_GluedMode], record: MergeRecord, index: int) -> None:
    """Join each mode of a record to the one it fits best, each once; the others begin a mode."""
    m = len(record.modes)
    cost = np.array([mode.cost(record) for mode in glued]).reshape(len(glued), m)
    left = set(range(m))
    while cost.size and np.isfinite(cost.min()):
        g, k = (int(x) for x in np.unravel_index(int(np.argmin(cost)), cost.shape))
        glued[g] = glued[g].joined(record, index, k)
        cost[g] = np.inf
        cost[:, k] = np.inf
        left.discard(k)
    for k in sorted(left):
        frequency = float(record.modes.frequencies[k])
        own = _GluedMode(((index, k),), frequency, record.psi[:, k], record.var[:, k])
        glued.append(own)


def _average(x: Float, sd: Float, spread: float) -> tuple[float, float, Bool]:
    """Mean by inverse variance, its standard deviation, and who is an outlier from the median."""
    known = np.isfinite(sd) & (sd > 0)
    largest = np.nanmax(sd) if np.isfinite(sd).any() else max(spread, 1e-12)
    sd = np.where(known, sd, largest)
    distance = np.abs(x - float(np.median(x))) / np.hypot(sd, spread)
    out = (distance > LIMITS.outlier) & (x.size > 2)
    out &= not out.all()  # two groups far from each other
    w = np.where(out, 0.0, 1 / sd**2)
    mean = float(w @ x / w.sum())
    if (~out).sum() < 2:
        return mean, float(np.sqrt(1 / w.sum())), out
    # records that differ by more than they say (temperature, amplitude): variance between them
    # (DerSimonian and Laird 1986), so that the best known one does not stand for all
    excess = float(w @ (x - mean) ** 2) - int((~out).sum()) + 1
    between = max(excess, 0.0) / max(float(w.sum() - (w @ w) / w.sum()), 1e-300)
    w = np.where(out, 0.0, 1 / (sd**2 + between))
    return float(w @ x / w.sum()), float(1 / np.sqrt(w.sum())), out


def _contributions(
    records: Sequence[MergeRecord], mode: _GluedMode
) -> tuple[tuple[float, float, float, float], tuple[Contribution, ...]]:
    """Merged frequency, std, damping, std; and what each record gave."""
    parts = [(records[r], k) for r, k in mode.members]
    f = np.array([x.modes.frequencies[k] for x, k in parts])
    z = np.array([x.modes.damping[k] for x, k in parts])
    sf = np.array([x.std.frequency[k] for x, k in parts])
    sz = np.array([x.std.damping[k] for x, k in parts])
    mf, df, out = _average(f, sf, LIMITS.spread * mode.frequency)
    mz, dz, _ = _average(z[~out], sz[~out], 0.0)
    gave = []
    for (r, k), fk, zk, outlier in zip(mode.members, f, z, out, strict=True):
        why = f"{100 * (fk / mf - 1):+.2f} % in frequency, {100 * (zk / mz - 1):+.0f} % in damping"
        if outlier:
            why += ": outlier"
        given = Contribution(
            record=records[r].name, position=r, mode=k, outlier=bool(outlier), why=why
        )
        gave.append(given)
    return (mf, df, mz, dz), tuple(gave)


def _of_unit(shape: Complex, var: Float) -> Float:
    """Variances (ch, m) of shapes (ch, m) whose largest component is to be the unit: those of this
    one are theirs.
    """
    if not shape.size:
        return var
    size = np.nan_to_num(np.abs(shape))
    at = (size.argmax(axis=0), np.arange(size.shape[1]))
    out = var + (size / np.maximum(size[at], 1e-300)) ** 2 * var[at]
    out[at] = (LIMITS.exact * size[at]) ** 2
    return np.asarray(out)
