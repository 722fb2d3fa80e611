"""Sensors mounted, named or connected otherwise than the sheet says: what would raise the MAC,
tried and never done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment
from scipy.special import gammaln

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.core.channels import match_channels, split_label
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.assignment import (
    WORTH,
    ComparedModes,
    PairingSettings,
    scores,
)
from ringtrue.correlation.channel_faults import LIMITS as FAULT_LIMITS
from ringtrue.correlation.channel_faults import (
    ChannelFault,
    Suspect,
    find_faults,
    mended,
    scaled_to,
    suspects_of,
)
from ringtrue.correlation.one_criterion import LIKE_SHAPES
from ringtrue.correlation.sensor_mapping import axis_turns
from ringtrue.shapes import mac, realise, unit


@dataclass(frozen=True, slots=True)
class MountingSearchSettings:
    """How turned sensors are sought.

    Attributes
    ----------
    changes : int
        Changes, one after the other.
    turns : int
        Turns of axes that are judged with close modes rotated, the best of all by single shapes.
    rival : float
        Log-likelihood: twenty times less likely is no rival.
    rounds : int
        Rounds of pairing and signs.
    """

    changes: int = 3
    turns: int = 12
    rival: float = 3.0
    rounds: int = 4


SEARCH = MountingSearchSettings()

LEAST_GAIN = -float(np.log(LIKE_SHAPES.chance))  # of log-likelihood
AXES = ("X", "Y", "Z")
Reading = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """A test and a model, with what the model does along all axes of the sheet at each sensor.

    Attributes
    ----------
    test : ModeSet
        (n, ma)
    frequencies : (mb,) float64, Hz
        Of the model.
    motion : (3, n, mb) float64 or complex128
        Shapes of the model along X, Y, Z of the sheet where each sensor is; NaN where that is not
        known.
    axes : (n, 3) float64
        Unit vector of each sensor, frame of the sheet.
    groups : tuple (n) of str
        Part of the structure that each sensor is on, as the sheet names it.
    """

    test: ModeSet
    frequencies: Float
    motion: Any_
    axes: Float
    groups: tuple[str, ...]

    def seen(self, axes: Float) -> Any_:
        """What sensors with such axes (n, 3) read of the model, (n, mb); NaN where that is not
        known.
        """
        share = axes.T[:, :, None]
        # part of a unit vector
        along = np.where(np.abs(share) > 1e-9, share * self.motion, 0.0)
        return np.asarray(along.sum(axis=0))


@dataclass(frozen=True, slots=True)
class Mending:
    """What raises the MAC if sensors are not mounted, connected or named as the sheet says; nothing
    is mended.

    Attributes
    ----------
    kind : {"axes", "signs", "channels"}
        Whole axes turned or reversed; any number of channels reversed; single channels reversed or
        swapped.
    group : str
        The part of the structure whose sensors are meant; empty: all sensors.
    axes : tuple of (str, str)
        Of "axes": an axis of the sheet that sensors lie along, and what they read: ("X", "-Z").
    rivals : tuple of str
        Other changes of axes that explain the test as well, in words.
    suspects : tuple of Suspect
        Of "signs" and "channels".
    pairs : tuple of (int, int)
        Modes with a MAC above the gate, before and after.
    mac : tuple of (float, float), 0..1
        Mean MAC of the test modes with their best partners within the frequency gate, before and
        after.
    """

    kind: Literal["axes", "signs", "channels"]
    group: str
    axes: tuple[Reading, ...]
    rivals: tuple[str, ...]
    suspects: tuple[Suspect, ...]
    pairs: tuple[int, int]
    mac: tuple[float, float]

    @property
    def channels(self) -> tuple[str, ...]:
        """Those that are named one by one."""
        return tuple(s.channel for s in self.suspects)

    @property
    def change(self) -> str:
        """What would be changed, in words."""
        if self.kind == "axes":
            return _axes_words(self.group, self.axes)
        if self.kind == "signs":
            return (
                f"{' '.join(s.channel for s in self.suspects)} read with the opposite sign of "
                "the others"
            )
        return "; ".join(
            f"{s.channel} {s.message.split(';')[0]}" for s in self.suspects
        )

    @property
    def text(self) -> str:
        """The change, and what it does, in words."""
        (now, then), (few, more) = self.mac, self.pairs
        rivals = f" (or {'; or '.join(self.rivals)})" if self.rivals else ""
        return (
            f"sensors may be mounted, connected or named otherwise: if {self.change}{rivals}, "
            "the mean MAC of the test "
            f"modes with their best partners rises from {100 * now:.1f} to {100 * then:.1f} %, by "
            f"{100 * (then - now):.1f} points, and {more} instead of {few} modes have a partner. "
            "Nothing was changed"
        )


def readings_by_name(test: ModeSet, model: ModeSet) -> Readings:
    """Two sets of modes, the axes of the sensors taken from their names, such as `101+Z`.

    Parameters
    ----------
    test : ModeSet
    model : ModeSet
        At the channels of the test, and others: what it does at `101+X` and `101+Y` is known where
        it has these. Where names tell no axes signs and cables alone are tried.
    """
    n = len(test.channels)
    labels = [split_label(c) for c in test.channels]
    along = [label for label in labels if label is not None and label[2] in AXES]
    motion = np.full((3, n, len(model)), np.nan, dtype=model.shapes.dtype)
    axes = np.zeros((n, 3))
    if len(along) < n:
        wanted = [list(test.channels)]
        axes[:, 0] = 1.0
    else:
        wanted = [[f"{point}+{axis}" for point, _, _ in along] for axis in AXES]
        for i, (_, sense, axis) in enumerate(along):
            axes[i, AXES.index(axis)] = sense
    for k, names in enumerate(wanted):
        index, sign = match_channels(names, model.channels)
        known = index >= 0
        motion[k, known] = model.shapes[index[known]] * sign[known, None]
    return Readings(test, model.frequencies, motion, axes, ("",) * n)


def mendings_json(found: Sequence[Mending]) -> list[dict[str, Any]]:
    """Plain values."""
    return [
        {
            "kind": m.kind,
            "group": m.group or None,
            "axes": dict(m.axes),
            "channels": list(m.channels),
            "rivals": list(m.rivals),
            "pairs": list(m.pairs),
            "mean_mac_percent": [100 * x for x in m.mac],
            "text": m.text,
        }
        for m in found
    ]


def find_mendings(
    given: Readings,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> tuple[Mending, ...]:
    """Which turns of axes, of all sensors or of a group, which signs and which swapped cables
    explain a test better.

    Each is tried with a pairing of its own, since wrong axes leave few pairs. What a shape has that
    the model misses, 1 − MAC, is taken for a variance. A change counts if the likelihood that it
    gains outweighs the number of changes that are tried, with 1 % to be wrong, and if the mean MAC
    of the modes is then above the gate. Of changes that shapes cannot distinguish the frequencies
    decide. The best one is thought away, and the rest tried anew.

    Parameters
    ----------
    given : Readings
    settings : PairingSettings
        Those of the pairing.

    Notes
    -----
    It believes the model, as `find_faults` does. What a symmetric structure leaves open
    is named with the best. The sign of all sensors together says nothing and is not looked at.
    """
    axes = given.axes
    shapes = given.test.shapes
    found = list[Mending]()
    usable = (given.test.confidence >= settings.min_confidence) & given.test.shapes.any(
        axis=0
    )
    if not usable.any() or not given.frequencies.size:
        return ()
    strength = linalg.svdvals(unit(given.test.shapes[:, usable]))
    patterns = int((strength > LIKE_SHAPES.pattern * strength.max(initial=0.0)).sum())
    search = _MountingSearch(
        given=given,
        settings=settings,
        usable=usable,
        patterns=patterns,
    )
    for _ in range(SEARCH.changes):
        before = search.fit(shapes, axes)
        if (
            before is None
            or search.gain(before.mac, np.ones_like(before.mac)) <= LEAST_GAIN
        ):
            break  # nothing could gain enough
        best = search.likeliest(shapes, axes, before)
        if best is None:
            break
        found.append(best[0])
        shapes = best[1].shapes
        axes = best[1].axes
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _MountingFit:
    """MAC (k,) of the chosen test modes with their best partners, 0 without one, and these, -1 for
    none.
    """

    mac: Float
    partner: Int
    seen: Any_


@dataclass(frozen=True, slots=True, eq=False)
class _MountingChange:
    """Shapes and axes after a change; `cost` is the logarithm of the number of changes of its
    kind.
    """

    shapes: Any_
    axes: Float
    cost: float
    kind: Literal["axes", "signs", "channels"]
    group: str = ""
    faults: tuple[ChannelFault, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _MountingSearch:
    given: Readings
    settings: PairingSettings
    usable: Bool
    patterns: int  # independent ones in the shapes of the test

    def fit(
        self, shapes: Any_, axes: Float, *, rotated: bool = True
    ) -> _MountingFit | None:
        """The best one-to-one assignment within the frequency gate; None where motion along the
        axes is not known.
        """
        b = self.given.seen(axes)
        fb = self.given.frequencies
        if not np.isfinite(b).all():
            return None
        a = shapes[:, self.usable]
        fa = self.given.test.frequencies[self.usable]
        modes = ComparedModes(fa, a, fb, b)
        found = scores(modes, self.settings).merged if rotated else mac(a, b)
        worth = np.where(self._possible(b), found, 0.0)
        rows, columns = linear_sum_assignment(-worth)
        value = np.zeros(fa.size)
        partner = np.full(fa.size, -1, dtype=np.int64)
        value[rows] = worth[rows, columns]
        partner[rows] = np.where(value[rows] > 0, columns, -1)
        return _MountingFit(np.clip(value, 0.0, 1.0), partner, b)

    def _possible(self, b: Any_) -> Bool:
        """Which pairs (ma, mb) are within the frequency gate, of modes that the sensors see."""
        fa = self.given.test.frequencies[self.usable]
        fb = self.given.frequencies
        near = (
            np.abs(fb[None, :] - fa[:, None])
            <= self.settings.frequency_gate * np.abs(fa)[:, None]
        )
        typical = np.median(
            np.nan_to_num(np.abs(self.given.motion)).max(axis=(0, 1), initial=0.0)
        )
        return np.asarray(
            near & (np.abs(b).max(axis=0, initial=0.0) >= self.settings.faint * typical)
        )

    def gain(self, before: Float, after: Float) -> float:
        """What a change of the MACs (k,) gains in log-likelihood, with as many readings as the
        shapes have patterns.

        Above `distinct` two shapes are the same: what a model lacks there is its error, and no
        fault of sensors.
        """
        own = 1 - self.settings.distinct
        return float(
            self.patterns / 2 * np.log((1 - before + own) / (1 - after + own)).sum()
        )

    def likeliest(
        self, shapes: Any_, axes: Float, before: _MountingFit
    ) -> tuple[Mending, _MountingChange] | None:
        """The change that gains most, if it gains enough."""
        turns = self._turns(shapes, axes)
        rough = [self.fit(c.shapes, c.axes, rotated=False) for c in turns]
        worth = [-np.inf if f is None else self.gain(before.mac, f.mac) for f in rough]
        order = np.argsort(worth, kind="stable")[::-1][: SEARCH.turns]
        changes = [turns[i] for i in order if np.isfinite(worth[i])]
        changes += [*self._signs(shapes, axes), *self._channels(shapes, axes, before)]
        judged = []
        for change in changes:
            after = self.fit(change.shapes, change.axes)
            if after is None:
                continue
            net = self.gain(before.mac, after.mac) - change.cost
            if net > LEAST_GAIN and after.mac.mean() >= self.settings.mac_gate:
                judged.append((net, change, after))
        if not judged:
            return None
        top = max(net for net, _, _ in judged)
        likely = [
            (change, after) for net, change, after in judged if net > top - SEARCH.rival
        ]
        change, after = min(likely, key=lambda pair: self._strangeness(*pair))
        others = [c for c, _ in likely if c is not change and c.kind == "axes"]
        if change.kind != "axes":
            others = []
        rivals = [_axes_words(c.group, self._readings(c)) for c in others]
        return self._mending(
            change, before, after, tuple(dict.fromkeys(rivals))
        ), change

    def _strangeness(
        self, change: _MountingChange, after: _MountingFit
    ) -> tuple[float, int]:
        """What decides between changes that shapes cannot distinguish: the frequencies, then how
        much is reversed.

        The mean |Δf| over the frequency gate, in steps of a hundredth, and the number of reversed
        axes or channels.
        """
        kept = after.partner >= 0
        fa = self.given.test.frequencies[self.usable]
        fb = self.given.frequencies[after.partner]
        off = np.where(kept, np.abs(fb / fa - 1) / self.settings.frequency_gate, 1.0)
        reversed_axes = sum(
            reads.startswith("-") for _, reads in self._readings(change)
        )
        return round(float(off.mean()), 2), reversed_axes + len(change.faults)

    def _mending(
        self,
        change: _MountingChange,
        before: _MountingFit,
        after: _MountingFit,
        rivals: tuple[str, ...],
    ) -> Mending:
        now = float(before.mac.mean())
        then = float(after.mac.mean())
        names = self.given.test.channels
        suspects = [s for f in change.faults for s in suspects_of(f, names, now, then)]
        few, more = (
            int((f.mac >= self.settings.mac_gate).sum()) for f in (before, after)
        )
        return Mending(
            kind=change.kind,
            group=change.group,
            axes=self._readings(change) if change.kind == "axes" else (),
            rivals=rivals,
            suspects=tuple(suspects),
            pairs=(few, more),
            mac=(now, then),
        )

    def _turns(self, shapes: Any_, axes: Float) -> list[_MountingChange]:
        """Every way to lay the axes of all sensors, or of those of a group, onto each other; each
        reading once.
        """
        groups = sorted(set(self.given.groups))
        made = dict[bytes, tuple[str, Float]]()
        for turn in axis_turns():
            made.setdefault(_without_sign(axes @ turn.T), ("", axes @ turn.T))
        if len(groups) > 1:
            for group in groups:
                here = np.array([g == group for g in self.given.groups])[:, None]
                for turn in (sign * q for q in axis_turns() for sign in (1.0, -1.0)):
                    turned = np.where(here, axes @ turn.T, axes)
                    made.setdefault(_without_sign(turned), (group, turned))
        made.pop(_without_sign(axes))
        cost = float(np.log(max(len(made), 1)))
        return [
            _MountingChange(shapes, turned, cost, "axes", group)
            for group, turned in made.values()
        ]

    def _readings(self, change: _MountingChange) -> tuple[Reading, ...]:
        """Each axis of the sheet that sensors of the change lie along, and what they then read."""
        axes = self.given.axes
        turned = change.axes
        mine = np.array(
            [not change.group or g == change.group for g in self.given.groups]
        )
        along = np.where(mine, np.abs(axes).argmax(axis=1), -1)
        out = []
        for k in range(3):
            if not (along == k).any():
                continue
            i = int(np.argmax(along == k))
            to = turned[i] * np.sign(axes[i, k])
            m = int(np.abs(to).argmax())
            out.append(("XYZ"[k], f"{'-' if to[m] < 0 else ''}{'XYZ'[m]}"))
        # the sign of all says nothing
        if not change.group and sum(y.startswith("-") for _, y in out) > len(out) / 2:
            out = [(x, y[1:] if y.startswith("-") else f"-{y}") for x, y in out]
        return tuple((x, y) for x, y in out if x != y)

    def _signs(self, shapes: Any_, axes: Float) -> list[_MountingChange]:
        """Any number of channels reversed: those that do, of modes paired whatever the signs."""
        b = self.given.seen(axes)
        n = len(shapes)
        if not np.isfinite(b).all():
            return []
        a = realise(shapes[:, self.usable])
        possible = self._possible(b)
        sign = np.ones(n)
        like = mac(np.abs(a), np.abs(b))
        for _ in range(SEARCH.rounds):
            rows, columns = linear_sum_assignment(-np.where(possible, like, 0.0))
            kept = possible[rows, columns]
            left = a[:, rows[kept]]
            right = b[:, columns[kept]]
            if not kept.any():
                return []
            product = (unit(left).conj() * unit(right)).real
            first = linalg.svd(product, full_matrices=False)[0][:, 0]
            sign = np.where(first < 0, -1.0, 1.0)
            like = mac(a * sign[:, None], b)
        y, expected = scaled_to(left * sign[:, None], right)
        size = np.linalg.norm(y, axis=1) * np.linalg.norm(expected, axis=1)
        cosine = (y * expected).sum(axis=1) / np.where(size > 0, size, 1.0)
        certain = np.abs(cosine) > FAULT_LIMITS.correlation
        same = sign if sign[certain].sum() >= 0 else -sign
        turned = np.flatnonzero((same * np.sign(cosine) < 0) & certain)
        if not turned.size:
            return []
        faults = tuple(ChannelFault(i, "reversed", -1.0) for i in turned.tolist())
        k = turned.size
        cost = float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1) + np.log(n))
        return [
            _MountingChange(
                shapes=mended(shapes, faults),
                axes=axes,
                cost=cost,
                kind="signs",
                faults=faults,
            )
        ]

    def _channels(
        self, shapes: Any_, axes: Float, before: _MountingFit
    ) -> list[_MountingChange]:
        """Single channels reversed or swapped, judged by what pairs there are."""
        partner = before.partner
        paired = partner >= 0
        like = paired & (before.mac >= WORTH.hold * self.settings.mac_gate)
        some = np.flatnonzero(like if like.sum() >= 3 else paired)
        if some.size < 3:
            return []
        left = shapes[:, self.usable][:, some]
        right = before.seen[:, partner[some]]
        faults = [
            f for f in find_faults(left, right) if f.fault in ("reversed", "swapped")
        ]
        if not faults:
            return []
        cost = sum(max(len(f.moved), 1) for f in faults) * float(np.log(len(shapes)))
        return [
            _MountingChange(
                shapes=mended(shapes, faults),
                axes=axes,
                cost=cost,
                kind="channels",
                faults=tuple(faults),
            )
        ]


def _without_sign(axes: Float) -> bytes:
    """What is the same of axes and of all of them reversed."""
    flat = np.round(axes, 6).ravel()
    return bytes((flat * np.sign(flat[np.flatnonzero(flat)[0]]) + 0.0).tobytes())


def _axes_words(group: str, readings: Sequence[Reading]) -> str:
    who = f"the sensors of {group!r}" if group else "the sensors"
    if group and all(y == f"-{x}" for x, y in readings):
        return f"{who} read with the opposite sign of the others"
    return f"{who} along " + ", ".join(f"{x} read {y}" for x, y in readings)
