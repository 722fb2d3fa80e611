"""Joints that soften: a mass of 2 kg on a spring of 8 kN/m, damped by 1 %, that loses up to 2 kN/m.

Under a sine force of small amplitude A the law r = k d − loss·d³/(3 slip²) has the harmonic balance
F = |k − 0.75·loss·A²/(3 slip²) − m ω² + i c ω|·A (Nayfeh and Mook 1979, Duffing's equation).
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft

from ringtrue.core.modes import ModalModel, Norm
from ringtrue.core.signals import Channel
from ringtrue.errors import InputError, NumericalError
from ringtrue.virtual.joints import JointIteration, SofteningJoints
from ringtrue.virtual.sensors import lines, response_spectrum, tone

MASS, STIFFNESS, LOSS, SLIP, RATE, SAMPLES = 2.0, 8e3, 2e3, 1e-3, 128.0, 1280
OMEGA0 = np.sqrt(STIFFNESS / MASS)
VISCOUS = 2 * 0.01 * np.sqrt(STIFFNESS * MASS)


def oscillator(loss: float = LOSS) -> SofteningJoints:
    pole = OMEGA0 * (-0.01 + 1j * np.sqrt(1 - 1e-4))
    model = ModalModel(
        poles=np.array([pole]),
        shapes=np.ones((1, 1)),
        participation=np.array([[1 / (2j * MASS * pole.imag)]]),
        lower=np.zeros((1, 1)),
        upper=np.zeros((1, 1)),
        outputs=(Channel("1+Z", "displacement", "m"),),
        inputs=(Channel("1+Z", "force", "N"),),
        kind="receptance",
        norm=Norm.MODAL_A,
    )
    return SofteningJoints(model, np.array([0]), np.array([loss]), np.array([SLIP]))


def amplitude(joints: SofteningJoints, force: float, hertz: float) -> float:
    """Of the steady displacement under a sine force."""
    pushed = tone(hertz, np.array([force]), np.zeros(1), SAMPLES, RATE)
    forces = joints.with_forces(pushed, SAMPLES, RATE)
    moved = response_spectrum(
        joints.model, forces, lines(SAMPLES, RATE), quantity="displacement"
    )
    return float(np.abs(fft.irfft(moved, SAMPLES)).max())


@pytest.mark.parametrize("hertz", [9.8, 10.5])
def test_a_sine_moves_it_as_the_harmonic_balance_says(hertz: float) -> None:
    wanted = 0.3 * SLIP
    omega = 2 * np.pi * hertz
    soft = STIFFNESS - 0.75 * LOSS * wanted**2 / (3 * SLIP**2)
    force = abs(soft - MASS * omega**2 + 1j * VISCOUS * omega) * wanted
    # the next term of the hyperbolic tangent is 4 % of the cubic one, and the fifth harmonic less
    assert amplitude(oscillator(), force, hertz) == pytest.approx(wanted, rel=5e-3)
    linear = force / abs(STIFFNESS - MASS * omega**2 + 1j * VISCOUS * omega)
    assert abs(linear / wanted - 1) > 0.02


def test_small_motions_are_those_of_the_linear_spring() -> None:
    omega = 2 * np.pi * 9.8
    linear = 1e-3 / abs(STIFFNESS - MASS * omega**2 + 1j * VISCOUS * omega)
    assert amplitude(oscillator(), 1e-3, 9.8) == pytest.approx(linear, rel=1e-4)


def test_a_hit_far_beyond_the_slip_rings_down_as_the_law_says() -> None:
    joints = oscillator(loss=800.0)
    hit = np.zeros((1, SAMPLES))
    hit[0, 100] = 200.0
    pushed = fft.rfft(hit)
    forces = joints.with_forces(pushed, SAMPLES, RATE)
    freqs = lines(SAMPLES, RATE)
    spectrum = response_spectrum(joints.model, forces, freqs, quantity="displacement")
    moved = fft.irfft(spectrum, SAMPLES)
    assert np.abs(moved).max() > 8 * SLIP
    added = fft.irfft(forces - pushed, SAMPLES)
    wanted = joints.pseudo_force(moved)
    assert np.linalg.norm(added - wanted) < 2e-3 * np.linalg.norm(wanted)


def test_an_iteration_that_does_not_end_and_wrong_sizes_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    j = oscillator()
    monkeypatch.setattr("ringtrue.virtual.joints.ITERATION", JointIteration(rounds=1))
    with pytest.raises(NumericalError, match="smaller loss"):
        amplitude(j, 300.0, 8.7)
    with pytest.raises(InputError, match="as many"):
        SofteningJoints(j.model, j.inputs, np.zeros(2), j.slip)
