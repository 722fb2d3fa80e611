"""The test modes that the model is judged by, and which of them the updating must not see."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty, rigid_below
from ringtrue.correlation.assignment import NO_LOCKS, Followed, Locks, PairingSettings
from ringtrue.correlation.pairing import Pairing, pair_modes
from ringtrue.correlation.table import CorrelationTable, correlation_table
from ringtrue.errors import ConfigError, DataError
from ringtrue.io.modes import read_modes, read_std
from ringtrue.shapes import realise_modes
from ringtrue.study.config import StudyConfig
from ringtrue.study.results import IdentifiedModes, IdentifyStage, ReferenceModes

ABOVE = 1.2  # modes of the deck should be known up to here over the highest test mode


def elastic_edge(frequencies: Float, config: StudyConfig) -> float:
    """Between rigid-body and elastic modes, Hz.

    As stated in the study; else the geometric middle of the widest gap where the study names a
    suspension. A structure without one is held or free: it has no rigid-body modes but those at
    0 Hz (to round-off, 1e-3 of the highest frequency).
    """
    below = config.correlate.rigid_below
    if below is not None:
        return below
    if not config.suspension:
        return rigid_below(frequencies)
    f = np.sort(frequencies[frequencies > 0])
    if f.size < 2:
        return 0.0
    i = int(np.argmax(f[1:] / f[:-1]))
    return float(np.sqrt(f[i] * f[i + 1]))


def measured_part(modes: ModeSet) -> tuple[Int, tuple[str, ...]]:
    """Positions of the modes, and the channels, of the largest part of the shapes that has no gap.

    Records of other sensors leave gaps where one of them does not show a mode. Modes seen at fewer
    than half of the channels go first; then, as long as modes times common channels grows, those
    that were seen at the same channels.
    """
    known = np.isfinite(modes.shapes)
    at = (
        np.flatnonzero(known.mean(axis=0) >= 0.5)
        if known.size
        else np.arange(len(modes), dtype=np.int64)
    )
    size = at.size * known[:, at].all(axis=1).sum()
    while at.size > 1:
        _, kind = np.unique(known[:, at], axis=1, return_inverse=True)
        trials = [at[kind.ravel() != k] for k in range(int(kind.max()) + 1)]
        worth = [
            t.size * known[:, t].all(axis=1).sum() if t.size else 0 for t in trials
        ]
        if max(worth) <= size:
            break
        at = trials[int(np.argmax(worth))]
        size = max(worth)
    full = known[:, at].all(axis=1)  # all of them where there is no mode
    return at, tuple(modes.channels[i] for i in np.flatnonzero(full).tolist())


def at_common(modes: ModeSet) -> tuple[ModeSet, tuple[str, ...]]:
    """The modes at the channels of `measured_part`, with zeros for those that it leaves out, and
    what is not used.

    They keep their numbers; a mode of zeros looks like no other and finds no partner.
    """
    if np.isfinite(modes.shapes).all():
        return modes, ()
    at, channels = measured_part(modes)
    seen = modes.rows(channels)
    kept = np.isin(np.arange(len(modes)), at)
    return replace(seen, shapes=np.where(kept, np.nan_to_num(seen.shapes), 0.0)), _gaps(
        modes
    )


def _gaps(modes: ModeSet) -> tuple[str, ...]:
    """What `measured_part` leaves out, in words."""
    at, channels = measured_part(modes)
    lost = np.setdiff1d(np.arange(len(modes)), at)
    seen = np.isfinite(modes.shapes).sum(axis=0)
    n = len(modes.channels)
    out = []
    for k in np.unique(seen[lost]).tolist():
        which = ", ".join(
            f"{f:.4g}" for f in modes.frequencies[lost[seen[lost] == k]].tolist()
        )
        out.append(f"{which} Hz: not used, seen at {k} of {n} channels only")
    if len(channels) < n:
        names = [c for c in modes.channels if c not in set(channels)]
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        out.append(
            f"channels not used, where not all modes were seen: {' '.join(names[:8])}{more}"
        )
    return tuple(out)


def reference_modes(found: IdentifyStage, config: StudyConfig) -> ReferenceModes:
    """Pick the reference modes: elastic ones of the hammer test or the file, rigid-body ones of the
    ambient tests; of the other kind of test where one gives none.

    Raises
    ------
    DataError
        If the test holds no elastic mode.
    """
    ambient = found.ambient
    first = ambient if found.hammer is None else found.hammer
    every = ambient.modes.frequencies
    if found.hammer is not None:
        every = np.concatenate([every, found.hammer.modes.frequencies])
    edge = elastic_edge(every, config)
    least = config.identify.confidence
    rigid, rigid_std = _rigid(ambient, edge, least)
    if not len(rigid):
        rigid, rigid_std = _rigid(first, edge, least)
    high = np.flatnonzero(first.modes.frequencies >= edge)
    seen, std = without_gaps(first, high)
    elastic = realise_modes(seen)
    gaps = found.frf_notes if config.frequency_only else _gaps(first.modes.take(high))
    if not len(elastic):
        raise DataError("the test holds no elastic mode: nothing to correlate with")
    out = left_out(elastic, config.update.left_out, least)
    return ReferenceModes(
        elastic=elastic,
        elastic_std=std,
        rigid=rigid,
        rigid_std=rigid_std,
        left_out=out,
        gaps=gaps,
    )


def without_gaps(found: IdentifiedModes, some: Int) -> tuple[ModeSet, Uncertainty]:
    """Those of some modes that were seen at common channels, at these (`measured_part`), and their
    scatter.
    """
    at, channels = measured_part(found.modes.take(some))
    return found.modes.take(some[at]).rows(channels), found.uncertainty.take(some[at])


def _rigid(
    found: IdentifiedModes, edge: float, least: float
) -> tuple[ModeSet, Uncertainty]:
    """The confident modes below the edge, at the channels that have seen them all."""
    modes = found.modes
    low = np.flatnonzero((modes.frequencies < edge) & (modes.confidence >= least))
    if not low.size:
        return modes.take(low), found.uncertainty.take(low)
    seen, scatter = without_gaps(found, low)
    return realise_modes(seen), scatter


def reference_of_file(path: Path, config: StudyConfig) -> ReferenceModes:
    """The same from a file of modes.

    Raises
    ------
    DataError
        If it holds no elastic mode that was measured at a common set of channels.
    """
    whole = read_modes(path)
    spread, damping = read_std(path)
    at, channels = measured_part(whole)
    modes = whole.take(at).rows(channels)
    std = Uncertainty.independent(spread[at], damping[at], np.zeros(modes.shapes.shape))
    edge = elastic_edge(modes.frequencies, config)
    high = np.flatnonzero(modes.frequencies >= edge)
    low = np.flatnonzero(modes.frequencies < edge)
    if not high.size or not modes.channels:
        raise DataError(
            f"{path}: no elastic mode was measured at a common set of channels"
        )
    rigid = realise_modes(modes.take(low)) if low.size else modes.take(low)
    elastic = realise_modes(modes.take(high))
    out = left_out(elastic, config.update.left_out, config.identify.confidence)
    return ReferenceModes(elastic, std.take(high), rigid, std.take(low), out)


def beyond(modes: ModeSet, fmax: float) -> tuple[str, ...]:
    """A note where the modes of the deck end too low for the test: partners above `fmax`, Hz,
    cannot be found.
    """
    top = float(modes.frequencies.max(initial=0.0))
    if ABOVE * top <= fmax:
        return ()
    over = int((modes.frequencies > fmax).sum())
    more = f", {over} of them above it" if over else ""
    return (
        f"the modes of the deck are computed to {fmax:g} Hz, the test modes reach {top:.4g} "
        f"Hz{more}: a test mode may "
        f"be paired wrongly for want of its partner. Set [model] fmax to {ABOVE * top:.3g} or "
        "more, or end the band of "
        "the test ([identify] hammer_fmax, ambient_fmax) lower",
    )


def left_out(modes: ModeSet, count: int | None, least: float) -> Int:
    """Positions of the modes kept from the updating: confident ones, evenly spread over the band.

    Fixed by the test alone, before the model is looked at. Where no `count` is given a third, 5 at
    most: few modes are needed to update by.
    """
    confident = np.flatnonzero(modes.confidence >= least)
    count = min(5, confident.size // 3) if count is None else count
    count = min(count, max(confident.size - 2, 0))
    if not count:
        return np.zeros(0, dtype=np.int64)
    at = np.linspace(0, confident.size - 1, count + 2)[1:-1].round().astype(np.int64)
    return confident[np.unique(at)]


def fewer(count: int | None, out: Int) -> tuple[str, ...]:
    """That not as many modes are left out as asked for, in words."""
    if count is None or out.size >= count:
        return ()
    return (
        f"update.left_out = {count}: {out.size} modes are left out, so that the updating keeps "
        "two confident ones",
    )


def used_mask(n: int, out: Int) -> Bool:
    """True for the modes that the updating may see, (n,)."""
    return ~np.isin(np.arange(n), out)


def settings(config: StudyConfig) -> PairingSettings:
    """The gates of the study."""
    return config.correlate.gates(config.identify.confidence)


def highest(frequencies: Float, gates: PairingSettings) -> float:
    """Hz, up to where modes of a deck are computed for test modes at `frequencies`, Hz: as high as
    a partner may be.
    """
    # 1.5: over the highest test mode: where its partner may be before the updating
    return max(1.5, 1 + gates.frequency_gate) * float(frequencies.max(initial=0.0))


def locks(config: StudyConfig) -> Locks:
    """The pairs that the user decides."""
    return Locks(positions(config.correlate.lock), positions(config.correlate.forbid))


def rigid_settings(config: StudyConfig) -> PairingSettings:
    """Gates for rigid-body modes: neighbours on soft springs turn into each other, so they are one
    subspace.
    """
    return replace(
        settings(config),
        mac_gate=min(0.5, config.correlate.mac_gate),
        close=0.08,
        distinct=0.95,
    )


def positions(pairs: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Pairs such as 3:7, modes from one, as positions from zero.

    Raises
    ------
    ConfigError
        If one is not of this form.
    """
    found = [(re.fullmatch(r"([1-9]\d*):([1-9]\d*)", pair), pair) for pair in pairs]
    if wrong := [pair for match, pair in found if match is None]:
        raise ConfigError(
            f"{wrong[0]!r} is no pair of a test mode and a mode of the deck, from 1, such as '3:7'"
        )
    return tuple((int(m[1]) - 1, int(m[2]) - 1) for m, _ in found if m)


def followed(
    reference: ModeSet, initial: ModeSet, config: StudyConfig
) -> Followed | None:
    """The pairs that the study decides, by the shapes of the initial deck at the channels of the
    test modes.

    Raises
    ------
    ConfigError
        If there is no such mode.
    """
    c = config.correlate
    if not (c.lock or c.forbid):
        return None
    shapes = np.asarray(initial.rows(reference.channels).shapes.real, dtype=np.float64)
    sides = []
    for name, pairs in (("lock", positions(c.lock)), ("forbid", positions(c.forbid))):
        for t, j in pairs:
            if t >= len(reference) or j >= shapes.shape[1]:
                n = (
                    f"{len(reference)} elastic test modes and {shapes.shape[1]} of the deck "
                    "below fmax"
                )
                raise ConfigError(f"correlate.{name} {t + 1}:{j + 1}: there are {n}")
        sides.append((tuple(t for t, _ in pairs), shapes[:, [j for _, j in pairs]]))
    return Followed(*sides[0], *sides[1])


def elastic_table(
    reference: ReferenceModes,
    fe: ModeSet,
    config: StudyConfig,
    initial: ModeSet | None = None,
) -> CorrelationTable:
    """Elastic test modes against the model's elastic modes at the channels; `initial` are those
    that locks name.
    """
    test = reference.elastic
    first = 0
    if len(reference.rigid) or config.correlate.rigid_below:
        first = int((fe.frequencies < elastic_edge(fe.frequencies, config)).sum())
    elastic = fe.take(np.arange(first, len(fe)))
    known = followed(test, initial, config) if initial is not None else None
    locks = (
        NO_LOCKS if known is None else known.locks(elastic.rows(test.channels).shapes)
    )
    pairing = pair_modes(test, elastic, settings(config), first_b=first, locks=locks)
    std = reference.elastic_std.frequency
    table = correlation_table(
        test, elastic, pairing, std_hz=std, left_out=reference.left_out
    )
    mac = np.concatenate([np.zeros((len(test), first)), table.mac], axis=1)
    if config.frequency_only:
        pairing = _unseen(pairing)
        mac = np.zeros((0, 0))
    return replace(
        table,
        pairing=replace(
            pairing, b=pairing.b + first, unpaired_b=pairing.unpaired_b + first
        ),
        mac=mac,
        all_fe_hz=fe.frequencies,
    )


def _unseen(pairing: Pairing) -> Pairing:
    """A pairing by shapes of the deck as it came, which say nothing of it."""
    return replace(
        pairing,
        mac=np.full(len(pairing), np.nan),
        subspace=np.zeros(len(pairing), dtype=np.bool_),
        reasons_a=("no mode is like the one that it was taken for",)
        * pairing.unpaired_a.size,
        reasons_b=("no frequency of the test is taken for it",)
        * pairing.unpaired_b.size,
        gated_a=np.zeros(pairing.unpaired_a.size, dtype=np.bool_),
    )


def rigid_table(
    reference: ReferenceModes, fe: ModeSet, config: StudyConfig
) -> CorrelationTable:
    """Rigid-body test modes against the model's."""
    gates = rigid_settings(config)
    edge = elastic_edge(fe.frequencies, config)
    low = fe.take(np.flatnonzero(fe.frequencies < edge))
    pairing = pair_modes(reference.rigid, low, gates)
    return correlation_table(
        reference.rigid, low, pairing, std_hz=reference.rigid_std.frequency
    )
