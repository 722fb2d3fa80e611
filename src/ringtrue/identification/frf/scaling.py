"""Unit modal mass by driving points, its uncertainty, and reciprocity.

An error that all responses to an impact share is an error of the participation factors and leaves
nothing in the fit: the noise on the force, known where there are records, and what else the
coherence shows. Where driving points disagree about the scale of a mode, an impact was skewed, a
sensor was not at the point, or a sensitivity is wrong. At points that are both excited and measured
H(a, b) must equal H(b, a): a calibration, a direction or a number that is wrong there breaks
reciprocity in all modes, which noise does not.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.special import stdtrit

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import Norm
from ringtrue.core.signals import FrfSet
from ringtrue.identification.frf.refinement import Refined
from ringtrue.identification.frf.residues import Pairs, driving_pairs
from ringtrue.shapes.mac import paired_mac

SHARED = 3.0  # times what the fit leaves is noise by the coherence, where responses share it
APART = 3.0  # standard deviations of a sum of squares
TOLD = 0.1  # of the residues at the driving points
SIDE = 1.96  # deviations to the end of an interval
LEAST = 1 / 9  # of a residue, that may be left there
# agreement that is sound, that one fault may explain, and that is reported in any case
_GOOD = 0.95
_DOUBTFUL = 0.9
_POOR = 0.8
_FACTOR = 0.1  # of a calibration, from which on it is reported
_CHANCE = 3e-4  # that a factor of a sound point is reported: its deviation rests on few modes


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
    """Relative standard deviations (out, m) of the shapes, besides that of their residues, and a
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
    disagreement, error = _apart(fit, pairs)
    noise = _of_the_force(frfs, fit.poles, weight=weight, o=o, i=i)
    return np.sqrt(shared + disagreement**2 + noise + _by_a_node(fit, pairs)), _note(
        frfs, pairs, error
    )


def _by_a_node(fit: Refined, pairs: Pairs) -> Float:
    """(m,) relative variance of the scales that first order leaves out, as φ_o = R_oi/√R_ii where
    R_ii is poorly known.

    The upper end of the interval of φ, from the lower one of R_ii, gives the deviation.
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
        due = np.median(due, axis=0)
        left = np.median(left, axis=0)
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
    # of unit modal mass
    unit = np.sqrt(np.abs(fit.poles) / np.maximum(np.abs(ratio), 1e-300))[:, None]
    rest = unit * (psi - ratio[:, None] * part)
    size = unit * np.abs(ratio[:, None] * part)
    noise = unit**2 * variance
    free = 1 - np.abs(part) ** 2 / square[:, None]
    typical = (size**2).mean(axis=0)
    found = (np.abs(rest) ** 2).sum()
    due = (free * noise).sum()
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


def reciprocity(model: ModalModel) -> Float:
    """(m,) MAC between shape and participation vector at the points that were both hit and
    measured.

    1 for a reciprocal structure with sound directions and calibrations; NaN with fewer than two
    such points. The FRFs of the points on themselves need not be among the data: the residues of
    rank one give them.
    """
    psi, part, names = _at_both(model)
    return paired_mac(psi, part) if len(names) > 1 else np.full(model.poles.size, np.nan)


def calibrations(model: ModalModel) -> tuple[Float, Float]:
    """What the response at each point struck reads over what the others do for the same force, and
    its deviation.

    The residues of mode m are ψ_o l_i, and in a reciprocal structure |ψ_o| = c_m d_o |l_o|, where
    d_o is the factor by which response and force at o are mis-scaled. Least squares of the
    logarithms over all modes, each weighed by how far its residue at the point itself stands out.

    Parameters
    ----------
    model : ModalModel
        At least two points both struck and measured, and two modes.

    Returns
    -------
    factor : (p,) float64
        d_o over the median of the points, in the order of `driving_pairs`.
    std : (p,) float64
        Of its logarithm, from the scatter over the modes.
    """
    psi, part, _ = _at_both(model)
    return _factors(psi, part)


def _factors(psi: Complex, part: Complex) -> tuple[Float, Float]:
    """`calibrations` by shapes and participations (p, m)."""
    own = np.abs(psi * part)
    # the noise of a logarithm falls as its number grows
    weight = np.sqrt(own / np.maximum(own.max(axis=0), 1e-300))
    ratio = np.log(np.maximum(np.abs(psi), 1e-300) / np.maximum(np.abs(part), 1e-300))
    p, m = ratio.shape
    rows = np.concatenate([np.repeat(np.eye(p), m, axis=0), np.tile(np.eye(m), (p, 1))], axis=1)
    # of least norm: the points sum to the modes' mean
    inverse = np.linalg.pinv(rows * weight.reshape(-1, 1))
    x = inverse @ (weight * ratio).ravel()
    left = weight.ravel() * (ratio.ravel() - rows @ x)
    variance = (left**2).sum() / max((p - 1) * (m - 1), 1)
    to_median = np.eye(p) - np.eye(p)[np.argsort(x[:p])[[(p - 1) // 2, p // 2]]].mean(axis=0)
    spread = np.sqrt(variance * ((to_median @ inverse[:p]) ** 2).sum(axis=1))
    return np.exp(to_median @ x[:p]), spread


def reciprocity_note(model: ModalModel, sound: Pairs) -> str:
    """What breaks the reciprocity of the modes: references exchanged, a point wrong, a calibration;
    else empty.

    With three points and more the odd one is named, with two the pair.

    Parameters
    ----------
    model : ModalModel
    sound : sequence of (output, input, sign)
        Of `driving_pairs`, those where neither sensor nor hammer is known to be the other way
        round.
    """
    psi, part, names = _at_both(model)
    if len(names) < 2 or model.poles.size < 2:
        return ""
    used = {i for _, i, _ in sound}
    psi = psi * np.where([i in used for _, i, _ in driving_pairs(model)], 1.0, -1.0)[:, None]
    factor, std = _factors(psi, part)
    if _agreement(psi / factor[:, None], part) > _GOOD:
        quantile = float(stdtrit((len(names) - 1) * (model.poles.size - 1), 1 - _CHANCE / 2))
        return _miscalibrated(names, factor, quantile * std)
    return _mislaid(psi, part, names)


def _miscalibrated(names: list[str], factor: Float, doubt: Float) -> str:
    """Factors beyond `doubt` of their logarithms."""
    off = np.abs(np.log(factor))
    low = factor.argmin()
    high = factor.argmax()
    if len(names) == 2:  # their median lies between them
        off = 2 * off
        doubt = 2 * doubt
    odd = np.flatnonzero((off > np.log1p(_FACTOR)) & (off > doubt))
    if not odd.size:
        return ""
    if len(names) == 2:
        finding = (
            f"{factor[high] / factor[low]:.3g} times that at {names[low]} at {names[high]}: "
            "one sensitivity is wrong"
        )
    else:
        each = ", ".join(f"{factor[k]:.3g} times at {names[k]}" for k in odd.tolist())
        finding = f"{each} of what it is at the other points struck: a wrong sensitivity"
    return f"reciprocity: response over force is, in all modes, {finding}"


def _mislaid(psi: Complex, part: Complex, names: list[str]) -> str:
    """References that are exchanged, or one that was not struck where it says."""
    best = now = _agreement(psi, part)
    if now > _DOUBTFUL:
        return ""
    why = ""
    for a, b in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[a, b]] = b, a
        if (value := _agreement(psi, part[order])) > best:
            best = value
            why = f"references {names[a]} and {names[b]} look exchanged"
    for k in range(len(names)) if len(names) > 2 and best < _GOOD else ():
        rest = np.delete(np.arange(len(names)), k)
        if (value := _agreement(psi[rest], part[rest])) > best:
            best = value
            why = f"{names[k]} was not struck where, or along what, its response reads"
    finding = (
        f"reciprocity: shapes and participations at {' '.join(names)} agree to "
        f"{100 * now:.0f} % only"
    )
    if best > _GOOD:
        return f"{finding}, {100 * best:.0f} % without: {why}"
    return (
        f"{finding}: a point or direction is wrong, or the structure is not linear"
        if now < _POOR
        else ""
    )


def _at_both(model: ModalModel) -> tuple[Complex, Complex, list[str]]:
    """Shapes and participations (p, m) at the points both struck and measured, along the response,
    and their names.
    """
    pairs = driving_pairs(model)
    o, i = ([int(p[k]) for p in pairs] for k in (0, 1))
    sign = np.array([p[2] for p in pairs]).reshape(-1, 1)
    return model.shapes[o] * sign, model.participation.T[i], [model.inputs[k].id for k in i]


def _agreement(psi: Complex, part: Complex) -> float:
    """The median: a mode that moves the points struck little has noise there."""
    return float(np.median(paired_mac(psi, part)))
