"""Checks of FRFs: what cannot be identified is refused, what looks wrong becomes a note.

FRFs of noise in blocks under a Hann window are found by what a fit by poles leaves around narrow
modes (`lines.faded`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import lstsq

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet
from ringtrue.core.motions import POWER
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.identification.frf.lines import Lines, faded
from ringtrue.identification.frf.refinement import Refined
from ringtrue.identification.frf.residues import driving_pairs, line_coherence
from ringtrue.shapes.mac import mac, unit
from ringtrue.signal.frf_sets import passive

_USABLE = 0.5  # of coherence, or of the likeness of next lines
_NOISE = 0.6  # of that likeness, smoothed, that white noise of a single FRF does not reach
_TO_THE_END = 0.95
# fourth powers stay finite
_SMALL = 1e-70
_LARGE = 1e70
_ODD = 100.0  # times the level of the typical response
_COHERENT = 0.5
_UNMOVED = 0.5  # of the typical coherence
_EVEN = 1e-3  # of the step, that rounded lines differ by
# share of the power at a driving point of the wrong sign; what rings on between hits takes the rest
_TURNED = 0.3
_CURED = 0.3  # of the misfit of the residues may be left when one fault is undone
_MISFIT = 1e-3  # share of the residues that no single shape explains, and that calls for a reason
_CUT = 1.5  # lines in a half-power bandwidth: 1 % of the response is left at the end of the block
_POOR = 0.05  # of an FRF, that a fit of its modes leaves
# modes that tell a delay; how real a shape is without and with it
_MODES = 4
_REAL = 0.9
_DELAYED = 0.97
# ratio of two frequencies, overlap of shapes, MAC of participations
_SIDE = 1.05
_UNLIKE = 0.2
_ALIKE = 0.9
_LOOKS = 500  # lines that tell the typical coherence
_MOST_TRIALS = 400_000
_EVEN_LINES = 1e-3  # of the step of even lines
_MANY = 12.0  # lines in a bandwidth: one part in a hundred
_EXCESS = 1.34  # damping too much, times their square
# half bandwidths and lines around a mode that count
_BESIDE = 8.0
_LINES = 4
_HANN_SHARE = 0.3  # of what blocks under a Hann window would leave


def band_limits(frfs: FrfSet, fmin: float | None, fmax: float | None) -> tuple[float, float]:
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
    good = np.median(frfs.coherence, axis=(1, 2)) if known else line_coherence(frfs.data, f)
    usable = f[_smoothed(good) > _USABLE]
    return float(usable[-1] if usable.size else f[-1])


def _smoothed(line: Float) -> Float:
    wide = max(5, line.size // 50) | 1
    return np.convolve(np.pad(line, wide // 2, mode="edge"), np.ones(wide) / wide, "valid")


def refuse_noise(frfs: FrfSet) -> None:
    """Raise where no line is like its neighbours, for methods that find modes in noise too."""
    if _smoothed(line_coherence(frfs.data, frfs.freqs)).max() < _NOISE:
        ends = f"{frfs.freqs[0]:g} and {frfs.freqs[-1]:g} Hz"
        raise DataError(
            f"{frfs.source}: the FRFs are noise: between {ends} no line is like those beside it"
        )


def end_note(frfs: FrfSet, fmax: float | None, high: float) -> str:
    """Says that the band ends before the lines do."""
    if fmax is not None or high > _TO_THE_END * frfs.freqs[-1]:
        return ""
    return f"the band ends at {high:.4g} Hz: beyond, the FRFs are noise (--fmax for more)"


def lines_between(frfs: FrfSet, low: float, high: float) -> FrfSet:
    """The FRFs of a band, Hz, without the line at 0 Hz."""
    at = (frfs.freqs >= low) & (frfs.freqs <= high) & (frfs.freqs > 0)
    return replace(frfs, data=frfs.data[at], freqs=frfs.freqs[at], coherence=frfs.coherence[at])


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
    if not _SMALL < size.max() < _LARGE:
        raise DataError(f"{where}: the largest value is {size.max():.2g}; no unit makes that")
    flat: Bool = np.all(h == h[0], axis=0)
    for name, channels, axis in (("response", frfs.outputs, 1), ("reference", frfs.inputs, 0)):
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
    lost = np.asarray(np.any(zero.all(axis=1), axis=1))
    if lost.any():
        first, last = freqs[np.flatnonzero(lost)[[0, -1]]]
        raise DataError(
            f"{where}: FRF with gaps: {int(lost.sum())} lines between {first:g} and {last:g} Hz "
            "are zero; cut it there"
        )


def frf_notes(frfs: FrfSet, sound: Sequence[tuple[int, int, float]]) -> tuple[str, ...]:
    """What looks wrong before identification: odd levels, low coherence, driving points that are
    not `sound_pairs`.
    """
    out = []
    level = np.sqrt((np.abs(frfs.data) ** 2).mean(axis=(0, 2)))
    kinds = np.array([c.quantity for c in frfs.outputs])
    for k, c in enumerate(frfs.outputs):
        same = level[kinds == c.quantity]
        ratio = float(level[k] / max(np.median(same), 1e-300))
        if same.size > 2 and not 1 / _ODD < ratio < _ODD:
            out.append(f"response {c.id}: {ratio:.1e} of the typical level: unit or sensitivity?")
    if np.isfinite(frfs.coherence).any():
        typical = float(np.nanmedian(frfs.coherence[:: max(1, frfs.freqs.size // _LOOKS)]))
        if typical < _COHERENT:
            out.append(
                f"the coherence is {typical:.2f} at the typical line: most of these FRFs is noise"
            )
        out += _unmoved(frfs, typical)
    step = np.diff(frfs.freqs)
    if np.ptp(step) > _EVEN * np.median(step):
        wide = int(step.argmax())
        out.append(
            f"uneven lines: {step.min():.3g} to {step.max():.3g} Hz apart, widest between "
            f"{frfs.freqs[wide]:.5g} and "
            f"{frfs.freqs[wide + 1]:.5g} Hz"
        )
    if len(frfs.inputs) == 1:
        out.append("one reference: two modes of one and the same frequency show as one")
    if turned := [
        frfs.inputs[i].id for o, i, sign in driving_pairs(frfs) if (o, i, sign) not in sound
    ]:
        rest = "" if sound else ": the modes are not scaled"
        out.append(
            f"driving point {' '.join(turned)}: sensor or hammer is the other way round; not "
            f"used{rest}"
        )
    return tuple(out)


def _unmoved(frfs: FrfSet, typical: float) -> list[str]:
    """Responses whose coherence is far below that of the others: they do not follow the force."""
    some = frfs.coherence[:: max(1, frfs.freqs.size // _LOOKS)]
    with np.errstate(all="ignore"):
        of_each = np.array(
            [
                np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else np.nan
                for x in some.swapaxes(0, 1)
            ]
        )
    low = of_each < _UNMOVED * typical
    if not low.any() or typical <= _COHERENT:
        return []
    at = np.flatnonzero(low).tolist()
    names = " ".join(frfs.outputs[i].id for i in at)
    values = ", ".join(f"{of_each[i]:.2f}" for i in at)
    others = np.nanmedian(of_each[~low])
    return [
        f"channel {names}: coherence {values}, {others:.2f} of the others: does not move, has a "
        "loose cable or is dead"
    ]


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
    cut = [f"{f:.4g}" for f in modes.frequencies[width < _CUT]]
    if cut and np.isinf(frfs.kept) and not (frfs.sharp or frfs.hann):
        more = f" and {len(cut) - 6} more" if len(cut) > 6 else ""
        out.append(
            f"less than {_CUT:g} lines in the half-power bandwidth at {' '.join(cut[:6])} "
            f"Hz{more}: the blocks are "
            "short for these modes, and windows other than the exponential one raise their damping"
        )
    if np.isfinite(frfs.coherence).all():
        n = np.where(np.isfinite(frfs.averages), np.maximum(frfs.averages, 1), 1)
        g = np.clip(frfs.coherence, 1e-3, 1.0)
        power = np.abs(frfs.data) ** 2
        noise = np.sqrt(
            (power * (1 - g) / (n * g)).sum(axis=0) / np.maximum(power.sum(axis=0), 1e-300)
        )
        typical = float(np.median(error))
        due = float(np.median(noise))
        if typical > max(_POOR, 3 * due):
            blocks = " or" if frfs.sharp else ", short blocks or"
            out.append(
                f"the modes leave {100 * typical:.2g} % of the typical FRF, its coherence "
                f"explains {100 * due:.2g} %: "
                f"FRFs that disagree (mass of moved sensors, temperature){blocks} modes outside "
                "the band"
            )
    return tuple(out)


def parted_modes(model: ModalModel) -> str:
    """Finds batches that disagree where a mode of each explains them: side by side, driven equally,
    seen by others.

    Two bending directions are driven differently; with one reference nothing is said.
    """
    if model.participation.shape[1] < 2 or model.poles.size < _MODES:
        return ""
    order = np.argsort(model.frequencies)
    f = model.frequencies[order]
    shapes = np.abs(model.shapes[:, order])
    part = model.participation[order].T
    both = unit(shapes).T @ unit(shapes)
    split = (
        (f / f[:, None] > 1)
        & (f / f[:, None] < _SIDE)
        & (both < _UNLIKE)
        & (mac(part, part) > _ALIKE)
    )
    first, second = np.nonzero(split)
    if 2 * np.unique(first).size < 0.5 * f.size:
        return ""
    pairs = ", ".join(
        f"{f[i]:.5g} and {f[k]:.5g}" for i, k in zip(first[:3], second[:3], strict=True)
    )
    return (
        f"modes at {pairs} Hz are driven equally and seen by different responses: FRFs that "
        "disagree show each mode twice"
    )


def late_channels(modes: ModeSet) -> tuple[str, ...]:
    """Responses whose phase against all others falls with frequency from mode to mode: a delay.

    Of real shapes; a half period of the highest mode at most is looked for.
    """
    if len(modes) < _MODES:
        return ()
    omega = 2 * np.pi * modes.frequencies
    delay = np.linspace(-1, 1, 401) * np.pi / omega.max()
    size = np.abs(modes.shapes) / np.maximum(np.linalg.norm(modes.shapes, axis=0), 1e-300)
    weight = size**2 / np.maximum((size**2).sum(axis=1, keepdims=True), 1e-300)
    turned = np.exp(2j * np.angle(modes.shapes)) * weight
    # (channel, delay), 1 where all phases are 0 or 180°
    real = (turned @ np.exp(2j * omega[:, None] * delay)).real
    now = real[:, delay.size // 2]
    best = real.max(axis=1)
    seen = 1 / np.maximum((weight**2).sum(axis=1), 1e-300) > _MODES - 1  # modes that count
    late = (now < _REAL) & (best > _DELAYED) & seen & (np.median(now) > _DELAYED)
    return tuple(
        f"response {modes.channels[k]} looks {1e3 * abs(delay[real[k].argmax()]):.2g} ms "
        f"{'late' if real[k].argmax() > delay.size // 2 else 'early'}: its phase goes with the "
        "frequency"
        for k in np.flatnonzero(late).tolist()
    )


def sound_pairs(frfs: FrfSet) -> list[tuple[int, int, float]]:
    """(output, input, sign) of the driving points but for those that give power to the hammer:
    turned ones.
    """
    return [
        (o, i, sign) for o, i, sign in driving_pairs(frfs) if sign * passive(frfs, o, i) > -_TURNED
    ]


def residues(frfs: FrfSet, poles: Complex) -> Complex:
    """Residues (m, out, in) of each FRF by itself, with a lower and an upper residual: no shape is
    asked for.

    Parameters
    ----------
    frfs : FrfSet
    poles : (m,) complex128, rad/s
        Without the exponential window.
    """
    s = 2j * np.pi * frfs.freqs + frfs.window_decay
    near = (np.abs(s[:, None] - poles) < 12 * np.abs(poles.real)).any(axis=1) & (frfs.freqs > 0)
    s = s[near]
    h = frfs.data[near]
    kind = (s / np.abs(s[-1])) ** POWER[frfs.kind]
    one = kind[:, None] / (s[:, None] - poles)
    two = kind[:, None] / (s[:, None] - poles.conj())
    rest = kind[:, None] * np.stack([np.ones(s.size), (np.abs(s[0]) / s) ** 2], axis=1)
    a = np.concatenate([one + two, 1j * (one - two), rest], axis=1)
    scale = np.linalg.norm(a, axis=0)
    rhs = h.reshape(s.size, -1)
    a = np.concatenate([a.real, a.imag]).T / scale[:, None]
    x = lstsq(a @ a.T, a @ np.concatenate([rhs.real, rhs.imag]), cond=1e-13)[0]
    x /= scale[:, None]
    m = poles.size
    return np.asarray((x[:m] + 1j * x[m : 2 * m]).reshape(m, *h.shape[1:]))


def misfit(r: Complex) -> Float:
    """(...,) share of the squared residues `r` (..., out, in) that no single shape explains: rank
    one in each mode.
    """
    gram = r.conj().swapaxes(-1, -2) @ r
    values = np.linalg.eigvalsh(gram)
    return np.asarray(1 - values[..., -1] / np.maximum(values.sum(axis=-1), 1e-300))


def odd_channel(frfs: FrfSet, poles: Complex) -> str:
    """A response that one reference sees turned or exchanged with another, found from the rank of
    the residues.

    In a linear structure the residues of each mode are a shape times the participations, H_oi ~ ψ_o
    l_i. A channel turned or swapped while one reference was measured breaks that in all modes;
    undoing it must mend all of them. Empty if the residues fit, nothing single mends them, or there
    is one reference or mode only.
    """
    poles = _distinct(poles)
    n_out, n_in = frfs.data.shape[1:]
    if n_in < 2 or n_out < 3 or poles.size < 2 or n_in * n_out**2 * poles.size > _MOST_TRIALS:
        return ""
    r = residues(frfs, poles)
    r /= np.maximum(np.linalg.norm(r, axis=(1, 2), keepdims=True), 1e-300)
    now = float(misfit(r).mean())
    if now < _MISFIT:
        return ""
    ids = [c.id for c in frfs.inputs]
    under = ids if n_in > 2 else [" or ".join(ids)] * 2  # of two references none is the odd one
    best = now
    fault = ""
    for i in range(n_in):  # a handful of references
        turned = np.broadcast_to(r, (n_out, *r.shape)).copy()
        turned[np.arange(n_out), :, np.arange(n_out), i] *= -1
        value = misfit(turned).mean(axis=1)
        if value.min() < best:
            best = float(value.min())
            o = int(value.argmin())
            fault = f"response {frfs.outputs[o].id} looks turned under reference {under[i]}"
        for o in range(n_out - 1):
            other = np.arange(o + 1, n_out)
            swapped = np.broadcast_to(r, (other.size, *r.shape)).copy()
            swapped[:, :, o, i] = r[:, other, i].T
            swapped[np.arange(other.size), :, other, i] = r[:, o, i]
            value = misfit(swapped).mean(axis=1)
            if value.min() < best:
                best = float(value.min())
                p = int(other[value.argmin()])
                pair = f"{frfs.outputs[o].id} and {frfs.outputs[p].id}"
                fault = f"responses {pair} look swapped under reference {under[i]}"
    if best > _CURED * now:
        return ""
    return (
        f"{fault}: {100 * now:.2g} % of the residues fit no single shape, {100 * best:.2g} % "
        "if that is mended"
    )


def _distinct(poles: Complex) -> Complex:
    """One pole for those within half a bandwidth of each other: a fault splits modes in two."""
    out: list[complex] = []
    for p in poles[np.argsort(poles.imag)].tolist():
        if not out or abs(p - out[-1]) > abs(p.real):
            out.append(p)
    return np.array(out, dtype=np.complex128)


def block_of_noise(frfs: FrfSet) -> float:
    """Length, s, of the blocks that FRFs on even lines may be of; 0 where they are known to be of
    impacts, or sharp.
    """
    step = np.diff(frfs.freqs)
    even = float(np.ptp(step)) < _EVEN_LINES * float(step.mean())
    known = (
        frfs.sharp or frfs.impacts is not None or np.isfinite(frfs.kept) or frfs.window_decay > 0
    )
    return 0.0 if known or not even else 1 / float(step.mean())


def looks_faded(lines: Lines, fit: Refined, length: float) -> bool:
    """Whether what a fit by poles leaves around narrow modes is what it would leave of blocks of
    that length, s.

    A regression on that, per mode besides its residue, its pole and a smooth rest; 0 of FRFs
    without leakage, 1 with.
    """
    x = lines.s.imag
    half = -fit.poles.real
    count = half * length / np.pi  # lines in the half-power bandwidth
    like = 0.0
    size = 0.0
    for k in np.flatnonzero(count < _MANY).tolist():  # few lines each
        at = np.abs(x - fit.poles[k].imag) < _BESIDE * half[k] + _LINES * 2 * np.pi / length
        if np.count_nonzero(at) < 2 * _LINES:
            continue
        pole = complex(-half[k] / (1 + _EXCESS / count[k] ** 2), fit.poles[k].imag)
        weight = lines.weight[at]
        far = 1 / (lines.s[at] - fit.poles[k])
        there = (
            faded(lines.s[at], np.array([pole]), length)[0][:, 0]
            * pole**lines.order
            / (lines.s[at] - pole)
        )
        basis = np.linalg.qr(
            weight[:, None] * np.stack([far, far**2, np.ones(far.size), x[at] / x[-1]], axis=1)
        )[0]
        part = fit.participation[k] * lines.input
        shape = fit.shapes[:, k] * lines.response
        left = np.einsum("i,ifo,o->f", part.conj(), fit.known.rest[:, at], shape.conj())
        missing = -weight * there
        missing = missing - basis @ (basis.conj().T @ missing)
        like += float(np.vdot(missing, left).real)
        size += float(
            (np.abs(missing) ** 2).sum() * (np.abs(part) ** 2).sum() * (np.abs(shape) ** 2).sum()
        )
    return like > _HANN_SHARE * size > 0


def hann_note(before: Complex, after: Complex) -> str:
    """Says what the fading took for damping."""
    more = 100 * (before.real / after.real - 1)
    return (
        "the FRFs are of blocks of noise under a Hann window, which fades the responses out: "
        "taken into account, else "
        f"the damping would be {np.median(more):.2g} % too high at the typical mode, "
        f"{more.max():.2g} % at most"
    )
