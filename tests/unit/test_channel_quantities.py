"""Velocities beside accelerations without units, and columns that show no motion, known by their
spectra.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from five_modes import PHI, RATE, F, motion, record

from ringtrue.core.notes import sentence
from ringtrue.core.signals import TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.shapes import mac
from ringtrue.signal.channel_quantities import with_learned_quantities


def derivative(y: np.ndarray, order: int) -> np.ndarray:
    """The signals (ch, sample) differentiated in time, integrated for order -1."""
    s = 2j * np.pi * np.fft.rfftfreq(y.shape[1], 1 / RATE)
    s[0] = np.inf if order < 0 else 0.0
    out = np.fft.irfft(np.fft.rfft(y, axis=1) * s**order, y.shape[1], axis=1)
    return np.asarray(out)


def without_units(y: np.ndarray) -> TimeHistory:
    made = record(y)
    return replace(
        made, channels=tuple(replace(c, quantity="unknown") for c in made.channels)
    )


def mixed(order: int) -> np.ndarray:
    """Channels 2 and 5 are the derivative, or the integral, of the others' motion."""
    y = motion().copy()
    y[[1, 4]] = derivative(y[[1, 4]], order)
    return y


@pytest.mark.parametrize(
    ("order", "quantities"),
    [(-1, ("acceleration", "velocity")), (1, ("velocity", "acceleration"))],
)
def test_motions_a_derivative_apart_are_known_by_phase_and_level(order, quantities):
    learned, notes = with_learned_quantities(without_units(mixed(order)))
    expected = [quantities[1] if i in (1, 4) else quantities[0] for i in range(7)]
    assert [c.quantity for c in learned.channels] == expected
    assert {note.code for note in notes} == {"channel quantity"}


def test_stated_quantities_decide_what_the_others_are():
    made = without_units(mixed(-1))
    stated = replace(made.channels[0], quantity="velocity")
    learned, _ = with_learned_quantities(
        replace(made, channels=(stated, *made.channels[1:]))
    )
    assert [c.quantity for c in learned.channels[:3]] == [
        "velocity",
        "displacement",
        "velocity",
    ]


def test_channels_of_one_quantity_stay_as_they_are():
    made = without_units(motion())
    learned, notes = with_learned_quantities(made)
    assert learned is made
    assert notes == ()


def test_shapes_are_those_of_one_motion():
    found = identify_ambient(without_units(mixed(-1)))
    assert found.modes.frequencies == pytest.approx(F, rel=5e-3)
    assert np.diag(mac(found.modes.shapes, PHI.astype(complex))) == pytest.approx(
        1.0, abs=0.01
    )


def test_a_quiet_velocity_among_accelerations_is_no_other_quantity():
    """Near a node of most modes it shares little with the others, and is hundreds of times less than
    the accelerations, as velocities are.
    """
    y = motion().copy()
    rng = np.random.default_rng(4)
    y[0] += 2 * y[0].std() * rng.standard_normal(y.shape[1])
    y[:2] = derivative(y[:2], -1) / 600
    learned, notes = with_learned_quantities(without_units(y))
    assert [c.quantity for c in learned.channels[:3]] == [
        "velocity",
        "velocity",
        "acceleration",
    ]
    assert {note.code for note in notes} == {"channel quantity"}


def test_a_strain_among_accelerations_is_set_aside_by_name():
    """It is as small as its unit and shares little with the others."""
    strain = 1e-6 * motion()[0]
    strain += 3 * strain.std() * np.random.default_rng(4).standard_normal(strain.size)
    learned, notes = with_learned_quantities(
        without_units(np.vstack([motion(), strain]))
    )
    assert len(learned.channels) == 7
    assert [note.code for note in notes] == ["channel of another kind"]


def test_a_temperature_is_set_aside_by_name():
    walk = np.cumsum(np.random.default_rng(1).standard_normal(motion().shape[1]))
    made = without_units(np.vstack([motion(), walk]))
    learned, notes = with_learned_quantities(made)
    assert [c.id for c in learned.channels] == [f"{i}+Z" for i in range(1, 8)]
    assert "8+Z" in sentence(notes[0])


def test_a_channel_with_modes_of_its_own_is_kept():
    """A lone sensor across the others sees modes that these do not."""
    rng = np.random.default_rng(2)
    other = record(np.roll(motion()[:1], 30_000, axis=1)).data
    made = without_units(
        np.vstack([motion(), other + 1e-3 * rng.standard_normal(other.shape)])
    )
    learned, notes = with_learned_quantities(made)
    assert len(learned.channels) == 8
    assert notes == ()
