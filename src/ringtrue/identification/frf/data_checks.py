"""Checks of FRFs: what cannot be identified is refused, what looks wrong becomes a note.

FRFs of noise in blocks under a Hann window are found by what a fit by poles leaves around narrow
modes (`lines.faded`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from scipy.linalg import lstsq

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.channels import POWER
from ringtrue.core.modes import ModalModel, ModeSet
from ringtrue.core.notes import Note
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.identification.frf.lines import Lines, faded
from ringtrue.identification.frf.refinement import Refined
from ringtrue.identification.frf.residues import (
    DrivingPoints,
    driving_pairs,
    line_coherence,
)
from ringtrue.shapes import mac, unit
from ringtrue.signal.frf_sets import passive


@dataclass(frozen=True, slots=True)
class FrfCheckLimits:
    """When FRFs look wrong.

    Attributes
    ----------
    usable : float
        Coherence, or likeness of neighbouring lines, below which FRFs are noise.
    odd_level : float
        Level of a response over that of the typical one of its kind.
    turned : float
        Share of the power at a driving point of the wrong sign. What rings on between impacts takes
        the rest.
    few_lines : float
        Lines in a half-power bandwidth, below which the block cuts responses off: of one with 1.5
        lines 1 % is left at its end.
    left : float
        Share of an FRF that a fit of its modes leaves.
    """

    usable: float = 0.5
    odd_level: float = 100.0
    turned: float = 0.3
    few_lines: float = 1.5
    left: float = 0.05


@dataclass(frozen=True, slots=True)
class DelayLimits:
    """When a response is late.

    Attributes
    ----------
    modes : int
        Least number of modes that show a delay.
    real : float
        How real the phases of the response are, below which it may be late: 1 where they are all 0
        or 180°.
    delayed : float
        How real they are without the delay, and those of the typical response as it is.
    """

    modes: int = 4
    real: float = 0.9
    delayed: float = 0.97


@dataclass(frozen=True, slots=True)
class OddChannelLimits:
    """When a response is turned or exchanged under one reference.

    Attributes
    ----------
    misfit : float
        Share of the squared residues that no single shape explains, above which a fault is sought.
    mended : float
        Share of it that may be left once the fault is undone.
    trials : int
        Most residues that are tried in place of others.
    """

    misfit: float = 1e-3
    mended: float = 0.3
    trials: int = 400_000


@dataclass(frozen=True, slots=True)
class HannLimits:
    """When FRFs are of blocks of noise under a Hann window.

    Attributes
    ----------
    lines : float
        Lines in a half-power bandwidth, above which the window changes less than a hundredth.
    excess : float
        Damping too much, times their square.
    half_bandwidths, around : float, int
        That count around a mode, and lines besides.
    share : float
        Of what such blocks would leave.
    """

    lines: float = 12.0
    excess: float = 1.34
    half_bandwidths: float = 8.0
    around: int = 4
    share: float = 0.3


LIMITS = FrfCheckLimits()


def band_limits(
    frfs: FrfSet, fmin: float | None, fmax: float | None
) -> tuple[float, float]:
    """The reported band, Hz; where not given, up to where the coherence, or the likeness of next
    lines, ends.
    """
    f = frfs.freqs
    low = fmin if fmin is not None else float(f[f > 0][0])
    high = fmax if fmax is not None else _usable_to(frfs)
    if np.count_nonzero((f >= low) & (f <= high)) < 32:
        raise DataError(
            f"{frfs.source}: fewer than 32 lines between {low:g} and {high:g} Hz; widen fmin, fmax"
        )
    return max(low, float(f[0])), min(high, float(f[-1]))


def _usable_to(frfs: FrfSet) -> float:
    """Frequency, Hz, of the last line at which the coherence, or the likeness of next lines, is
    usable.
    """
    f = frfs.freqs
    known = bool(np.isfinite(frfs.coherence).all())
    good = (
        np.median(frfs.coherence, axis=(1, 2))
        if known
        else line_coherence(frfs.data, f)
    )
    wide = max(5, good.size // 50) | 1
    smoothed = np.convolve(
        np.pad(good, wide // 2, mode="edge"), np.ones(wide) / wide, "valid"
    )
    usable = f[smoothed > LIMITS.usable]
    return float(usable[-1] if usable.size else f[-1])


def end_note(frfs: FrfSet, fmax: float | None, high: float) -> str:
    """Says that the band ends before the lines do."""
    if fmax is not None or high > 0.95 * frfs.freqs[-1]:
        return ""
    return (
        f"the band ends at {high:.4g} Hz: beyond, the FRFs are noise (--fmax for more)"
    )


def lines_between(frfs: FrfSet, low: float, high: float) -> FrfSet:
    """The FRFs of a band, Hz, without the line at 0 Hz."""
    at = (frfs.freqs >= low) & (frfs.freqs <= high) & (frfs.freqs > 0)
    return replace(
        frfs, data=frfs.data[at], freqs=frfs.freqs[at], coherence=frfs.coherence[at]
    )


def refuse_bad_frfs(frfs: FrfSet) -> None:
    """Refuse FRFs without a signal, with lines set to zero, or without phase.

    Raises
    ------
    DataError
        If it is so; the message names the channels and lines.
    """
    h = frfs.data[frfs.freqs > 0]
    f = frfs.freqs[frfs.freqs > 0]
    where = frfs.source or "FRF"
    if h.shape[0] < 3:
        raise DataError(f"{where}: {h.shape[0]} lines above 0 Hz; there must be some")
    size = np.abs(h)
    if not 1e-70 < size.max() < 1e70:  # fourth powers stay finite
        raise DataError(
            f"{where}: the largest value is {size.max():.2g}; no unit makes that"
        )
    flat: Bool = np.all(h == h[0], axis=0)
    for name, channels, axis in (
        ("response", frfs.outputs, 1),
        ("reference", frfs.inputs, 0),
    ):
        if (dead := np.asarray(flat.all(axis=axis))).any():
            ids = " ".join(c.id for c, d in zip(channels, dead, strict=True) if d)
            raise DataError(
                f"{where}: {name} {ids} is the same at all lines: a dead channel; leave it out"
            )
    if (h.imag == 0).all():
        raise DataError(
            f"{where}: all values are real: amplitudes without phase cannot be identified"
        )
    _refuse_gaps(size == 0, f, where)


def _refuse_gaps(zero: Bool, freqs: Float, where: str) -> None:
    """Refuse lines at which a reference has no value at any response."""
    lost = np.any(zero.all(axis=1), axis=1)
    if lost.any():
        first, last = freqs[np.flatnonzero(lost)[[0, -1]]]
        raise DataError(
            f"{where}: FRF with gaps: {int(lost.sum())} lines between {first:g} and {last:g} Hz "
            "are zero; cut it there"
        )


def frf_notes(frfs: FrfSet, sound: DrivingPoints) -> tuple[str, ...]:
    """What looks wrong before identification: odd levels, low coherence, driving points that are
    not `sound_pairs`.
    """
    out = []
    level = np.sqrt((np.abs(frfs.data) ** 2).mean(axis=(0, 2)))
    kinds = np.array([c.quantity for c in frfs.outputs])
    for k, c in enumerate(frfs.outputs):
        same = level[kinds == c.quantity]
        ratio = float(level[k] / max(np.median(same), 1e-300))
        if same.size > 2 and not 1 / LIMITS.odd_level < ratio < LIMITS.odd_level:
            out.append(
                f"response {c.id}: {ratio:.1e} of the typical level: unit or sensitivity?"
            )
    if np.isfinite(frfs.coherence).any():
        typical = float(np.nanmedian(_some_coherence(frfs)))
        if typical < LIMITS.usable:
            out.append(
                f"the coherence is {typical:.2f} at the typical line: most of these FRFs is noise"
            )
    step = np.diff(frfs.freqs)
    if np.ptp(step) > 1e-3 * np.median(step):
        wide = int(step.argmax())
        between = f"{frfs.freqs[wide]:.5g} and {frfs.freqs[wide + 1]:.5g} Hz"
        out.append(
            f"uneven lines: spacing {step.min():.3g} to {step.max():.3g} Hz, widest between "
            f"{between}"
        )
    if len(frfs.inputs) == 1:
        out.append("one reference: two modes of one and the same frequency show as one")
    turned = [
        frfs.inputs[i].id for i in driving_pairs(frfs).input if i not in sound.input
    ]
    if turned:
        rest = "" if sound else ": the modes are not scaled"
        out.append(
            f"driving point {' '.join(turned)}: sensor or hammer is the other way round; not "
            f"used{rest}"
        )
    return tuple(out)


def _some_coherence(frfs: FrfSet) -> Float:
    """The coherence at some 500 lines."""
    return frfs.coherence[:: max(1, frfs.freqs.size // 500)]


def incoherent_responses(frfs: FrfSet) -> tuple[Note, ...]:
    """A note on responses that do not follow the force, where most of the FRFs do."""
    if not np.isfinite(frfs.coherence).any():
        return ()
    some = _some_coherence(frfs)
    typical = float(np.nanmedian(some))
    if typical < LIMITS.usable:
        return ()
    of_each = np.full(len(frfs.outputs), np.nan)
    for k in range(of_each.size):
        known = some[:, k][np.isfinite(some[:, k])]
        if known.size:
            of_each[k] = np.median(known)
    low = of_each < LIMITS.usable * typical
    if not low.any():
        return ()
    at = np.flatnonzero(low).tolist()
    names = " ".join(frfs.outputs[i].id for i in at)
    values = ", ".join(f"{of_each[i]:.2f}" for i in at)
    usual = float(np.nanmedian(of_each[~low]))
    return (
        Note(
            "channel incoherent", "warning", names, {"values": values, "usual": usual}
        ),
    )


def fit_notes(frfs: FrfSet, modes: ModeSet, error: Float) -> tuple[str, ...]:
    """What the modes found tell of the FRFs: responses cut off by the block, and errors that are no
    noise.

    Parameters
    ----------
    frfs : FrfSet
        At the lines of the reported band.
    modes : ModeSet
    error : (out, in) float64
        ‖H − H_fit‖/‖H‖ there.
    """
    out = []
    step = np.interp(modes.frequencies, frfs.freqs[1:], np.diff(frfs.freqs))
    width = (2 * modes.damping * modes.frequencies + frfs.window_decay / np.pi) / step
    cut = [f"{f:.4g}" for f in modes.frequencies[width < LIMITS.few_lines]]
    if cut and np.isinf(frfs.kept) and not (frfs.sharp or frfs.hann):
        more = f" and {len(cut) - 6} more" if len(cut) > 6 else ""
        out.append(
            f"less than {LIMITS.few_lines:g} lines in the half-power bandwidth at "
            f"{' '.join(cut[:6])} Hz{more}: the blocks are short for these modes, and windows "
            "other than the exponential one raise their damping"
        )
    if np.isfinite(frfs.coherence).all():
        n = np.where(np.isfinite(frfs.averages), np.maximum(frfs.averages, 1), 1)
        g = np.clip(frfs.coherence, 1e-3, 1.0)
        power = np.abs(frfs.data) ** 2
        noise = (power * (1 - g) / (n * g)).sum(axis=0) / np.maximum(
            power.sum(axis=0), 1e-300
        )
        due = float(np.median(np.sqrt(noise)))
        left = float(np.median(error))
        if left > max(LIMITS.left, 3 * due):
            blocks = " or" if frfs.sharp else ", short blocks or"
            out.append(
                f"the modes leave {100 * left:.2g} % of the typical FRF, its coherence "
                f"explains {100 * due:.2g} %: FRFs that disagree (mass of moved sensors, "
                f"temperature){blocks} modes outside the band"
            )
    return tuple(out)


def disagreement_note(model: ModalModel) -> str:
    """Finds batches that disagree where a mode of each explains them: neighbours within 5 %, driven
    equally, seen by others.

    Two bending directions are driven differently; with one reference nothing is said.
    """
    if model.participation.shape[1] < 2 or model.poles.size < 4:
        return ""
    order = np.argsort(model.frequencies)
    f = model.frequencies[order]
    shapes = unit(np.abs(model.shapes[:, order]))
    part = model.participation[order].T
    ratio = f / f[:, None]
    unlike = shapes.T @ shapes < 0.2
    first, second = np.nonzero(
        (ratio > 1) & (ratio < 1.05) & unlike & (mac(part, part) > 0.9)
    )
    if 2 * np.unique(first).size < 0.5 * f.size:
        return ""
    some = zip(first[:3], second[:3], strict=True)
    pairs = ", ".join(f"{f[i]:.5g} and {f[k]:.5g}" for i, k in some)
    return (
        f"modes at {pairs} Hz are driven equally and seen by different responses: FRFs that "
        "disagree show each mode twice"
    )


def late_channels(modes: ModeSet) -> tuple[str, ...]:
    """Responses whose phase against all others falls with frequency from mode to mode: a delay.

    Of real shapes; a half period of the highest mode at most is looked for.
    """
    limits = DelayLimits()
    if len(modes) < limits.modes:
        return ()
    omega = 2 * np.pi * modes.frequencies
    delay = np.linspace(-1, 1, 401) * np.pi / omega.max()
    power = np.abs(modes.shapes) ** 2
    power = power / np.maximum(power.sum(axis=0), 1e-300)
    weight = power / np.maximum(power.sum(axis=1, keepdims=True), 1e-300)
    turned = np.exp(2j * np.angle(modes.shapes)) * weight
    # (channel, delay), 1 where all phases are 0 or 180°
    real = (turned @ np.exp(2j * omega[:, None] * delay)).real
    now = real[:, delay.size // 2]
    # number of modes in a response
    effective = 1 / np.maximum((weight**2).sum(axis=1), 1e-300)
    late = (now < limits.real) & (real.max(axis=1) > limits.delayed)
    late &= (effective > limits.modes - 1) & (np.median(now) > limits.delayed)
    out = []
    for k in np.flatnonzero(late).tolist():
        best = delay[real[k].argmax()]
        out.append(
            f"response {modes.channels[k]} looks {1e3 * abs(best):.2g} ms "
            f"{'late' if best > 0 else 'early'}: its phase goes with the frequency"
        )
    return tuple(out)


def sound_pairs(frfs: FrfSet) -> DrivingPoints:
    """(output, input, sign) of the driving points but for those that give power to the hammer:
    turned ones.
    """
    points = driving_pairs(frfs)
    where = zip(points.output.tolist(), points.input.tolist(), strict=True)
    power = np.array([passive(frfs, o, i) for o, i in where])
    return points.take(points.sign * power > -LIMITS.turned)


def odd_channel(frfs: FrfSet, poles: Complex) -> str:
    """A response that one reference sees turned or exchanged with another, found from the rank of
    the residues.

    In a linear structure the residues of each mode are a shape times the participations, H_oi ~ ψ_o
    l_i. A channel turned or exchanged while one reference was measured breaks that in all modes;
    undoing it must mend all of them. Empty if the residues fit, nothing single mends them, or there
    is one reference or mode only.

    Parameters
    ----------
    frfs : FrfSet
    poles : (m,) complex128, rad/s
        Without the exponential window.
    """
    limits = OddChannelLimits()
    poles = _distinct(poles)
    n_out, n_in = frfs.data.shape[1:]
    if (
        n_in < 2
        or n_out < 3
        or poles.size < 2
        or n_in * n_out**2 * poles.size > limits.trials
    ):
        return ""
    r = _residues(frfs, poles)
    r = r / np.maximum(np.linalg.norm(r, axis=(1, 2), keepdims=True), 1e-300)
    now = float(_misfit(r).mean())
    if now < limits.misfit:
        return ""
    left, fault = min(_single_faults(frfs, r), key=itemgetter(0))
    if left > limits.mended * now:
        return ""
    return (
        f"{fault}: {100 * now:.2g} % of the residues fit no single shape, {100 * left:.2g} % "
        "if that is mended"
    )


def _distinct(poles: Complex) -> Complex:
    """One pole for those within half a bandwidth of each other: a fault splits modes in two."""
    out: list[complex] = []
    for p in poles[np.argsort(poles.imag)].tolist():
        if not out or abs(p - out[-1]) > abs(p.real):
            out.append(p)
    return np.array(out, dtype=np.complex128)


def _residues(frfs: FrfSet, poles: Complex) -> Complex:
    """Residues (m, out, in) of each FRF by itself, with a lower and an upper residual: no shape is
    asked for.
    """
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    near = (np.abs(s[:, None] - poles) < 12 * np.abs(poles.real)).any(axis=1) & (
        frfs.freqs > 0
    )
    s = s[near]
    kind = (s / np.abs(s[-1])) ** POWER[frfs.kind]
    one = kind[:, None] / (s[:, None] - poles)
    two = kind[:, None] / (s[:, None] - poles.conj())
    rest = kind[:, None] * np.stack([np.ones(s.size), (np.abs(s[0]) / s) ** 2], axis=1)
    a = np.concatenate([one + two, 1j * (one - two), rest], axis=1)
    scale = np.linalg.norm(a, axis=0)
    a = np.concatenate([a.real, a.imag]).T / scale[:, None]
    h = frfs.data[near].reshape(s.size, -1)
    x = lstsq(a @ a.T, a @ np.concatenate([h.real, h.imag]), cond=1e-13)[0]
    x /= scale[:, None]
    m = poles.size
    return np.asarray((x[:m] + 1j * x[m : 2 * m]).reshape(m, *frfs.data.shape[1:]))


def _misfit(r: Complex) -> Float:
    """(...,) share of the squared residues `r` (..., out, in) that no single shape explains: rank
    one in each mode.
    """
    gram = r.conj().swapaxes(-1, -2) @ r
    values = np.linalg.eigvalsh(gram)
    return np.asarray(1 - values[..., -1] / np.maximum(values.sum(axis=-1), 1e-300))


def _single_faults(frfs: FrfSet, r: Complex) -> Iterator[tuple[float, str]]:
    """For each reference the responses that may be turned or exchanged under it: the misfit of the
    residues with that undone, and the fault.
    """
    out = [c.id for c in frfs.outputs]
    under = [c.id for c in frfs.inputs]
    if len(under) == 2:  # none of the two is the odd one
        under = [" or ".join(under)] * 2
    for i, reference in enumerate(under):  # a handful of references
        turned = np.broadcast_to(r, (len(out), *r.shape)).copy()
        turned[np.arange(len(out)), :, np.arange(len(out)), i] *= -1
        left = _misfit(turned).mean(axis=1)
        odd = out[int(left.argmin())]
        yield (
            float(left.min()),
            f"response {odd} looks turned under reference {reference}",
        )
        for o in range(len(out) - 1):
            other = np.arange(o + 1, len(out))
            swapped = np.broadcast_to(r, (other.size, *r.shape)).copy()
            swapped[:, :, o, i] = r[:, other, i].T
            swapped[np.arange(other.size), :, other, i] = r[:, o, i]
            left = _misfit(swapped).mean(axis=1)
            pair = f"{out[o]} and {out[int(other[left.argmin()])]}"
            yield (
                float(left.min()),
                f"responses {pair} look swapped under reference {reference}",
            )


def block_of_noise(frfs: FrfSet) -> float:
    """Length, s, of the blocks that FRFs on even lines may be of; 0 where they are known to be of
    impacts, or sharp.
    """
    step = np.diff(frfs.freqs)
    even = float(np.ptp(step)) < 1e-3 * float(step.mean())
    known = (
        frfs.sharp
        or frfs.impacts is not None
        or np.isfinite(frfs.kept)
        or frfs.window_decay > 0
    )
    return 0.0 if known or not even else 1 / float(step.mean())


def looks_faded(lines: Lines, fit: Refined, length: float) -> bool:
    """Whether what a fit by poles leaves around narrow modes is what it would leave of blocks of
    that length, s.

    A regression on that, per mode besides its residue, its pole and a smooth rest; 0 of FRFs
    without leakage, 1 with.
    """
    limits = HannLimits()
    x = lines.s.imag
    half = -fit.poles.real
    count = half * length / np.pi  # lines in the half-power bandwidth
    like = 0.0
    size = 0.0
    for k in np.flatnonzero(count < limits.lines).tolist():  # few lines each
        reach = limits.half_bandwidths * half[k] + limits.around * 2 * np.pi / length
        at = np.abs(x - fit.poles[k].imag) < reach
        if np.count_nonzero(at) < 2 * limits.around:
            continue
        s = lines.s[at]
        pole = complex(
            -half[k] / (1 + limits.excess / count[k] ** 2), fit.poles[k].imag
        )
        missing = (
            faded(s, np.array([pole]), length)[0][:, 0] * pole**lines.order / (s - pole)
        )
        far = 1 / (s - fit.poles[k])
        explained = np.stack([far, far**2, np.ones(far.size), x[at] / x[-1]], axis=1)
        weight = lines.weight[at]
        basis = np.linalg.qr(weight[:, None] * explained)[0]
        missing = -weight * missing
        missing = missing - basis @ (basis.conj().T @ missing)
        part = fit.participation[k] * lines.input
        shape = fit.shapes[:, k] * lines.response
        left = np.einsum("i,ifo,o->f", part.conj(), fit.known.rest[:, at], shape.conj())
        like += float(np.vdot(missing, left).real)
        power = (np.abs(part) ** 2).sum() * (np.abs(shape) ** 2).sum()
        size += float((np.abs(missing) ** 2).sum() * power)
    return like > limits.share * size > 0


def hann_note(before: Complex, after: Complex) -> str:
    """Says what the fading took for damping."""
    more = 100 * (before.real / after.real - 1)
    return (
        "the FRFs are of blocks of noise under a Hann window, which fades the responses out: "
        "taken into account, else "
        f"the damping would be {np.median(more):.2g} % too high at the typical mode, "
        f"{more.max():.2g} % at most"
    )
