"""Response of a modal model to sampled forces, exact at every line of the discrete spectrum.

Spectra here are unnormalised `numpy.fft.rfft` values of band-limited signals: X (row, line), lines
at k·rate/n. A first-order hold would droop by sinc² (12 % at 0.2 of the rate) and bias every
accelerance; the spectrum does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.core.motions import DERIVATIVE, Motion
from ringtrue.errors import InputError

MOTIONS: tuple[Motion, ...] = ("displacement", "velocity", "acceleration")
_CHUNK = 1 << 11  # lines at a time: the modal coordinates of 130 modes take 4 MB and stay in cache


def lines(samples: int, rate: float) -> Float:
    """(line,) frequencies of the discrete spectrum, Hz."""
    return np.asarray(fft.rfftfreq(samples, 1.0 / rate))


def response_spectrum(
    model: ModalModel, forces: Complex, freqs: Float, *, quantity: Motion = "acceleration"
) -> Complex:
    """Spectrum of the motion of all outputs.

    Parameters
    ----------
    model : ModalModel
        Residues in receptance form; its `kind` plays no role here.
    forces : (in, line) complex128
        Spectra of the inputs, in the unit of each input (N, m, m/s).
    freqs : (line,) float64, Hz
    quantity : {"displacement", "velocity", "acceleration"}

    Returns
    -------
    (out, line) complex128, unit of the quantity; 0 at 0 Hz.
    """
    if forces.shape != (model.participation.shape[1], freqs.size):
        raise InputError(
            f"forces {forces.shape}: must be (in, line) = "
            f"{(model.participation.shape[1], freqs.size)}"
        )
    if quantity not in DERIVATIVE:
        raise InputError(f"quantity {quantity!r}: allowed are {', '.join(DERIVATIVE)}")
    out = np.empty((model.shapes.shape[0], freqs.size), dtype=np.complex128)
    for at in range(0, freqs.size, _CHUNK):  # bounds the memory of the modal coordinates
        part = slice(at, at + _CHUNK)
        out[:, part] = _motion(
            model, forces[:, part], np.asarray(2j * np.pi * freqs[part]), DERIVATIVE[quantity]
        )
    return out


def _motion(model: ModalModel, f: Complex, s: Complex, power: int) -> Complex:
    """(out, line) at s = iω.

    With u = Re(l)·f, v = Im(l)·f and s − s_k = S − iω_k, S = s − σ_k, a mode and its conjugate make
    2·[Re(ψ)·(S·u − ω_k·v) − Im(ψ)·(S·v + ω_k·u)]/(S² + ω_k²): real matrices, one division a mode
    and line.
    """
    sigma, omega = model.poles.real[:, None], model.poles.imag[:, None]
    u, v = _real_times(model.participation.real, f), _real_times(model.participation.imag, f)
    rest = s - sigma
    inverse = 2.0 / (rest * rest + omega**2)
    y = _real_times(model.shapes.real, (rest * u - omega * v) * inverse)
    y -= _real_times(model.shapes.imag, (rest * v + omega * u) * inverse)
    y += model.upper @ f
    if np.any(model.lower):
        y += (model.lower @ f) / np.where(s == 0, np.inf, s**2)
    return y * s**power


def _real_times(a: Float, x: Complex) -> Complex:
    """Product of a real matrix with a complex one, in real arithmetic."""
    x = np.ascontiguousarray(x)
    return np.asarray((np.ascontiguousarray(a) @ x.view(np.float64)).view(np.complex128))


def simulate(
    model: ModalModel,
    forces: Float,
    rate: float,
    *,
    quantity: Motion = "acceleration",
    tail: float | None = None,
) -> Float:
    """Motion of all outputs under sampled, band-limited forces, from rest.

    Parameters
    ----------
    model : ModalModel
    forces : (in, sample) float64, in the unit of each input
    rate : float, Hz
    quantity : {"displacement", "velocity", "acceleration"}
    tail : float, s, optional
        Zeros appended for the decay, so that nothing wraps round to the start; by default until e⁻⁹
        of the slowest mode. 0 makes the signals periodic: the steady state of a stationary
        excitation.

    Returns
    -------
    (out, sample) float64
    """
    forces = np.asarray(forces, dtype=np.float64)
    n = forces.shape[1]
    pad = decay_time(model) if tail is None else tail
    full = int(fft.next_fast_len(n + int(np.ceil(pad * rate)), real=True))
    full = n if tail == 0 else full
    spectrum = response_spectrum(
        model, np.asarray(fft.rfft(forces, full)), lines(full, rate), quantity=quantity
    )
    return np.asarray(fft.irfft(spectrum, full, overwrite_x=True)[:, :n])


def at_outputs(model: ModalModel, ids: Sequence[str]) -> ModalModel:
    """The model seen at the named outputs only, in the given order."""
    here = {c.id: i for i, c in enumerate(model.outputs)}
    if lost := [c for c in ids if c not in here]:
        raise InputError(
            f"no output {' '.join(lost[:8])} in the modal model; there are "
            f"{' '.join(list(here)[:40])}"
        )
    at = [here[c] for c in ids]
    return replace(
        model,
        shapes=model.shapes[at],
        lower=model.lower[at],
        upper=model.upper[at],
        outputs=tuple(model.outputs[i] for i in at),
    )


def decay_time(model: ModalModel, nepers: float = 9.0) -> float:
    """Time in which the slowest mode decays by e^-nepers, s."""
    return float(nepers / np.abs(model.poles.real).min())


def streamed(
    segment: Callable[[int, Float], Float], count: int, hop: int, fade: int, tail: int
) -> Iterator[Float]:
    """A long stationary record from independent segments, cross-faded with equal power and
    overlap-added.

    Segment b covers the samples b·hop .. b·hop + hop + fade; its window rises as a sine and falls
    as a cosine over `fade` samples, so the variances of neighbours add up to one. Applied to the
    *force*, the response stays that of a stationary force: each segment hands back its response
    with the decay, `hop + fade + tail` samples.

    Parameters
    ----------
    segment : callable
        (b, window (hop + fade,)) -> (out, hop + fade + tail).
    count, hop, fade, tail : int

    Yields
    ------
    (out, hop) float64, `count` times
    """
    rest: Float | None = None
    for b in range(-1, count):  # one segment ahead, so that the first sample is in the steady state
        y = segment(b, fade_window(hop, fade))
        if rest is not None:
            y[:, : rest.shape[1]] += rest
        rest = y[:, hop:]
        if b >= 0:
            yield y[:, :hop]


def fade_window(hop: int, fade: int) -> Float:
    """(hop + fade,) window whose squares, shifted by hop, add up to one."""
    ramp = np.sin(0.5 * np.pi * (np.arange(fade) + 0.5) / max(fade, 1))
    window: Any_ = np.ones(hop + fade)
    window[:fade], window[hop:] = ramp, ramp[::-1]
    return np.asarray(window)
