"""Sets of FRFs: joined over setups and references, exchanged by reciprocity, checked at driving
points and against other setups.

A channel that stays in place over several setups measures the same FRFs in each. Where one setup
has them times a real factor at all lines and of all inputs, its gain, unit or cable was another
there.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.channels import LINEAR, OF_KIND, POWER, as_motion, channel
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, FrfKind, FrfSet, join_impacts, shared_lines
from ringtrue.errors import DataError

log = logging.getLogger(__name__)
_SAME_END = 2e-3  # of the block, by which pulses of other width move its end
MOTION = ("acceleration", "velocity", "displacement", "unknown")
_BANDS = 24


def join_by_setup(columns: Sequence[FrfSet]) -> tuple[FrfSet, ...]:
    """Those with the same responses joined: a set for each place that the sensors had."""
    same: dict[tuple[str, ...], list[FrfSet]] = {}
    for f in columns:
        same.setdefault(tuple(c.id for c in f.outputs), []).append(f)
    return tuple(join_frfs(some) for some in same.values())


def join_frfs(parts: Sequence[FrfSet]) -> FrfSet:
    """One set from several: roving responses (setups) and roving hammers.

    A pair of response and input that was measured several times is averaged, weighted by the number
    of hits.

    Raises
    ------
    DataError
        As `of_one_kind` does, or if a pair of response and input was never measured.
    """
    parts = of_one_kind(parts)
    first = parts[0]
    kept = np.array([p.kept for p in parts])
    same = bool(np.isfinite(kept).all()) and np.ptp(kept) < _SAME_END * kept.mean()
    outputs = {c.id: c for p in parts for c in p.outputs}
    inputs = {c.id: c for p in parts for c in p.inputs}
    row = {k: i for i, k in enumerate(outputs)}
    column = {k: i for i, k in enumerate(inputs)}
    shape = (first.freqs.size, len(outputs), len(inputs))
    data = np.zeros(shape, dtype=np.complex128)
    weight = np.zeros(shape[1:])
    coherence = np.zeros(shape)
    impacts = []
    for p in parts:  # a few setups
        at = (
            np.array([row[c.id] for c in p.outputs])[:, None],
            np.array([column[c.id] for c in p.inputs]),
        )
        n = np.broadcast_to(
            np.where(np.isfinite(p.averages), p.averages, 1.0),
            (len(p.outputs), len(p.inputs)),
        )
        data[:, at[0], at[1]] += p.data * n
        coherence[:, at[0], at[1]] += p.coherence * n
        weight[at] += n
        if p.impacts:
            impacts.append(np.zeros((len(p.impacts.weight), *shape[1:])))
            impacts[-1][:, at[0], at[1]] = p.impacts.weight * n
    if (weight == 0).any():
        o, i = np.argwhere(weight == 0)[0]
        raise DataError(
            f"no FRF from {list(inputs)[i]} to {list(outputs)[o]}: {int((weight == 0).sum())} "
            "pairs were not measured"
        )
    return replace(
        first,
        data=data / weight,
        outputs=tuple(outputs.values()),
        inputs=tuple(inputs.values()),
        coherence=coherence / weight,
        averages=np.median(weight, axis=0),
        kept=float(kept.mean()) if same else np.inf,
        sharp=all(p.sharp for p in parts),
        impacts=join_impacts([p.impacts for p in parts], [b / weight for b in impacts]),
        source=", ".join(dict.fromkeys(p.source for p in parts if p.source)),
    )


def of_one_kind(parts: Sequence[FrfSet]) -> tuple[FrfSet, ...]:
    """Sets on the lines that all of them have, all of the kind of the first.

    Raises
    ------
    DataError
        If there is none, they share no more than half of the lines of the shortest, or windows
        differ.
    """
    if not parts:
        raise DataError("no FRFs to join")
    first = parts[0]
    for p in parts[1:]:
        if abs(p.window_decay - first.window_decay) > 1e-9:
            raise DataError(
                f"{p.source}: window of {p.window_decay:g} 1/s, {first.source} "
                f"{first.window_decay:g} 1/s"
            )
    at = shared_lines([p.freqs for p in parts])
    if at is None:
        described = ", ".join(
            f"{p.source} {_axis(p.freqs)}"
            for p in parts
            if not np.array_equal(p.freqs, first.freqs)
        )
        raise DataError(
            f"{described}: other frequency lines than {first.source}, {_axis(first.freqs)}"
        )
    if lost := max(p.freqs.size - a.size for p, a in zip(parts, at, strict=True)):
        described = _axis(first.freqs[at[0]])
        log.warning(
            "%s: frequency lines differ (%d at most); the shared ones are used, %s",
            first.source,
            lost,
            described,
        )
    return tuple(_part(p, a, first.kind) for p, a in zip(parts, at, strict=True))


def _axis(freqs: Float) -> str:
    return f"{freqs.size} of {freqs[0]:g} to {freqs[-1]:g} Hz"


def _part(p: FrfSet, at: Int, kind: FrfKind) -> FrfSet:
    """The FRFs at some lines, as those of a kind."""
    if p.kind == kind and at.size == p.freqs.size:
        return p
    motion = OF_KIND[p.kind]
    wanted = OF_KIND[kind]
    data = as_motion(p.data[at], p.freqs[at], motion, wanted, p.window_decay)
    outputs = tuple(replace(channel(c.id, wanted), sensor=c.sensor) for c in p.outputs)
    return replace(
        p,
        data=data,
        freqs=p.freqs[at],
        coherence=p.coherence[at],
        outputs=outputs,
        kind=kind,
    )


def exchange_by_reciprocity(frfs: FrfSet) -> tuple[FrfSet, str]:
    """FRFs with the responses at the many points of a roving hammer, and a note; as they are where
    they are not such.

    Parameters
    ----------
    frfs : FrfSet
        Exchanged if there are more inputs than outputs, and the outputs are motions of one kind.
    """
    kinds = {LINEAR.get(c.quantity, c.quantity) for c in frfs.outputs}
    if (
        len(frfs.inputs) <= len(frfs.outputs)
        or len(kinds) != 1
        or not kinds <= set(MOTION)
    ):
        return frfs, ""
    quantity = kinds.pop()
    unit = frfs.outputs[0].unit
    there = replace(
        frfs,
        data=frfs.data.swapaxes(1, 2),
        outputs=tuple(
            Channel(c.id, quantity, unit)
            if quantity == "unknown"
            else channel(c.id, quantity)
            for c in frfs.inputs
        ),
        inputs=tuple(channel(c.id, "force") for c in frfs.outputs),
        coherence=frfs.coherence.swapaxes(1, 2),
        averages=np.full(len(frfs.outputs), np.min(frfs.averages)),
        impacts=frfs.impacts.exchanged() if frfs.impacts else None,
    )
    return there, (
        f"roving hammer: {len(frfs.inputs)} points struck, {len(frfs.outputs)} fixed sensors; by "
        "reciprocity the "
        "shapes are at the points struck"
    )


def mobility(frfs: FrfSet) -> Complex:
    """(freq, out, in) velocity over force, m/s/N; 0 at 0 Hz."""
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    factor = np.where(frfs.freqs > 0, s, 1.0) ** float(1 - POWER[frfs.kind])
    return np.asarray(frfs.data * np.where(frfs.freqs > 0, factor, 0.0)[:, None, None])


def passive(
    frfs: FrfSet, output: int, reference: int, *, low: float = 0.0, high: float = np.inf
) -> float:
    """Share of the real part of a driving point's mobility in its size at resonances, -1 to 1,
    `low` to `high` Hz.

    Taken in bands of as many lines, each of which counts as far as it has a peak and a sign. A
    drift at the lowest lines, which no weight by size would survive, is one band of many; and of
    lines between resonances, where mobility is all but imaginary, a delay of a sample or less makes
    what sign it likes.
    """
    use = (frfs.freqs > max(low, 0.0)) & (frfs.freqs <= high)
    bands = np.array_split(
        mobility(frfs)[use, output, reference], min(_BANDS, int(use.sum()) or 1)
    )
    share, peak = np.transpose([_sign_and_peak(h) for h in bands])
    weight = np.abs(share) * peak
    return float((share * weight).sum() / max(weight.sum(), 1e-300))


def _sign_and_peak(h: Complex) -> tuple[float, float]:
    """Share of the real part of lines in its size, and how far the largest lines stand out, 0 to
    1.
    """
    size = np.abs(h)
    power = max(float((size**2).sum()), 1e-300)
    share = (h.real * size).sum() / max((np.abs(h.real) * size).sum(), 1e-300)
    return float(share), float(1 - size.sum() ** 2 / max(size.size, 1) / power)


@dataclass(frozen=True, slots=True)
class SetupGainLimits:
    """When a factor is a fault.

    Attributes
    ----------
    spread : float
        Distance from 1 in robust standard deviations of all factors of the test (logarithms).
    ratio : float
        Smallest factor, its inverse below 1: what calibrations, added masses and other temperatures
        make is smaller.
    coherent : float
        Least share of the FRFs of both setups that one factor explains.
    """

    spread: float = 6.0
    ratio: float = 1.1
    coherent: float = 0.9


LIMITS = SetupGainLimits()


@dataclass(frozen=True, slots=True)
class SetupGain:
    """A channel that reads otherwise in one setup.

    Attributes
    ----------
    channel : str
    setup : int
        Position.
    factor : float
        What it reads there over what it reads in the others; negative: with the opposite sign.
    others : int
        Setups that it is compared with.
    """

    channel: str
    setup: int
    factor: float
    others: int

    def note(self, setup: str) -> Note:
        """What is to be said of it; `setup` is the name of the setup."""
        values: dict[str, float | int | str] = {
            "setup": setup,
            "factor": self.factor,
            "others": self.others,
        }
        return Note("channel gain", "warning", self.channel, values)


def with_equal_gains(
    columns: Sequence[FrfSet],
) -> tuple[list[FrfSet], tuple[FrfSet, ...], tuple[SetupGain, ...]]:
    """Columns of FRFs without the gains that a channel has in one setup only, the same joined by
    setup, and these gains.
    """
    setups = join_by_setup(columns)
    gains = setup_gains(setups)
    mended = [without_gains(c, gains, setups) for c in columns]
    return mended, join_by_setup(mended) if gains else setups, gains


def setup_gains(
    setups: Sequence[FrfSet], limits: SetupGainLimits = LIMITS
) -> tuple[SetupGain, ...]:
    """Channels with another factor in one setup than in two or more others, which agree.

    Parameters
    ----------
    setups : sequence of FrfSet
        One a setup, of one kind and on the same lines.

    Notes
    -----
    A channel in two setups only says that they differ, not which is right; it is not named.
    """
    found = []
    levels = []
    for name in dict.fromkeys(c.id for s in setups for c in s.outputs):
        here = [k for k, s in enumerate(setups) if name in (c.id for c in s.outputs)]
        if len(here) < 3:
            continue
        factor, share = _factors([setups[k] for k in here], name)
        usable = np.isfinite(factor) & (np.abs(factor) > 0)
        levels += np.log(np.abs(factor[usable])).tolist()
        found += [
            SetupGain(name, here[k], float(factor[k]), len(here) - 1)
            for k in np.flatnonzero(usable & (share >= limits.coherent)).tolist()
        ]
    if not found:
        return ()
    spread = 1.4826 * float(np.median(np.abs(levels)))
    least = max(limits.spread * spread, float(np.log(limits.ratio)))
    return tuple(g for g in found if g.factor < 0 or abs(np.log(g.factor)) > least)


def _factors(setups: Sequence[FrfSet], channel: str) -> tuple[Float, Float]:
    """(k,) factor of each setup over the median of the others, and share of its FRFs that it
    explains.
    """
    common = [
        i.id for i in setups[0].inputs if all(i.id in _ids(s.inputs) for s in setups)
    ]
    if not common:
        return np.full(len(setups), np.nan), np.zeros(len(setups))
    readings = []
    for s in setups:
        row = _ids(s.outputs).index(channel)
        columns = [_ids(s.inputs).index(i) for i in common]
        readings.append(s.data[:, row, columns].ravel())
    rows = np.array(readings)  # (k, line·input)
    product = (rows.conj() @ rows.T).real
    power = np.maximum(np.diag(product), 1e-300)
    ratio = product / power[:, None]  # what column reads over what row reads
    np.fill_diagonal(ratio, np.nan)
    like = np.abs(product) / np.sqrt(power[:, None] * power)
    np.fill_diagonal(like, np.nan)
    return np.asarray(np.nanmedian(ratio, axis=0)), np.asarray(
        np.nanmedian(like, axis=0)
    )


def _ids(channels: Sequence[Channel]) -> list[str]:
    return [c.id for c in channels]


def without_gains(
    frfs: FrfSet, gains: Sequence[SetupGain], setups: Sequence[FrfSet]
) -> FrfSet:
    """FRFs of one of the setups with the factors of its channels taken out."""
    mine = [_ids(s.outputs) == _ids(frfs.outputs) for s in setups].index(True)
    factor = {g.channel: g.factor for g in gains if g.setup == mine}
    if not factor:
        return frfs
    rows = np.array([factor.get(c.id, 1.0) for c in frfs.outputs])
    return replace(frfs, data=frfs.data / rows[:, None])
