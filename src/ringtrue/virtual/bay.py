"""Ambient tests: the same sensors under ambient excitation alone and with events of a known
kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.modal import ModalModel
from ringtrue.virtual.ambient import Ambient, ambient_forces, input_psd
from ringtrue.virtual.events import Pulses, pulse_spectrum
from ringtrue.virtual.response import decay_time, lines, response_spectrum, streamed
from ringtrue.virtual.sensors import Chain, record
from ringtrue.virtual.snr import expected_power, ratio_db, resonance_power


@dataclass(frozen=True, slots=True, eq=False)
class AmbientTest:
    """A structure on a day, with the sensors on it.

    Attributes
    ----------
    model : ModalModel
        Its outputs are the channels.
    chain : Chain
    site : Ambient
    points : tuple of str
        Inputs that carry small broadband forces.
    machine : str or None
        Input of the rotating machine.
    rate : float, Hz
    poles : (m,) complex128, rad/s
        The modes that signal-to-noise ratios are taken at.
    """

    model: ModalModel
    chain: Chain
    site: Ambient
    points: tuple[str, ...]
    machine: str | None
    rate: float
    poles: Complex

    def forces(self, samples: int, rng: np.random.Generator) -> Complex:
        """(in, line) spectra of the ambient excitation."""
        ids = tuple(c.id for c in self.model.inputs)
        return ambient_forces(ids, self.points, self.machine, self.site, samples, self.rate, rng)

    def volts(self, forces: Complex, freqs: Float) -> Complex:
        """(channel, line) spectra at the recorder, without noise."""
        motion = response_spectrum(self.model, forces, freqs, quantity=self.chain.sensors[0].motion)
        self.chain.to_volts(motion, self.rate)
        return motion


def expected_snr(test: AmbientTest) -> float:
    """Median over channels and modes of the ratio at resonance without events, dB."""
    f = np.abs(test.poles) / (2 * np.pi)
    inputs = input_psd([c.id for c in test.model.inputs], test.points, f, test.site)
    signal = expected_power(test.model, test.poles, inputs, test.chain.sensors[0].motion)
    noise = np.stack([s.noise_psd(f, test.rate) for s in test.chain.sensors])
    return float(np.median(ratio_db(signal, noise)))


def on_a_day(test: AmbientTest, snr_db: float, bounds: tuple[float, float]) -> AmbientTest:
    """The test with all ambient levels scaled for a ratio at resonance, ground motion within
    `bounds`, m/s rms.
    """
    gain = 10 ** ((snr_db - expected_snr(test)) / 20)
    return replace(
        test, site=scaled(test.site, float(np.clip(test.site.ground_rms * gain, *bounds)))
    )


def scaled(site: Ambient, ground_rms: float) -> Ambient:
    """A quieter or louder day: all levels in proportion to the ground motion, m/s rms."""
    gain = ground_rms / site.ground_rms
    return replace(
        site,
        ground_rms=ground_rms,
        force_density=gain * site.force_density,
        machine_force=gain * site.machine_force,
    )


def measure(
    test: AmbientTest, events: Sequence[Pulses], samples: int, rng: np.random.Generator
) -> tuple[Any_, float]:
    """One record in the steady state; the tail of the last event stands at its begin.

    Returns
    -------
    volts : (channel, sample) float32
    snr_db : float
        Median over channels and modes at resonance.
    """
    freqs = lines(samples, test.rate)
    forces = test.forces(samples, rng)
    for pulses in events:
        forces += pulse_spectrum(pulses, forces.shape[0], samples, test.rate)
    signal = response_spectrum(test.model, forces, freqs, quantity=test.chain.sensors[0].motion)
    volts, noise = record(signal, test.chain, samples, test.rate, rng)
    strength = resonance_power(signal, test.poles, samples, test.rate)
    quantisation = np.array([s.step**2 / 6 / test.rate for s in test.chain.sensors])[:, None]
    noisy = resonance_power(noise, test.poles, samples, test.rate) + quantisation
    return volts, float(np.median(ratio_db(strength, noisy)))


def measure_long(
    test: AmbientTest, segments: int, hop: int, fade: int, rng: np.random.Generator
) -> Iterator[Any_]:
    """A record of `segments`·`hop` samples, ambient only, block by block: (channel, hop) float32
    volts.
    """
    tail = int(decay_time(test.model) * test.rate)
    streams = rng.spawn(segments + 1)

    def segment(b: int, window: Float) -> Float:
        return _segment(test, window, tail, streams[b + 1])

    for b, volts in enumerate(streamed(segment, segments, hop, fade, tail)):
        yield test.chain.digitise(volts, test.rate, start=b * hop)


def _segment(test: AmbientTest, window: Float, tail: int, rng: np.random.Generator) -> Float:
    """Volts of windowed forces with their decay, and windowed noise, (channel, window + tail)."""
    n = window.size
    full = int(fft.next_fast_len(n + tail, real=True))
    full += full % 2
    forces = fft.rfft(fft.irfft(test.forces(n, rng), n) * window, full)
    volts = fft.irfft(test.volts(np.asarray(forces), lines(full, test.rate)), full)[:, : n + tail]
    volts[:, :n] += fft.irfft(test.chain.noise(n, test.rate, rng), n) * window
    return np.asarray(volts)
