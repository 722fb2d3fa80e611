"""Reciprocity at the points that were both struck and measured: H(a, b) must equal H(b, a).

A calibration, a direction or a number that is wrong at such a point breaks it in all modes alike,
which noise does not.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.special import stdtrit

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.identification.lsfd import Pairs, driving_pairs
from ringtrue.shapes.mac import paired_mac

_GOOD, _DOUBTFUL, _POOR = (
    0.95,
    0.9,
    0.8,
)  # agreement that is sound, that one fault may explain, and that is told anyhow
_FACTOR = 0.1  # of a calibration, from which on it is told
_CHANCE = 3e-4  # that a factor of a sound point is told: its deviation rests on few modes


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
    how sure that is.

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
    weight = np.sqrt(
        own / np.maximum(own.max(axis=0), 1e-300)
    )  # the noise of a logarithm falls as its number grows
    ratio = np.log(np.maximum(np.abs(psi), 1e-300) / np.maximum(np.abs(part), 1e-300))
    p, m = ratio.shape
    rows = np.concatenate([np.repeat(np.eye(p), m, axis=0), np.tile(np.eye(m), (p, 1))], axis=1)
    inverse = np.linalg.pinv(
        rows * weight.reshape(-1, 1)
    )  # of least norm: the points sum to the modes' mean
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
        sure = float(stdtrit((len(names) - 1) * (model.poles.size - 1), 1 - _CHANCE / 2))
        return _miscalibrated(names, factor, sure * std)
    return _mislaid(psi, part, names)


def _miscalibrated(names: list[str], factor: Float, doubt: Float) -> str:
    """Factors beyond `doubt` of their logarithms."""
    off = np.abs(np.log(factor))
    low, high = factor.argmin(), factor.argmax()
    if len(names) == 2:  # their median lies between them
        off, doubt = 2 * off, 2 * doubt
    odd = np.flatnonzero((off > np.log1p(_FACTOR)) & (off > doubt))
    if not odd.size:
        return ""
    if len(names) == 2:
        told = (
            f"{factor[high] / factor[low]:.3g} times that at {names[low]} at {names[high]}: "
            "one sensitivity is wrong"
        )
    else:
        each = ", ".join(f"{factor[k]:.3g} times at {names[k]}" for k in odd.tolist())
        told = f"{each} of what it is at the other points struck: a wrong sensitivity"
    return f"reciprocity: response over force is, in all modes, {told}"


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
            best, why = value, f"references {names[a]} and {names[b]} look exchanged"
    for k in range(len(names)) if len(names) > 2 and best < _GOOD else ():
        rest = np.delete(np.arange(len(names)), k)
        if (value := _agreement(psi[rest], part[rest])) > best:
            best, why = value, f"{names[k]} was not struck where, or along what, its response reads"
    told = (
        f"reciprocity: shapes and participations at {' '.join(names)} agree to "
        f"{100 * now:.0f} % only"
    )
    if best > _GOOD:
        return f"{told}, {100 * best:.0f} % without: {why}"
    return (
        f"{told}: a point or direction is wrong, or the structure is not linear"
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
    """The median: a mode that hardly moves the points struck has noise there."""
    return float(np.median(paired_mac(psi, part)))
