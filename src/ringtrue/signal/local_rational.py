"""FRFs from continuous forces without leakage: a local rational model around each line of the whole
record.

The transform of a record that neither begins nor ends at rest is Y = H U + T: the transient T,
which windows only spread, is as smooth over the lines as H is. Around a line the two are ratios of
polynomials over one denominator, that of all responses and forces, whose poles are the same: D Y =
B U + I, linear but for the weight 1/|D| of its error. Sources: McKelvey, Guérin (2012),
Non-parametric frequency response estimation using a local rational model; Pintelon, Schoukens
(2012), System Identification, chapter 7; Sanathanan, Koerner (1963) for the weight.

Over a whole number M of periods a periodic force (pseudo-random, multisine, repeated sweeps) has
every M-th line of the transform only, and Y = H U + T there. The lines between hold the transient T
alone: a local rational model of these gives T at the forced line, and H = (Y - T)/U needs no
smoothness of H. Source: Pintelon, Schoukens (2012), section 7.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.channels import FORCES, MOTIONS
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.signal.frf import as_input, sorted_channels


@dataclass(frozen=True, slots=True)
class LocalModel:
    """A local rational model of an FRF.

    Attributes
    ----------
    degree : int
        Of every polynomial: two poles, and what other modes add.
    turns : int
        Turns of the weight.
    spare : float
        Lines of the record to an unknown of a window, at least: sweeps do not distinguish T from
        H U at their ends.
    overlap : int
        Windows that share a line of the record.
    seen : float
        A line counts if so many times its variance is below the square of the FRF, mean over the
        responses.
    close : float
        Share of its value at the middle that the denominator is taken for at least.
    batch : int
        Values in memory.
    """

    degree: int = 2
    turns: int = 3
    spare: float = 4.0
    overlap: int = 4
    seen: float = 4.0
    close: float = 1e-3
    batch: int = 2_000_000


MODEL = LocalModel()


@dataclass(frozen=True, slots=True)
class RandomForce:
    """When a force runs all the time.

    Attributes
    ----------
    filled : float
        Share of the lines that carry a random force; fewer do of a periodic one.
    most_lines : int
        Lines in the band that holds the force, at most.
    band : float
        Share of the force that this band holds.
    loud : float
        Share of its largest value, which such a force exceeds
    long : float
        in this share of the samples.
    repeated : float
        Correlation of a periodic force with itself a period later.
    least_lines : int
        Lines with a force in one period; a sine has one.
    forced : float
        Share of the strongest line from which a line carries a force.
    """

    filled: float = 0.4
    most_lines: int = 8192
    band: float = 0.999
    loud: float = 0.1
    long: float = 0.2
    repeated: float = 0.98
    least_lines: int = 64
    forced: float = 1e-3


FORCE = RandomForce()


def is_continuous(history: TimeHistory) -> bool:
    """Whether every force of a record runs all the time, as that of a shaker does, and not in
    impacts.
    """
    forces = [
        x
        for c, x in zip(history.channels, history.data, strict=True)
        if c.quantity in FORCES
    ]
    size = [np.abs(x - np.median(x)) for x in forces]
    return bool(size) and all(
        float(np.mean(x > FORCE.loud * x.max())) > FORCE.long for x in size
    )


def spacing(history: TimeHistory) -> float:
    """Distance of lines, Hz, that the record allows: a quarter of a window of as few of its lines
    as there may be.

    There are not more than some thousand in the band that the forces fill.
    """
    ordered, q = sorted_channels(history)
    lines = spectra(ordered.data[:q])
    power = (
        (np.abs(lines) ** 2 / np.maximum((np.abs(lines) ** 2).sum(axis=0), 1e-300))
        .sum(axis=1)
        .cumsum()
    )
    top = float(np.searchsorted(power, FORCE.band * power[-1]))
    return float(
        max(_width(lines, _unknowns(q)) / MODEL.overlap, top / FORCE.most_lines)
        * ordered.rate
        / ordered.data.shape[1]
    )


def local_frfs(
    histories: Sequence[TimeHistory], resolution: float, *, inputs: Sequence[str] = ()
) -> tuple[FrfSet, ...]:
    """FRFs of all responses against all forces of each record, on the lines where every force moves
    something.

    Parameters
    ----------
    histories : sequence of TimeHistory
    resolution : float, Hz
        Distance of the frequency lines; each rests on the lines of the record twice as far to both
        sides, further where these are few or carry no force.
    inputs : sequence of str, optional
        Ids of the force channels; by default all channels whose quantity is force.

    Returns
    -------
    tuple of FrfSet
        One a record. The coherence is that of each input with the others taken out,
        `frf.frf_variance` holds with it; `averages` are degrees of freedom of a window.

    Raises
    ------
    DataError
        As `spectra.shaker_frfs` does; if a record is short, or there is no line where every force
        moves something.
    """
    found = [_random_frfs(h, resolution, inputs) for h in histories]
    return _on_common_lines(found, histories[0].source)


def _on_common_lines(
    found: list[tuple[FrfSet, Bool]], source: str
) -> tuple[FrfSet, ...]:
    """The FRFs of all records on the lines where every force of each moves something."""
    least = min(f.freqs.size for f, _ in found)
    seen = np.all([s[:least] for _, s in found], axis=0)
    if seen.sum() < 3:
        raise DataError(
            f"{source}: there are no lines where every force moves something"
        )
    at = np.flatnonzero(seen)
    return tuple(
        replace(f, data=f.data[at], freqs=f.freqs[at], coherence=f.coherence[at])
        for f, _ in found
    )


def _random_frfs(
    history: TimeHistory, resolution: float, inputs: Sequence[str]
) -> tuple[FrfSet, Bool]:
    """The FRFs of a record at all lines, and (freq,) where every force moves something."""
    ordered, q = sorted_channels(history, inputs)
    n = ordered.data.shape[1]
    n_out = len(ordered.channels) - q
    lines = spectra(ordered.data)
    unknowns = _unknowns(q)
    width = (
        _width(
            lines[:, :q],
            max(MODEL.overlap * resolution * n / ordered.rate / MODEL.spare, unknowns),
        )
        | 1
    )
    if width > lines.shape[0] // 2:
        raise DataError(
            f"{history.source}: {ordered.duration:.4g} s are too short for {q} inputs"
        )
    freqs = (
        np.arange(1, int(0.5 * ordered.rate / resolution), dtype=np.float64)
        * resolution
    )
    middle = freqs * (n / ordered.rate)
    first = np.clip(
        np.rint(middle).astype(np.int64) - width // 2, 1, lines.shape[0] - width
    )
    h, variance = _all_fits(lines, q, middle, first, width)
    freedom = width - unknowns + MODEL.degree - MODEL.degree / n_out
    power = np.abs(h) ** 2
    coherence = power / np.maximum(
        power + 2 * freedom * variance, np.finfo(np.float64).tiny
    )
    seen = (power / np.maximum(2 * variance, np.finfo(np.float64).tiny)).mean(
        axis=1
    ).min(axis=1) > MODEL.seen
    kind = MOTIONS[ordered.channels[q].quantity]
    forces = tuple(as_input(c) for c in ordered.channels[:q])
    responses = ordered.channels[q:]
    averages = np.full(q, freedom)
    return FrfSet(
        data=h,
        freqs=freqs,
        outputs=responses,
        inputs=forces,
        coherence=coherence,
        averages=averages,
        kind=kind,
        window_decay=0.0,
        source=history.source,
        sharp=True,
    ), seen


def spectra(data: Any_) -> Complex:
    """(freq, channel) transform of a record (channel, sample) without its means."""
    x = np.asarray(data, dtype=np.float64)
    return np.asarray(
        rfft(x - x.mean(axis=1, keepdims=True), axis=1).T / np.sqrt(x.shape[1]),
        dtype=np.complex128,
    )


def _unknowns(inputs: int) -> int:
    """Of a response in a window, and of the denominator."""
    return (MODEL.degree + 1) * (inputs + 1) + MODEL.degree


def _width(forces: Complex, unknowns: float) -> int:
    """Lines of a window for so many unknowns: more where the forces (freq, in) carry few of
    them.
    """
    least = round(MODEL.spare * unknowns)
    return round(least * max(1.0, FORCE.filled / _filled(forces[1:], least)))


def _all_fits(
    lines: Complex, q: int, middle: Float, first: Int, width: int
) -> tuple[Complex, Float]:
    """FRFs (window, out, in) and the variance of their parts at `middle` (in lines), a batch of
    windows at a time.
    """
    n_out = lines.shape[1] - q
    h, variance = (
        np.empty((middle.size, n_out, q), dtype=t) for t in (np.complex128, np.float64)
    )
    size = max(1, MODEL.batch // (width * n_out * (MODEL.degree + 1)))
    for a in range(0, middle.size, size):  # all windows at once would not fit in memory
        at = first[a : a + size, None] + np.arange(width)
        r = (at - middle[a : a + size, None]) / (0.5 * width)
        h[a : a + size], variance[a : a + size] = _fit(
            lines[at][..., :q], lines[at][..., q:], r
        )
    return h, variance


def _filled(lines: Complex, width: int) -> float:
    """Share of the lines (freq, in) that carry the force, (Σp)²/(nΣp²) where there is most of
    it.
    """
    count = max(lines.shape[0] // width, 1)
    p = np.abs(lines[: count * width].reshape(count, -1, lines.shape[1])) ** 2
    total = p.sum(axis=1)
    square = np.maximum((p**2).sum(axis=1), np.finfo(np.float64).tiny)
    return float(
        ((total**3 / square).sum(axis=0) / total.sum(axis=0)).min() / p.shape[1]
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """Triangle (window, p, p) of the regressors, their products (window, p, y) with the data, and
    what they leave.
    """

    triangle: Complex
    product: Complex
    rest: Complex  # (window, row, y)


def _fit(u: Complex, y: Complex, r: Float) -> tuple[Complex, Float]:
    """FRFs and variance of their parts, (window, out, in), at r = 0, from lines (window, row, in or
    out) at r.
    """
    q = u.shape[2]
    powers = r[..., None] ** np.arange(MODEL.degree + 1)
    forced = (powers[..., :, None] * u[..., None, :]).reshape(*r.shape, -1)
    regressors = np.concatenate([forced, powers], axis=2)
    h, part, gain = solved(regressors, y, powers, q)
    return h, part[:, :, None] * gain[:, None]


def solved(
    regressors: Complex, y: Complex, powers: Complex | Float, rows: int
) -> tuple[Complex, Float, Float]:
    """Least squares of D Y = B X + I in windows of lines.

    Parameters
    ----------
    regressors : (window, line, p) complex128
        X.
    y : (window, line, out) complex128
    powers : (window, line, MODEL.degree + 1)
        Of the place of the lines, for D, which is 1 in the middle.

    Returns
    -------
    b : (window, out, rows) complex128
        The first coefficients of B.
    part : (window, out) float64
        Variance of the real part of I.
    gain : (window, rows) float64
        That of the real part of a coefficient is `part` times this.
    """
    shape = powers.shape[:2]
    n_out = y.shape[2]
    data = (y[..., None] * powers[:, :, None]).reshape(*shape, -1)
    coefficients = np.zeros((shape[0], MODEL.degree + 1), dtype=np.complex128)
    coefficients[:, 0] = 1
    for _ in range(MODEL.turns):
        weight = 1 / np.maximum(np.abs(powers @ coefficients[..., None]), MODEL.close)
        reduced = _reduced(
            np.asarray(regressors * weight, dtype=np.complex128), data * weight
        )
        rest = reduced.rest.reshape(*shape, n_out, MODEL.degree + 1)
        coefficients = _denominator(rest, _error(rest, coefficients))
    noise = _error(rest, coefficients)
    product = reduced.product.reshape(shape[0], -1, n_out, MODEL.degree + 1)
    right = np.einsum("wpod,wd->wpo", product, coefficients)
    inverse = np.linalg.inv(reduced.triangle)[
        :, :rows
    ]  # of small triangles; its rows are the covariance, too
    free = shape[1] - regressors.shape[2] - MODEL.degree / n_out
    return (
        (inverse @ right).transpose(0, 2, 1),
        0.5 * noise / free,
        (np.abs(inverse) ** 2).sum(axis=2),
    )


def _error(rest: Complex, coefficients: Complex) -> Float:
    """(window, out) squares, summed over the rows, of the equation error."""
    power = np.abs((rest @ coefficients[:, None, :, None])[..., 0]) ** 2
    return np.asarray(np.maximum(power.sum(axis=1), np.finfo(np.float64).tiny))


def _reduced(regressors: Complex, data: Complex) -> _Reduced:
    """QR of the regressors, columns scaled."""
    scale = (
        np.linalg.norm(regressors, axis=1, keepdims=True) + np.finfo(np.float64).tiny
    )
    basis, triangle = np.linalg.qr(regressors / scale)
    product = basis.conj().transpose(0, 2, 1) @ data
    return _Reduced(triangle * scale, product, data - basis @ product)


def _denominator(rest: Complex, noise: Float) -> Complex:
    """Coefficients of D (window, degree + 1), 1 first, of least error in `rest` (window, row, out,
    degree + 1).
    """
    weighted = (rest / np.sqrt(noise)[:, None, :, None]).reshape(
        rest.shape[0], -1, rest.shape[3]
    )
    gram = weighted.conj().transpose(0, 2, 1) @ weighted
    scale = 1 / np.sqrt(
        np.maximum(np.einsum("wii->wi", gram).real, np.finfo(np.float64).tiny)
    )
    gram = scale[:, :, None] * gram * scale[:, None]
    inner = gram[:, 1:, 1:] + 1e-12 * np.eye(MODEL.degree)
    solved = -np.linalg.solve(inner, gram[:, 1:, :1])[..., 0]
    return np.concatenate(
        [np.ones((rest.shape[0], 1)), solved * scale[:, 1:] / scale[:, :1]], axis=1
    )


def period(history: TimeHistory) -> int:
    """Samples after which the forces of a record come again, 0 if they do not, or too few lines
    carry them.
    """
    ordered, q = sorted_channels(history)
    likeness = np.min([_likeness(x) for x in ordered.data[:q]], axis=0)
    low = np.flatnonzero(likeness < 0.5)
    again = np.flatnonzero(likeness > FORCE.repeated)
    again = again[again > low[0]] if low.size else again[:0]
    if not again.size:
        return 0
    near = again[again < 1.01 * again[0] + 2]
    samples = int(near[np.argmax(likeness[near])])
    size = np.abs(spectra(ordered.data[:q, -samples:]))
    return (
        samples
        if int((size > FORCE.forced * size.max(axis=0)).sum(axis=0).min())
        >= FORCE.least_lines
        else 0
    )


def _likeness(x: Any_) -> Float:
    """(lag,) correlation of a signal (sample,) with itself later, of the parts that overlap, to
    half of its length.
    """
    x = np.asarray(x, dtype=np.float64) - np.mean(x)
    n = x.size
    half = x.size // 2
    both = irfft(
        np.abs(rfft(x, m := int(next_fast_len(n + half + 1, real=True)))) ** 2, m
    )[: half + 1]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    lag = np.arange(half + 1)
    return np.asarray(
        both
        / np.sqrt(
            np.maximum(
                power[n - lag] * (power[n] - power[lag]), np.finfo(np.float64).tiny
            )
        )
    )


def periodic_frfs(histories: Sequence[TimeHistory], samples: int) -> tuple[FrfSet, ...]:
    """FRFs against the one force of each record, on the lines of its period.

    Parameters
    ----------
    histories : sequence of TimeHistory
    samples : int
        Period of the force.

    Returns
    -------
    tuple of FrfSet
        One a record, on common lines. `frf.frf_variance` holds with the coherence; `averages` are
        degrees of freedom.

    Raises
    ------
    DataError
        If a record has several forces: at each line they are one; or fewer than three lines carry
        the force of all.
    """
    found = [_periodic_frfs(h, samples) for h in histories]
    return _on_common_lines(found, histories[0].source)


def _periodic_frfs(history: TimeHistory, samples: int) -> tuple[FrfSet, Bool]:
    """The FRFs of a record at all lines of the period, and (freq,) where the force moves
    something.
    """
    ordered, q = sorted_channels(history)
    if q > 1:
        raise DataError(
            f"{history.source}: {q} forces that all repeat after {samples / history.rate:.4g} s "
            "are one force at each "
            "line: drive one at a time, or with forces that do not repeat"
        )
    times = ordered.data.shape[1] // samples
    lines = spectra(ordered.data[:, -times * samples :])
    place = times * np.arange(1, (samples + 1) // 2)
    force = np.abs(lines[place, 0])
    transient, variance, freedom = _transients(lines[:, 1:], place, times)
    h = (lines[place, 1:] - transient) / np.where(
        force > FORCE.forced * force.max(), lines[place, 0], np.inf
    )[:, None]
    variance = variance / np.maximum(force, np.finfo(np.float64).tiny)[:, None] ** 2
    power = np.abs(h) ** 2
    coherence = power / np.maximum(
        power + 2 * freedom * variance, np.finfo(np.float64).tiny
    )
    seen = (power / np.maximum(2 * variance, np.finfo(np.float64).tiny)).mean(
        axis=1
    ) > MODEL.seen
    kind = MOTIONS[ordered.channels[1].quantity]
    freqs = place * (history.rate / (times * samples))
    inputs = (as_input(ordered.channels[0]),)
    h = h[:, :, None]
    coherence = coherence[:, :, None]
    averages = np.array([freedom])
    return FrfSet(
        data=h,
        freqs=freqs,
        outputs=ordered.channels[1:],
        inputs=inputs,
        coherence=coherence,
        averages=averages,
        kind=kind,
        window_decay=0.0,
        source=history.source,
        sharp=True,
    ), seen


def _transients(lines: Complex, place: Int, times: int) -> tuple[Complex, Float, float]:
    """The transient (line, out) at lines `place`, the variance of a part of Y - T there, and its
    degrees of freedom.

    From the lines (freq, out) around that are no multiple of `times`.
    """
    unknowns = 2 * MODEL.degree + 1
    n_out = lines.shape[1]
    width = times * int(np.ceil(MODEL.spare * unknowns / (times - 1)))
    if width > lines.shape[0] // 2:
        raise DataError(f"{times} periods of {place.size} lines are too short")
    t = np.empty((place.size, n_out), dtype=np.complex128)
    variance = np.empty((place.size, n_out))
    size = max(1, MODEL.batch // (width * n_out * (MODEL.degree + 1)))
    for a in range(0, place.size, size):  # all windows at once would not fit in memory
        middle = place[a : a + size, None]
        at = np.clip(middle - width // 2, 1, lines.shape[0] - width) + np.arange(width)
        at = at[at % times != 0].reshape(middle.size, -1)
        powers = ((at - middle) / (0.5 * width))[..., None] ** np.arange(
            MODEL.degree + 1
        )
        found, part, gain = solved(powers.astype(np.complex128), lines[at], powers, 1)
        t[a : a + size], variance[a : a + size] = found[..., 0], part * (1 + gain)
    return t, variance, float(width - width // times - unknowns + MODEL.degree / n_out)
