"""Confidence of the candidate modes of all bands, and the selection of those to report.

Candidates that are no modes: lines of machines and peaks of the force.

People, waves and machines of unsteady speed have spectra with peaks. A linear structure answers
them with the modes that it has, so the operating deflection shape lies in the span of theirs. The
shape of another mode does not, where the sensors separate the modes. Dependence has no direction,
so modes are accepted one by one, the best known first: a resonance under noise is known as well as
its bandwidth and the length of the record allow. A peak of the force is wider, wanders, or is far
sharper than the modes (a crowd that jumps to music now and then).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, expit, ndtri

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.modes import Uncertainty
from ringtrue.core.notes import Note, sentence, summary
from ringtrue.core.signals import FALSE_ALARM
from ringtrue.identification.ambient.spectral_bins import CandidateModes
from ringtrue.identification.common import uncertainty as var
from ringtrue.identification.common.stabilisation import StableDiagram, least_deviations
from ringtrue.shapes import mpc
from ringtrue.signal import channel_checks
from ringtrue.signal.tonal_lines import SEARCH as LINES
from ringtrue.signal.tonal_lines import Harmonic

Row = tuple[int, int]  # a band, and a row of its table


@dataclass(frozen=True, slots=True)
class EvidenceWeights:
    """Weights of the evidence in the log-odds that a candidate is a mode of the structure.

    Of a logistic regression on the candidates of simulated records whose modes are known;
    `bench/confidence.py` shows on others how often modes of a stated confidence are real.

    Attributes
    ----------
    constant : float
    orders : float
        Of the logarithm of the share of the orders that show it.
    scatter : float
        Of the logarithm of the standard deviation of its damping over the least that a record of
        this length allows (Gersch 1974): the scatter over the blocks of the record.
    complexity : float
        Of the logarithm of 1.02 less the modal phase collinearity.
    peak : float
        Of the inverse hyperbolic sine of its likelihood gain.
    estimators : float
        Of the mean logarithm of the shares of the orders of SSI-data and pLSCF that show it.
    """

    constant: float = -0.57
    orders: float = 2.2
    scatter: float = -1.8
    complexity: float = -0.81
    peak: float = 0.3
    estimators: float = 0.3


@dataclass(frozen=True, slots=True)
class ConfidenceLimits:
    """What the confidence of candidates means, and when a band needs more orders.

    Attributes
    ----------
    mixing : float
        Sums of half bandwidths between modes whose estimates mix.
    same : float
        MAC of shapes that may be those of one mode.
    doubtful : float
        Confidence below which a candidate is not mentioned.
    forced : float
        Times the modes near it that a peak of the force is wider and less known, or times sharper.
    """

    mixing: float = 8.0
    same: float = 0.8
    doubtful: float = 0.1
    forced: float = 3.5

    @property
    def certain(self) -> float:
        """Confidence above which a candidate is a mode beyond doubt."""
        return 1 - self.doubtful


WEIGHTS = EvidenceWeights()
LIMITS = ConfidenceLimits()
DOUBTS = (
    "candidate orders",
    "candidate scatter",
    "candidate complex",
    "candidate peak",
    "candidate estimators",
)


@dataclass(frozen=True, slots=True, eq=False)
class BandModes:
    """Candidates of one band with shapes in the channels' units.

    Attributes
    ----------
    table : CandidateModes
    shape : (ch, m) complex128
    shape_std : (ch, m) float64
    evidence : (5, m) float64
        Log-odds by the orders, the scatter, the complexity and the peak of each candidate, and by
        other estimators.
    diagram : StableDiagram
    picked : (m,) int64
        The pick by hand behind each candidate, -1 for none.
    inseparable : tuple of int
        Rows of pairs that the record does not separate.
    wander : (m,) float64
        Relative standard deviation of the frequency along the record, 0 where it does not wander.
    """

    table: CandidateModes
    shape: Complex
    shape_std: Float
    evidence: Float
    diagram: StableDiagram
    picked: Int
    inseparable: tuple[int, ...]
    wander: Float

    @property
    def confidence(self) -> Float:
        """(m,) probability that each candidate is a mode of the structure."""
        return probability(self.evidence)

    def automatic(self, least: float) -> Int:
        """Rows of `least` confidence that no pick stands behind."""
        return np.flatnonzero((self.confidence >= least) & (self.picked < 0))


def confidence(c: CandidateModes, duration: float) -> Float:
    """(m,) probability that each candidate is a mode of the structure.

    Of what scatters as modes under random forces do; machines and peaks of the force are recognised
    by other evidence.

    Parameters
    ----------
    c : CandidateModes
    duration : float, s
        Of the record.
    """
    return probability(evidence(c, duration))


def probability(value: Float) -> Float:
    """(m,) probabilities of the evidence `value` (evidence, m)."""
    return np.asarray(expit(WEIGHTS.constant + value.sum(axis=0)))


def evidence(c: CandidateModes, duration: float) -> Float:
    """(5, m) log-odds by the orders, the scatter, the complexity and the peak of each candidate,
    and by other estimators.
    """
    _, std = c.stds()
    _, least = least_deviations(c.frequencies, c.damping, duration)
    share = c.orders[:, 0] / np.maximum(c.orders[:, 1], 1)
    return np.stack(
        [
            WEIGHTS.orders * np.log(np.maximum(share, 1e-9)),
            WEIGHTS.scatter * np.log(std / least),
            WEIGHTS.complexity * np.log(1.02 - collinearity_among(c)),
            WEIGHTS.peak * np.arcsinh(c.gain),
            WEIGHTS.estimators * np.nan_to_num(np.log(c.agreement)).mean(axis=1),
        ]
    )


def collinearity_among(c: CandidateModes) -> Float:
    """(m,) modal phase collinearity of what no mixture with close modes explains.

    The estimate of one of two close modes holds a little of the other, with any phase: its
    imaginary part then lies along the real part of the other, and that share of it is no complexity
    of the mode.
    """
    size = np.linalg.norm(c.shape, axis=0)
    phase = np.angle((c.shape**2).sum(axis=0)) / 2
    psi = c.shape * np.exp(-1j * phase) / np.where(size > 0, size, 1.0)
    f = c.frequencies
    half = f * c.damping
    close = np.abs(f[:, None] - f) < LIMITS.mixing * (half[:, None] + half)
    np.fill_diagonal(close, False)
    most = len(psi) // 3  # of many shapes a sum explains anything
    out = np.array(c.mpc)
    for i in np.flatnonzero(close.any(axis=1)).tolist():
        near = np.flatnonzero(close[i])
        near = near[np.argsort(np.abs(f[near] - f[i]), kind="stable")][:most]
        own = psi[:, i].real
        others = psi[:, near].real
        others = others - np.outer(own, own @ others) / (own @ own)
        basis = np.linalg.qr(others)[0]
        left = psi[:, i].imag - basis @ (basis.T @ psi[:, i].imag)
        out[i] = mpc((own + 1j * left)[:, None])[0]
    return out


def weakest(value: Float) -> tuple[str, ...]:
    """For each candidate the code of the note on which evidence, of `value` (5, m), speaks most
    against it.
    """
    clear = (
        0.0,
        0.0,
        WEIGHTS.complexity * np.log(0.02),
        WEIGHTS.peak * np.arcsinh(20.0),
        0.0,
    )
    return tuple(DOUBTS[k] for k in (value - np.array(clear)[:, None]).argmin(axis=0))


def all_clear(c: CandidateModes, duration: float) -> bool:
    """Whether each possible mode is shown by most orders and beyond doubt, but for what other
    estimators say: more orders do not change that.
    """
    conf = probability(evidence(c, duration)[:-1])
    rare = c.orders[:, 0] < 0.6 * c.orders[:, 1]
    open_ = (conf > LIMITS.doubtful) & ((conf < LIMITS.certain) | rare)
    return not open_.any()


def crowded(c: CandidateModes, duration: float, largest: int) -> bool:
    """Whether possible modes take more than half of the largest order, two states each: most orders
    would not show the last one.
    """
    possible = confidence(c, duration) > LIMITS.doubtful
    return bool(4 * possible.sum() > largest)


@dataclass(frozen=True, slots=True, eq=False)
class ListedCandidates:
    """Candidates of several bands in one list.

    Attributes
    ----------
    frequency, damping : (m,) float64, Hz and fraction of critical
    std_frequency, std_damping : (m,) float64
    confidence : (m,) float64
    shape : (ch, m) complex128
    """

    frequency: Float
    damping: Float
    std_frequency: Float
    std_damping: Float
    confidence: Float
    shape: Complex


def listed(found: list[BandModes], rows: list[Row]) -> ListedCandidates:
    """The candidates of some rows, in their order."""
    first = np.cumsum([0] + [x.table.pole.size for x in found])
    at = np.array([first[b] + i for b, i in rows], dtype=np.int64)
    stds = [x.table.stds() for x in found]
    return ListedCandidates(
        frequency=np.concatenate([x.table.frequencies for x in found])[at],
        damping=np.concatenate([x.table.damping for x in found])[at],
        std_frequency=np.concatenate([s for s, _ in stds])[at],
        std_damping=np.concatenate([s for _, s in stds])[at],
        confidence=np.concatenate([x.confidence for x in found])[at],
        shape=np.take(np.concatenate([x.shape for x in found], axis=1), at, axis=1),
    )


def select(found: list[BandModes], least: float) -> list[Row]:
    """Candidates of `least` confidence, each once, ascending in frequency.

    The best come first. One whose shape is that of a better one near it, or a sum of those of the
    better ones on both sides, is none of its own.
    """
    rows = [(b, i) for b, x in enumerate(found) for i in x.automatic(least).tolist()]
    if not rows:
        return []
    c = listed(found, rows)
    f = c.frequency
    sf = c.std_frequency
    conf = c.confidence
    band = np.array([b for b, _ in rows])
    half = c.damping * f
    widths = half[:, None] + half
    near = np.abs(f[:, None] - f) < np.maximum(4 * np.hypot(sf[:, None], sf), widths)
    psi = c.shape / np.linalg.norm(c.shape, axis=0)
    most = max(len(psi) // 4, 1)  # of many shapes a sum explains anything
    keep: list[int] = []
    for k in np.lexsort((sf / f, -conf.round(1))).tolist():
        better = np.array([j for j in keep if near[k, j]], dtype=np.int64)
        better = better[np.argsort(np.abs(f[better] - f[k]), kind="stable")][:most]
        # two clusters of one band beyond doubt must be more similar to be one mode
        certain = (band[better] == band[k]) & (conf[better] > LIMITS.certain)
        limit = 0.95 if conf[k] > LIMITS.certain and certain.all() else LIMITS.same
        basis = np.linalg.qr(psi[:, better])[0]
        if np.linalg.norm(basis.conj().T @ psi[:, k]) ** 2 < limit:
            keep.append(k)
    return [rows[k] for k in sorted(keep, key=lambda k: float(f[k]))]


def reason(found: BandModes, i: int) -> str:
    """The evidence for one candidate."""
    c = found.table
    sf, sz = c.stds()
    n, tried = c.orders[i].tolist()
    parts = [
        f"found at {n} of {tried} orders, std {100 * sf[i] / c.frequencies[i]:.2g} % of frequency "
        f"and {100 * sz[i] / c.damping[i]:.2g} % of damping, MPC {mpc(found.shape[:, [i]])[0]:.2f}"
    ]
    projection, spectra = 100 * c.agreement[i]
    if np.isfinite(projection):
        parts.append(
            f"SSI-data shows it at {projection:.0f} % of its orders, pLSCF at {spectra:.0f} %"
        )
    if c.refined[i]:
        parts.append("refined by maximum likelihood")
    return "; ".join((*parts, *map(sentence, remarks(found, i))))


def remarks(found: BandModes, i: int) -> tuple[Note, ...]:
    """What is particular of a mode."""
    c = found.table
    subject = f"{c.frequencies[i]:.5g} Hz"
    out = []
    if i in found.inseparable:
        out.append(Note("mode pair", "information", subject))
    if found.wander[i]:
        wander = {"wander": float(100 * found.wander[i])}
        out.append(Note("mode wanders", "information", subject, wander))
    return tuple(out)


def doubts(found: BandModes, i: int) -> Note:
    """What speaks most against a candidate."""
    c = found.table
    _, std = c.stds()
    return Note(
        weakest(found.evidence)[i],
        "warning",
        f"{c.frequencies[i]:.5g} Hz",
        {
            "orders": int(c.orders[i, 0]),
            "tried": int(c.orders[i, 1]),
            "scatter": float(100 * std[i] / c.damping[i]),
            "mpc": float(c.mpc[i]),
            "projection": float(100 * c.agreement[i, 0]),
            "spectra": float(100 * c.agreement[i, 1]),
        },
    )


def in_short(found: BandModes, i: int) -> str:
    """The remark of a mode in six words; empty for one beyond doubt."""
    own = remarks(found, i)
    if not own and found.confidence[i] < LIMITS.certain:
        own = (doubts(found, i),)
    return summary(own[0]) if own else ""


def uncertainty(found: list[BandModes], at: list[Row], channels: int) -> Uncertainty:
    """Standard deviations and covariance factor; modes of different bands are independent."""
    m = len(at)
    shape = np.empty((channels, m))
    blocks = np.cumsum([0] + [x.table.deviation.shape[1] for x in found])
    factor = np.zeros((int(blocks[-1]), 2 * m))
    for k, (b, i) in enumerate(at):
        shape[:, k] = found[b].shape_std[:, i]
        df, dz = var.frequency_damping(
            found[b].table.pole[[i]], found[b].table.deviation[[i]]
        )
        own = slice(blocks[b], blocks[b + 1])
        factor[own, k] = df[0]
        factor[own, m + k] = dz[0]
    size = np.sqrt((factor**2).sum(0))
    return Uncertainty(size[:m], size[m:], shape, factor)


def machine(
    f: float, zeta: float, lines: tuple[Harmonic, ...], duration: float
) -> Harmonic | None:
    """The line that a pole stands on, if its width is no more than that of a line.

    The window of the spectra shows a line at half of its resolution to each side. A pole farther
    away than that, and than its own half bandwidth, is another one. Within few cycles the amplitude
    of a mode is steady too: the logarithm of its fourth moment, 2, scatters by 1/sqrt(2π ζ f T). A
    pole with a width is a line only where that of the line is far below.
    """
    # main lobe of the window of `harmonics` in 120 half-overlapped segments
    resolution = 61 * 4 / duration
    cycles = 2 * np.pi * zeta * f * duration
    scatter = -ndtri(FALSE_ALARM) / np.sqrt(cycles)
    least_moment = np.log(2 * cycles / (cycles + 1)) - scatter
    reach = max(0.5 * resolution, zeta * f, 1e-3 * f)
    for line in lines:
        narrow = zeta < LINES.damping
        steady = zeta < resolution / f and np.log(line.moment) < least_moment
        if abs(line.frequency - f) < reach and (narrow or steady):
            return line
    return None


def line_remainders(
    frequency: Float, damping: Float, sines: Float, duration: float
) -> tuple[float, ...]:
    """For each pole (m,) the line of `sines`, Hz, that was taken out and left this much of itself;
    0 for modes.

    A sine whose phase wanders leaves its sides, in place of the mode they stand on: as sharp as a
    line, and far sharper than the modes are.
    """
    off = np.abs(sines[:, None] - frequency)
    near = off < np.maximum(damping * frequency, 2 / duration)
    modes = damping[~near.any(axis=0) | (damping > LINES.damping)]
    usual = float(np.median(modes)) if modes.size else 0.0
    left = near & (damping < min(LINES.damping, usual / LIMITS.forced))
    return tuple(
        float(max(sines[left[:, k]], default=0.0)) for k in range(frequency.size)
    )


def carriers(
    frequency: Float, damping: Float, deviation: Float, shape: Complex
) -> list[Int]:
    """For each pole the modes whose motion it is, none for a mode.

    Parameters
    ----------
    frequency : (m,) float64, Hz, ascending
    damping : (m,) float64
    deviation : (m,) float64
        Standard deviation of the damping.
    shape : (ch, m) complex128
    """
    if not frequency.size:
        return []
    level = np.linalg.norm(shape, axis=1)
    typical = float(np.median(level))
    # a channel of another unit
    odd = level > channel_checks.LIMITS.level_ratio * typical
    psi = shape * np.where(odd, typical / np.maximum(level, 1e-300), 1.0)[:, None]
    psi = psi / np.linalg.norm(psi, axis=0)
    # over the statistical floor, up to the length of the record
    loose = deviation / np.sqrt(damping / frequency)
    usual = np.median(damping)
    loose = loose * np.maximum(usual / (LIMITS.forced * damping), 1.0)
    out = [np.empty(0, dtype=np.int64) for _ in frequency]
    accepted = np.zeros(frequency.size, dtype=np.bool_)
    for k in np.argsort(
        loose * np.maximum(damping / usual, 1.0), kind="stable"
    ).tolist():
        at = np.flatnonzero(accepted)
        near = _neighbours(at[at < k], at[at > k], len(psi))
        if near.size:
            known = min(np.median(loose[near]), np.median(loose[at]))
            doubt = max(damping[k] / np.median(damping[near]), 1.0) * loose[k] / known
            basis = np.linalg.qr(psi[:, near])[0]
            outside = float(1 - np.linalg.norm(basis.conj().T @ psi[:, k]) ** 2)
            inverse = np.linalg.pinv(psi[:, near])
            # least share of these shapes that lies outside the span of the others: a mode that
            # the sensors separate as little has a part of it there, one of any direction
            own = (1 / np.maximum((np.abs(inverse) ** 2).sum(axis=1), 1.0)).min()
            free = 0.5 * (len(psi) - near.size)
            within = own * betaincinv(free, 0.5 * near.size, FALSE_ALARM)
            if doubt > LIMITS.forced and outside < within:
                out[k] = near
        accepted[k] = not out[k].size
    return out


def _neighbours(below: Int, above: Int, channels: int) -> Int:
    """The nearest accepted modes of either side, in all half as many as there are channels; room
    that one side leaves, as below all modes, is the other's.
    """
    most = channels // 2
    low = min(below.size, most - min(above.size, most // 2))
    high = min(above.size, most - low)
    return np.concatenate([below[below.size - low :], above[:high]])
