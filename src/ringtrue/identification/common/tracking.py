"""Modes followed from stretch to stretch of a long record, and over the levels of a force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc

from ringtrue.core.arrays import Bool, Complex, Float, FrozenArrays, Int, freeze_fields
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import DataError, InputError
from ringtrue.shapes import mac


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """The modes of one stretch; `time` is its middle, h."""

    time: float
    modes: ModeSet
    uncertainty: Uncertainty


@dataclass(frozen=True, slots=True)
class TrackLimits:
    """How modes of successive stretches are matched.

    Attributes
    ----------
    step : float
        Relative change of frequency from one stretch to the next that may be; over n times the
        usual time sqrt(n) of it, three times at most, and twice as much where the MAC is above
        `plain`. Four standard deviations may always be.
    mac : float
        Smallest MAC with the shape followed, on the common channels.
    plain : float
        MAC that leaves no doubt.
    parts : float
        MAC of the mean shapes of two parts of one mode.
    memory : float
        Weight of a new shape in the shape followed: it may turn slowly, as it does where two modes
        veer.
    least : int
        Stretches that make a mode; rarer ones are listed as rare.
    chance : float
        Of a row of stretches without a mode, below which it has come or gone.
    """

    step: float = 0.02
    mac: float = 0.6
    plain: float = 0.95
    parts: float = 0.9
    memory: float = 0.3
    least: int = 3
    chance: float = 0.01


LIMITS = TrackLimits()


@dataclass(frozen=True, slots=True, eq=False)
class ModeTrack:
    """One mode through time.

    Attributes
    ----------
    name : str
        `1`, `2`, ... by its first stretch, then by frequency.
    at : (n,) int64
        Stretches that show it, ascending.
    mode : (n,) int64
        Its position among the modes of each.
    frequency, std_frequency : (n,) float64, Hz
    damping, std_damping : (n,) float64
    confidence : (n,) float64
    shape : (channel,) complex128
        Mean of all stretches, length 1.
    mac : (n,) float64
        Of each stretch with the mean shape.
    """

    name: str
    at: Int
    mode: Int
    frequency: Float
    std_frequency: Float
    damping: Float
    std_damping: Float
    confidence: Float
    shape: Complex
    mac: Float

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(
            self,
            at=np.int64,
            mode=np.int64,
            frequency=f,
            std_frequency=f,
            damping=f,
            std_damping=f,
        )
        freeze_fields(self, confidence=f, shape=np.complex128, mac=f)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked(FrozenArrays):
    """Modes of a long record through time.

    Attributes
    ----------
    times : (k,) float64, h
        Middle of each stretch.
    channels : tuple of str
        Rows of the shapes.
    tracks : tuple of ModeTrack
    rare : tuple of ModeTrack
        Seen in fewer stretches than make a mode; without a name.
    """

    times: Float
    channels: tuple[str, ...]
    tracks: tuple[ModeTrack, ...]
    rare: tuple[ModeTrack, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Thread:
    """A mode while it is followed: its members (stretch, mode), the frequency and the shape looked
    for.
    """

    members: tuple[tuple[int, int], ...]
    frequency: float
    shape: Complex

    def joined(
        self, member: tuple[int, int], frequency: float, psi: Complex
    ) -> _Thread:
        """With one more member; the shape turns towards it, the frequency is the newest."""
        on = np.isfinite(psi)
        known = on & np.isfinite(self.shape)
        turn = complex(self.shape[known].conj() @ psi[known])
        new = psi * (turn.conjugate() / abs(turn) if turn else 1.0)
        mixed = (1 - LIMITS.memory) * self.shape + LIMITS.memory * new
        shape = np.where(on, np.where(known, mixed, new), self.shape)
        return _Thread((*self.members, member), frequency, shape)


def track_modes(stretches: Sequence[Stretch]) -> Tracked:
    """Follow all modes through the stretches; a mode may be missing in any of them.

    Each stretch is assigned at once to the modes known so far, at the least sum of 1 - MAC and
    squared change of frequency (Hungarian method); what is left over begins a mode. Where
    frequencies cross, the shapes decide. Parts of one mode that were not seen to belong together
    are joined afterwards.

    Parameters
    ----------
    stretches : sequence of Stretch
        Ascending in time; stretches may have different channels, but must share some.

    Raises
    ------
    DataError
        Without stretches, or if they do not ascend.
    """
    if not stretches:
        raise DataError("no stretch to follow modes through")
    times = np.array([x.time for x in stretches])
    if not (np.diff(times) > 0).all():
        raise DataError(
            f"the stretches must ascend in time; got {times[:8].tolist()} h"
        )
    channels = tuple(dict.fromkeys(c for x in stretches for c in x.modes.channels))
    shapes = [_on_all(x.modes, channels) for x in stretches]
    clock = ticks(times)
    threads: list[_Thread] = []
    for k, stretch in enumerate(stretches):
        gap = np.array([clock[k] - clock[t.members[-1][0]] for t in threads])
        last = [
            stretches[i].uncertainty.frequency[j]
            for i, j in (t.members[-1] for t in threads)
        ]
        cost = _cost(threads, stretch, shapes[k], gap, _finite(np.array(last)))
        left = set(range(len(stretch.modes)))
        rows, columns = linear_sum_assignment(cost)
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
            if cost[i, j] < NEVER:
                f = float(stretch.modes.frequencies[j])
                threads[i] = threads[i].joined((k, j), f, shapes[k][:, j])
                left.discard(j)
        for j in sorted(left):
            f = float(stretch.modes.frequencies[j])
            threads.append(_Thread(((k, j),), f, shapes[k][:, j]))
    tracks = [_track(t.members, stretches, shapes) for t in threads]
    tracks = _with_parts_joined(tracks, stretches, shapes, clock)
    tracks.sort(key=lambda t: (int(t.at[0]), float(t.frequency[0])))
    least = min(LIMITS.least, len(stretches))
    known = [t for t in tracks if t.at.size >= least]
    rare = tuple(t for t in tracks if t.at.size < least)
    named = tuple(replace(t, name=str(i + 1)) for i, t in enumerate(known))
    return Tracked(times, channels, named, rare)


def ticks(times: Float) -> Float:
    """Times (k,) in units of their usual distance: a stretch that is not there leaves a gap."""
    return (
        times / float(np.median(np.diff(times)))
        if times.size > 1
        else np.zeros(times.size)
    )


def _on_all(modes: ModeSet, channels: tuple[str, ...]) -> Complex:
    """Shapes (channel, m) of length 1 on all channels, NaN where a stretch has none."""
    at = {c: i for i, c in enumerate(modes.channels)}
    rows = np.array([at.get(c, -1) for c in channels], dtype=np.int64)
    if not len(modes):
        return np.full((len(channels), 0), np.nan, dtype=np.complex128)
    psi = np.where(
        rows[:, None] >= 0, np.asarray(modes.shapes, dtype=np.complex128)[rows], np.nan
    )
    size = np.sqrt(np.where(np.isfinite(psi), np.abs(psi) ** 2, 0.0).sum(axis=0))
    return np.asarray(psi / np.maximum(size, 1e-300))


def common_mac(a: Complex, b: Complex) -> Float:
    """MAC (a, b) of shapes on their common channels; 1 with fewer than two, where shapes say
    nothing.

    Parameters
    ----------
    a : (channel, a) complex128
    b : (channel, b) complex128
        NaN where a channel is missing.
    """
    out = np.ones((a.shape[1], b.shape[1]))
    on = np.isfinite(b).all(axis=1) if b.shape[1] else np.zeros(b.shape[0], dtype=bool)
    for i in range(a.shape[1]):  # modes may have been seen by different channels
        both = on & np.isfinite(a[:, i])
        if both.sum() > 1:
            out[i] = mac(a[both, i, None], b[both])[0]
    return out


NEVER = 1e6


def _cost(
    threads: list[_Thread], stretch: Stretch, psi: Complex, gap: Float, last: Float
) -> Float:
    """(thread, mode) cost of joining modes of one more stretch, `NEVER` where they may not be.

    `gap` (thread,) is the time since the last member, and `last` its deviation.
    """
    f = stretch.modes.frequencies
    if not threads or not f.size:
        return np.full((len(threads), f.size), NEVER)
    known = np.array([t.frequency for t in threads])[:, None]
    like = common_mac(np.stack([t.shape for t in threads], axis=1), psi)
    spread = np.hypot(last[:, None], _finite(stretch.uncertainty.frequency))
    reach = _reach(known, gap[:, None], like, spread)
    df = np.abs(f - known)
    may_be = (df <= reach) & (like >= LIMITS.mac)
    return np.where(may_be, 1 - like + 0.5 * (df / reach) ** 2, NEVER)


def _reach(frequency: Float, gap: Float, like: Float, spread: Float) -> Float:
    """Change of frequency that may be over a gap in time, Hz."""
    step = LIMITS.step * np.clip(np.sqrt(gap), 1, 3) * frequency
    return np.maximum(np.where(like > LIMITS.plain, 2.0, 1.0) * step, 4 * spread)


def _finite(x: Float) -> Float:
    return np.where(np.isfinite(x), x, 0.0)


def _with_parts_joined(
    tracks: list[ModeTrack],
    stretches: Sequence[Stretch],
    shapes: Sequence[Complex],
    clock: Float,
) -> list[ModeTrack]:
    """Tracks that never occur in one stretch together, and agree where they come next to each
    other, made one.
    """
    tracks = list(tracks)
    i = 0
    while i < len(tracks):
        later = range(i + 1, len(tracks))
        part = next((j for j in later if _one(tracks[i], tracks[j], clock)), None)
        if part is None:
            i += 1
            continue
        members = sorted((*_members(tracks[i]), *_members(tracks[part])))
        tracks[i] = _track(tuple(members), stretches, shapes)
        del tracks[part]
        i = 0
    return tracks


def _members(t: ModeTrack) -> tuple[tuple[int, int], ...]:
    return tuple(zip(t.at.tolist(), t.mode.tolist(), strict=True))


def _one(a: ModeTrack, b: ModeTrack, clock: Float) -> bool:
    """Whether two tracks are parts of one mode."""
    like = common_mac(a.shape[:, None], b.shape[:, None])[0, 0]
    if np.intersect1d(a.at, b.at).size or like < LIMITS.parts:
        return False
    gap = np.abs(clock[a.at][:, None] - clock[b.at])
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    spread = np.hypot(_finite(a.std_frequency)[i], _finite(b.std_frequency)[j])
    reach = _reach(a.frequency[i], gap[i, j], like, spread)
    return bool(abs(a.frequency[i] - b.frequency[j]) <= reach)


def _track(
    members: tuple[tuple[int, int], ...],
    stretches: Sequence[Stretch],
    shapes: Sequence[Complex],
) -> ModeTrack:
    at, mode = (np.array(x, dtype=np.int64) for x in zip(*members, strict=True))
    psi = np.stack([shapes[k][:, j] for k, j in members], axis=1)
    mean = _mean(psi)
    rows = [(stretches[k].modes, stretches[k].uncertainty, j) for k, j in members]
    return ModeTrack(
        name="",
        at=at,
        mode=mode,
        frequency=np.array([m.frequencies[j] for m, _, j in rows]),
        std_frequency=np.array([u.frequency[j] for _, u, j in rows]),
        damping=np.array([m.damping[j] for m, _, j in rows]),
        std_damping=np.array([u.damping[j] for _, u, j in rows]),
        confidence=np.array([m.confidence[j] for m, _, j in rows]),
        shape=mean,
        mac=common_mac(mean[:, None], psi)[0],
    )


def _mean(psi: Complex) -> Complex:
    """Mean shape (ch,) of length 1: the strongest direction of the shapes (ch, n), each channel by
    what it has.
    """
    known = np.isfinite(psi)
    filled = np.where(known, psi, 0.0)
    u = np.linalg.svd(filled, full_matrices=False)[0][:, 0]
    turn = u.conj() @ filled
    turned = filled * (turn.conj() / np.maximum(np.abs(turn), 1e-300))
    mean = np.where(
        known.any(axis=1), turned.sum(axis=1) / np.maximum(known.sum(axis=1), 1), np.nan
    )
    return np.asarray(mean / np.linalg.norm(mean[np.isfinite(mean)]))


def unseen(tracked: Tracked, track: ModeTrack) -> tuple[int, int]:
    """For how many stretches a mode is not seen before it first is, and after it last was.

    0 where this may be chance: where stretches that show it as often as those between would leave
    out so many in a row in more than one case of a hundred.
    """
    before = int(track.at[0])
    after = tracked.times.size - 1 - int(track.at[-1])
    missed = 1 - track.at.size / (track.at[-1] - track.at[0] + 2)
    came = before if missed**before < LIMITS.chance else 0
    went = after if missed**after < LIMITS.chance else 0
    return came, went


@dataclass(frozen=True, slots=True)
class LevelCheck:
    """When modes depend on the level.

    Attributes
    ----------
    significance : float
        Chance at which a linear structure is called nonlinear, in one of its modes.
    mac_min : float
        A mode of another level must have this MAC.
    shift_max : float
        And no farther in frequency than this, relative.
    """

    significance: float = 0.01
    mac_min: float = 0.7
    shift_max: float = 0.1


LEVELS = LevelCheck()


@dataclass(frozen=True, slots=True, eq=False)
class LevelDependence:
    """The modes of the lowest level, followed over all levels.

    Attributes
    ----------
    levels : (l,) float64
        Ascending, in the unit given.
    frequency, damping : (l, m) float64, Hz and fraction of critical
        NaN where the mode was not found.
    std_frequency, std_damping : (l, m) float64
    slope_frequency, slope_damping : (m,) float64
        Relative change for each factor e of the level: d ln f/d ln F and d ln ζ/d ln F, weighted
        least squares.
    std_slope_frequency, std_slope_damping : (m,) float64
    chance_frequency, chance_damping : (m,) float64
        Chance of so much scatter over the levels in a linear structure (χ² test of equal values).
    linear : (m,) bool
        No significant change in either, among so many modes.
    """

    levels: Float
    frequency: Float
    damping: Float
    std_frequency: Float
    std_damping: Float
    slope_frequency: Float
    slope_damping: Float
    std_slope_frequency: Float
    std_slope_damping: Float
    chance_frequency: Float
    chance_damping: Float
    linear: Bool

    def __post_init__(self) -> None:
        names = [n for n in self.__dataclass_fields__ if n != "linear"]
        freeze_fields(self, linear=np.bool_, **dict.fromkeys(names, np.float64))


def level_dependence(
    levels: Sequence[float], found: Sequence[tuple[ModeSet, Uncertainty]]
) -> LevelDependence:
    """Follow the modes over force levels and test whether they stay.

    Parameters
    ----------
    levels : sequence of float
        Force of each result (rms, or peak of the hits), any unit, positive.
    found : sequence of (ModeSet, Uncertainty)
        Of each level, same channels.

    Raises
    ------
    InputError
        If there are fewer than two levels, or levels that are not positive and different.
    """
    force = np.asarray(levels, dtype=np.float64)
    each_once = np.unique(force).size == force.size == len(found)
    if force.size < 2 or not each_once or (force <= 0).any():
        raise InputError(
            f"levels {force.tolist()} for {len(found)} results: two or more, positive, "
            "different, one each"
        )
    order = np.argsort(force)
    first = found[order[0]][0]
    values = np.full((4, force.size, len(first)), np.nan)
    last = first
    # a handful of levels, each followed from the one before
    for i, k in enumerate(order):
        modes, std = found[k]
        here, there = track(last, modes)
        values[:, i, here] = np.stack(
            [modes.frequencies, modes.damping, std.frequency, std.damping]
        )[:, there]
        # with the frequencies of the level just seen, so that slow drift is followed
        f = last.frequencies.copy()
        f[here] = modes.frequencies[there]
        last = replace(last, frequencies=f)
    x = np.log(force[order])
    slope_f, dev_f, chance_f = _trend(x, values[0], values[2])
    slope_z, dev_z, chance_z = _trend(x, values[1], values[3])
    # Bonferroni: all tests together
    each = LEVELS.significance / max(2 * np.isfinite(chance_f).sum(), 1)
    linear = ~((chance_f < each) | (chance_z < each))
    return LevelDependence(
        levels=force[order],
        frequency=values[0],
        damping=values[1],
        std_frequency=values[2],
        std_damping=values[3],
        slope_frequency=slope_f,
        slope_damping=slope_z,
        std_slope_frequency=dev_f,
        std_slope_damping=dev_z,
        chance_frequency=chance_f,
        chance_damping=chance_z,
        linear=linear,
    )


def track(a: ModeSet, b: ModeSet) -> tuple[Int, Int]:
    """Positions in `a` and `b` of the pairs with the largest total MAC, near in frequency."""
    b = b.rows(a.channels)
    similarity = mac(a.shapes, b.shapes)
    far = np.abs(np.log(a.frequencies[:, None] / b.frequencies))
    ok = (similarity >= LEVELS.mac_min) & (far <= LEVELS.shift_max)
    here, there = linear_sum_assignment(
        np.where(ok, similarity - far, -1.0), maximize=True
    )
    good = ok[here, there]
    return here[good], there[good]


def _trend(x: Float, value: Float, std: Float) -> tuple[Float, Float, Float]:
    """Slope (m,) of ln value over x, its deviation, and the chance of equal values; NaN with fewer
    than two levels.
    """
    y = np.log(value)
    s = std / value
    w = np.where(np.isfinite(y) & (s > 0), 1 / np.where(s > 0, s, 1.0) ** 2, 0.0)
    y = np.where(w > 0, y, 0.0)
    total = np.where(w.sum(axis=0) > 0, w.sum(axis=0), np.nan)
    xm = (w * x[:, None]).sum(axis=0) / total
    ym = (w * y).sum(axis=0) / total
    dx = x[:, None] - xm
    sxx = (w * dx**2).sum(axis=0)
    sxx = np.where((w > 0).sum(axis=0) > 1, sxx, np.nan)
    slope = (w * dx * (y - ym)).sum(axis=0) / sxx
    chance = chdtrc((w > 0).sum(axis=0) - 1, (w * (y - ym) ** 2).sum(axis=0))
    return (
        slope,
        1 / np.sqrt(sxx),
        np.where(np.isfinite(sxx), chance, np.nan),
    )
