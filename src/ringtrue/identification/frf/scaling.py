"""Unit modal mass by driving points, its uncertainty, and reciprocity.

An error that all responses to an impact share is an error of the participation factors and leaves
nothing in the fit: the noise on the force, known where there are records, and what else the
coherence shows. Where driving points disagree about the scale of a mode, an impact was skewed, a
sensor was not at the point, or a sensitivity is wrong. At points that are both excited and measured
H(a, b) must equal H(b, a): a calibration, a direction or a number that is wrong there breaks
reciprocity in all modes, which noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModalModel, Norm
from ringtrue.core.signals import FrfSet
from ringtrue.identification.frf.refinement import Refined
from ringtrue.identification.frf.residues import DrivingPoints, driving_pairs
from ringtrue.shapes import paired_mac


@dataclass(frozen=True, slots=True)
class ScaleLimits:
    """What makes a modal scale doubtful.

    Attributes
    ----------
    shared : float
        Times what the fit leaves that the coherence calls noise, where responses share it.
    deviations : float
        Standard deviations of a sum of squares, from which on driving points disagree.
    noted : float
        Share of the residues at the driving points, from which on this is noted.
    """

    shared: float = 3.0
    deviations: float = 3.0
    noted: float = 0.1


@dataclass(frozen=True, slots=True)
class ReciprocityLimits:
    """Median MAC of shapes and participations at points both excited and measured.

    Attributes
    ----------
    good, doubtful, poor : float
        Sound, possibly explained by one fault, and noted in any case.
    """

    good: float = 0.95
    doubtful: float = 0.9
    poor: float = 0.8


LIMITS = ScaleLimits()


def mode_scale(model: ModalModel) -> Complex:
    """(m,) factors to unit modal mass from unit modal A, or to a largest component of 1 from
    unscaled shapes.
    """
    largest = np.take_along_axis(
        model.shapes, np.abs(model.shapes).argmax(axis=0)[None], axis=0
    )[0]
    if model.norm is Norm.UNSCALED:
        return np.asarray(1 / largest)
    alpha = np.sqrt(2j * model.poles.imag)
    return np.asarray(np.where((largest * alpha).real < 0, -alpha, alpha))


def scale_deviations(
    frfs: FrfSet, fitted: Complex, fit: Refined, points: DrivingPoints
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
    points : DrivingPoints
    """
    if not points or not fit.poles.size:
        return np.zeros(fit.shapes.shape), ""
    weight = np.abs(fit.participation[:, points.input]) ** 2
    weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    shared = 0.25 * (weight**2 * _shared(frfs, fitted, fit.poles)[:, points.input]).sum(
        axis=1
    )
    disagreement, error = _disagreement(fit, points)
    noise = _of_the_force(frfs, fit.frequencies, weight, points)
    std = np.sqrt(shared + disagreement**2 + noise + _by_a_node(fit, points))
    return std, _note(frfs, points, error)


def _by_a_node(fit: Refined, points: DrivingPoints) -> Float:
    """(m,) relative variance of the scales that first order leaves out, as φ_o = R_oi/√R_ii where
    R_ii is poorly known.

    The upper end of the interval of φ, from the lower one of R_ii, gives the deviation.
    """
    psi, part, variance = _driven(fit, points)
    overlap = np.maximum(np.abs((part.conj() * psi).sum(axis=1)), 1e-300)
    known = np.sqrt(0.5 * (np.abs(part) ** 2 * variance).sum(axis=1)) / overlap
    upper = 1 / np.sqrt(np.maximum(1 - 1.96 * known, 1 / 9))
    return np.asarray(np.maximum(((upper - 1) / 1.96) ** 2 - (known / 2) ** 2, 0))


def _driven(fit: Refined, points: DrivingPoints) -> tuple[Complex, Complex, Float]:
    """Shapes and participations at the driving points (m, pair), and the variance of these shapes
    by noise.
    """
    variance = (fit.known.state.shape_var * fit.known.own)[points.output].T
    return points.shapes(fit.shapes).T, fit.participation[:, points.input], variance


def _of_the_force(
    frfs: FrfSet, frequencies: Float, weight: Float, points: DrivingPoints
) -> Float:
    """(out, m) relative variance of the shapes by the noise on the force of each impact, known from
    the records.

    φ_o is the mean of R_oi/φ_i over the driving points i, by their `weight` (m, pair), where R_ii =
    φ_i².
    """
    if frfs.impacts is None:
        return np.zeros((1, frequencies.size))
    of_all = frfs.impacts.weight
    share = (
        of_all[:, :, points.input]
        - 0.5 * of_all[:, points.output, points.input][:, None]
    )
    noise = frfs.impacts.noise_at(frequencies)
    return np.asarray((0.5 * noise[:, None] * (share @ weight.T) ** 2).sum(axis=0))


def _shared(frfs: FrfSet, fitted: Complex, poles: Complex) -> Float:
    """(m, in) relative variance of the real part of a residue by noise that all responses share."""
    n = np.where(np.isfinite(frfs.averages), frfs.averages, 1.0)
    out = np.zeros((poles.size, len(frfs.inputs)))
    if not np.isfinite(frfs.coherence).all() or (n < 2).all():
        return out
    far = np.abs(2 * np.pi * frfs.freqs[:, None] - poles.imag)
    near = far <= np.maximum(far.min(axis=0), np.abs(poles.real) + frfs.window_decay)
    explained = (
        frfs.impacts.scatter(poles) if frfs.impacts else np.zeros((poles.size, 1, 1))
    )
    for k, at in enumerate(near.T):  # a few dozen modes, each with its own lines
        g = np.clip(frfs.coherence[at], 1e-3, 1.0)
        power = np.abs(frfs.data[at]) ** 2
        size = np.maximum(power.sum(axis=0), 1e-300)
        due = (power * (1 - g) / g).sum(axis=0) / size / np.maximum(n - 1, 1)
        due = due - explained[k] / np.maximum(n - 1, 1)
        left = (np.abs(frfs.data[at] - fitted[at]) ** 2).sum(axis=0) / size
        due = np.median(due, axis=0)
        left = np.median(left, axis=0)
        out[k] = np.where(
            (due > LIMITS.shared * left) & (n > 1), 0.5 * (due - left), 0.0
        )
    return out


def _disagreement(fit: Refined, points: DrivingPoints) -> tuple[Float, float]:
    """Relative deviations (m,) of the scales by points that disagree, and their error over the size
    of a component.

    The error at a point is taken as independent from mode to mode and in proportion to the typical
    component there, as that of a skewed impact is.
    """
    psi, part, variance = _driven(fit, points)
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
    freedom = max(2 * psi.shape[0] * (len(points) - 1), 1)
    if len(points) < 2 or found < due * (1 + LIMITS.deviations * np.sqrt(2 / freedom)):
        return np.zeros(psi.shape[0]), 0.0
    error2 = float((found - due) / max(float((free * typical).sum()), 1e-300))
    total = np.maximum((size**2).sum(axis=1), 1e-300)
    return 0.5 * np.sqrt(error2 * (size**2 * typical).sum(axis=1)) / total, float(
        np.sqrt(error2)
    )


def _note(frfs: FrfSet, points: DrivingPoints, error: float) -> str:
    if error < LIMITS.noted:
        return ""
    ids = " ".join(dict.fromkeys(frfs.inputs[i].id for i in points.input))
    return (
        f"driving points {ids} disagree by {100 * error:.0f} % of their residues: a skewed impact, "
        "a sensor off the point or a sensitivity; the modal masses are that doubtful"
    )


def reciprocity_note(model: ModalModel, sound: DrivingPoints) -> str:
    """What breaks the reciprocity of the modes: references exchanged, or a wrong point; else empty.

    With three points and more the odd one is named. The FRFs of the points on themselves need not
    be among the data: the residues of rank one give them.

    Parameters
    ----------
    model : ModalModel
    sound : DrivingPoints
        Of `driving_pairs`, those where neither sensor nor hammer is known to be the other way
        round.
    """
    points = driving_pairs(model)
    names = [model.inputs[i].id for i in points.input]
    if len(names) < 2 or model.poles.size < 2:
        return ""
    limits = ReciprocityLimits()
    turned = np.where(np.isin(points.input, sound.input), 1.0, -1.0)
    psi = points.shapes(model.shapes) * turned[:, None]
    part = model.participation.T[points.input]
    now = _agreement(psi, part)
    if now > limits.doubtful:
        return ""
    best = now
    why = ""
    for a, b in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[a, b]] = b, a
        value = _agreement(psi, part[order])
        if value > best:
            best = value
            why = f"references {names[a]} and {names[b]} look exchanged"
    for k in range(len(names)) if len(names) > 2 and best < limits.good else ():
        rest = np.delete(np.arange(len(names)), k)
        value = _agreement(psi[rest], part[rest])
        if value > best:
            best = value
            why = f"{names[k]} was not excited where, or along what, its response reads"
    finding = (
        f"reciprocity: shapes and participations at {' '.join(names)} agree to "
        f"{100 * now:.0f} % only"
    )
    if best > limits.good:
        return f"{finding}, {100 * best:.0f} % without: {why}"
    if now < limits.poor:
        return (
            f"{finding}: a point or direction is wrong, or the structure is not linear"
        )
    return ""


def _agreement(psi: Complex, part: Complex) -> float:
    """The median: a mode that moves the points struck little has noise there."""
    return float(np.median(paired_mac(psi, part)))
