"""Unit modal mass by driving points, and how well these tell it: what the fit of the FRFs alone
cannot see.

An error that all responses to an impact share is an error of the participation factors and leaves
nothing in the fit: the noise on the force, known where there are records, and what else the
coherence tells. Where points disagree about the scale of a mode, an impact was skewed, a sensor
stood beside the point, or a sensitivity is wrong.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import Norm
from ringtrue.core.signals import FrfSet
from ringtrue.identification.lsfd import Pairs
from ringtrue.identification.refine import Refined

SHARED = 3.0  # times what the fit leaves is noise by the coherence, where responses share it
APART = 3.0  # standard deviations of a sum of squares
TOLD = 0.1  # of the residues at the driving points
SIDE, LEAST = (
    1.96,
    1 / 9,
)  # deviations to the end of an interval; of a residue, that may be left there


def mode_scale(model: ModalModel) -> Complex:
    """(m,) factors to unit modal mass from unit modal A, or to a largest component of 1 from
    unscaled shapes.
    """
    largest = np.take_along_axis(model.shapes, np.abs(model.shapes).argmax(axis=0)[None], axis=0)[0]
    if model.norm is Norm.UNSCALED:
        return np.asarray(1 / largest)
    alpha = np.sqrt(2j * model.poles.imag)
    return np.asarray(np.where((largest * alpha).real < 0, -alpha, alpha))


def scale_deviations(
    frfs: FrfSet, fitted: Complex, fit: Refined, pairs: Pairs
) -> tuple[Float, str]:
    """Relative standard deviations (out, m) of the shapes, beside that of their residues, and a
    note.

    Parameters
    ----------
    frfs : FrfSet
        The lines of the fit.
    fitted : (f, out, in) complex128
        The FRFs of the fit.
    fit : Refined
    pairs : sequence of (output, input, sign)
        Driving points.
    """
    if not pairs or not fit.poles.size:
        return np.zeros(fit.shapes.shape), ""
    o, i, _ = (np.array(x) for x in zip(*pairs, strict=True))
    weight = np.abs(fit.participation[:, i]) ** 2
    weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    shared = 0.25 * (weight**2 * _shared(frfs, fitted, fit.poles)[:, i]).sum(axis=1)
    apart, error = _apart(fit, pairs)
    noise = _of_the_force(frfs, fit.poles, weight, o, i)
    return np.sqrt(shared + apart**2 + noise + _by_a_node(fit, pairs)), _note(frfs, pairs, error)


def _by_a_node(fit: Refined, pairs: Pairs) -> Float:
    """(m,) relative variance of the scales that first order leaves out, as φ_o = R_oi/√R_ii where
    R_ii is hardly known.

    The upper end of the interval of φ, from the lower one of R_ii, tells the deviation.
    """
    psi, part, variance = _driven(fit, pairs)
    overlap = np.maximum(np.abs((part.conj() * psi).sum(axis=1)), 1e-300)
    known = np.sqrt(0.5 * (np.abs(part) ** 2 * variance).sum(axis=1)) / overlap
    upper = 1 / np.sqrt(np.maximum(1 - SIDE * known, LEAST))
    return np.asarray(np.maximum(((upper - 1) / SIDE) ** 2 - (known / 2) ** 2, 0))


def _driven(fit: Refined, pairs: Pairs) -> tuple[Complex, Complex, Float]:
    """Shapes and participations at the driving points (m, pair), and the variance of these shapes
    by noise.
    """
    o, i, sign = (np.array(x) for x in zip(*pairs, strict=True))
    variance = (fit.known.state.shape_var * fit.known.own)[o].T
    return (fit.shapes[o] * sign[:, None]).T, fit.participation[:, i], variance


def _of_the_force(frfs: FrfSet, poles: Complex, weight: Float, o: Int, i: Int) -> Float:
    """(out, m) relative variance of the shapes by the noise on the force of each impact, known from
    the records.

    φ_o is the mean of R_oi/φ_i over the driving points i, by their `weight` (m, pair), where R_ii =
    φ_i².
    """
    if frfs.impacts is None:
        return np.zeros((1, poles.size))
    share = frfs.impacts.weight[:, :, i] - 0.5 * frfs.impacts.weight[:, o, i][:, None]
    noise = frfs.impacts.noise_at(np.abs(poles) / (2 * np.pi))
    return np.asarray((0.5 * noise[:, None] * (share @ weight.T) ** 2).sum(axis=0))


def _shared(frfs: FrfSet, fitted: Complex, poles: Complex) -> Float:
    """(m, in) relative variance of the real part of a residue by noise that all responses share."""
    n = np.where(np.isfinite(frfs.averages), frfs.averages, 1.0)
    out = np.zeros((poles.size, len(frfs.inputs)))
    if not np.isfinite(frfs.coherence).all() or (n < 2).all():
        return out
    far = np.abs(2 * np.pi * frfs.freqs[:, None] - poles.imag)
    near = far <= np.maximum(far.min(axis=0), np.abs(poles.real) + frfs.window_decay)
    explained = frfs.impacts.scatter(poles) if frfs.impacts else np.zeros((poles.size, 1, 1))
    for k, at in enumerate(near.T):  # a few dozen modes, each with its own lines
        g = np.clip(frfs.coherence[at], 1e-3, 1.0)
        power = np.abs(frfs.data[at]) ** 2
        size = np.maximum(power.sum(axis=0), 1e-300)
        due = (power * (1 - g) / g).sum(axis=0) / size / np.maximum(n - 1, 1)
        due = due - explained[k] / np.maximum(n - 1, 1)
        left = (np.abs(frfs.data[at] - fitted[at]) ** 2).sum(axis=0) / size
        due, left = np.median(due, axis=0), np.median(left, axis=0)
        out[k] = np.where((due > SHARED * left) & (n > 1), 0.5 * (due - left), 0.0)
    return out


def _apart(fit: Refined, pairs: Pairs) -> tuple[Float, float]:
    """Relative deviations (m,) of the scales by points that disagree, and their error over the size
    of a component.

    The error at a point is taken as independent from mode to mode and in proportion to the typical
    component there, as that of a skewed impact is.
    """
    psi, part, variance = _driven(fit, pairs)
    square = np.maximum((np.abs(part) ** 2).sum(axis=1), 1e-300)
    ratio = (part.conj() * psi).sum(axis=1) / square
    unit = np.sqrt(np.abs(fit.poles) / np.maximum(np.abs(ratio), 1e-300))[
        :, None
    ]  # of unit modal mass
    rest, size = unit * (psi - ratio[:, None] * part), unit * np.abs(ratio[:, None] * part)
    noise = unit**2 * variance
    free = 1 - np.abs(part) ** 2 / square[:, None]
    typical = (size**2).mean(axis=0)
    found, due = (np.abs(rest) ** 2).sum(), (free * noise).sum()
    freedom = max(2 * psi.shape[0] * (len(pairs) - 1), 1)
    if len(pairs) < 2 or found < due * (1 + APART * np.sqrt(2 / freedom)):
        return np.zeros(psi.shape[0]), 0.0
    error2 = float((found - due) / max(float((free * typical).sum()), 1e-300))
    total = np.maximum((size**2).sum(axis=1), 1e-300)
    return 0.5 * np.sqrt(error2 * (size**2 * typical).sum(axis=1)) / total, float(np.sqrt(error2))


def _note(frfs: FrfSet, pairs: Pairs, error: float) -> str:
    if error < TOLD:
        return ""
    ids = " ".join(dict.fromkeys(frfs.inputs[i].id for _, i, _ in pairs))
    return (
        f"driving points {ids} disagree by {100 * error:.0f} % of their residues: a skewed impact, "
        "a sensor beside the "
        "point or a sensitivity; the modal masses are that doubtful"
    )
