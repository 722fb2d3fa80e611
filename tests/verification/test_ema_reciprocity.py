"""Faults at the points struck that only reciprocity tells: calibrations, exchanged references, a
wrong number.
"""

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import Norm
from ringtrue.core.signals import Channel
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.identification.frf.scaling import calibrations, reciprocity, reciprocity_note


def structure(seed: int, points: int, noise: float = 0.02) -> ModalModel:
    """Six modes at eight channels, the first `points` of them struck; noise of the typical
    component.
    """
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((8, 6)) + 0j
    at = [Channel(f"{i + 1}+Z", "acceleration") for i in range(8)]
    force = tuple(Channel(f"{i + 1}+Z", "force", "N") for i in range(points))
    turn = np.exp(1j * rng.uniform(0, 6, 6)) * rng.uniform(0.2, 5, 6)  # any scale of a mode
    shapes, struck = (x + noise * rng.standard_normal(x.shape) for x in (phi, phi[:points]))
    poles = 2j * np.pi * np.arange(1, 7) * (1 + 0.01j)
    return ModalModel(
        poles,
        shapes * turn,
        (struck / turn).T,
        np.zeros((8, points)),
        np.zeros((8, points)),
        tuple(at),
        force,
        "accelerance",
        Norm.UNSCALED,
    )


def scaled(model: ModalModel, at: int, factor: float) -> ModalModel:
    shapes = model.shapes.copy()
    shapes[at] *= factor
    return replace(model, shapes=shapes)


@pytest.mark.parametrize("points", [2, 3, 4])
def test_a_sound_structure_is_reciprocal_and_nothing_is_said(points: int) -> None:
    for seed in range(20):
        model = structure(seed, points)
        assert np.median(reciprocity(model)) > 0.98
        assert reciprocity_note(model, driving_pairs(model)) == ""


def test_two_noisy_modes_do_not_tell_a_factor() -> None:
    """The scatter of two modes at two points is known by one value."""
    for seed in range(60):
        model = structure(seed, 2, 0.05)
        few = replace(
            model,
            poles=model.poles[:2],
            shapes=model.shapes[:, :2],
            participation=model.participation[:2],
        )
        assert "sensitivity" not in reciprocity_note(few, driving_pairs(few))


@pytest.mark.parametrize("factor", [0.5, 1.25, 3.0])
def test_a_wrong_sensitivity_is_named_with_its_factor(factor: float) -> None:
    off, named = [], 0
    for seed in range(40):
        model = scaled(structure(seed, 3, 0.005), 1, factor)
        found, std = calibrations(model)
        off.append(np.log(found[1] / factor) / std[1])
        named += f"{found[1]:.3g} times at 2+Z of what" in reciprocity_note(
            model, driving_pairs(model)
        )
    assert named >= 36
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 2.0


def test_of_two_points_the_pair_is_named() -> None:
    told = reciprocity_note(model := scaled(structure(3, 2, 1e-3), 0, 1.25), driving_pairs(model))
    assert "1.25 times that at 2+Z at 1+Z" in told


def test_exchanged_references_are_named() -> None:
    model = structure(5, 3)
    wrong = replace(model, participation=model.participation[:, [2, 1, 0]])
    assert "references 1+Z and 3+Z look exchanged" in reciprocity_note(wrong, driving_pairs(wrong))


def test_a_reference_struck_elsewhere_is_named() -> None:
    model = structure(6, 3)
    wrong = replace(model, inputs=(*model.inputs[:2], Channel("7+Z", "force", "N")))
    assert "7+Z was not struck where" in reciprocity_note(wrong, driving_pairs(wrong))


def test_of_two_points_that_fit_in_no_way_no_reason_is_made_up() -> None:
    model = structure(6, 2)
    wrong = replace(model, inputs=(model.inputs[0], Channel("7+Z", "force", "N")))
    assert "a point or direction is wrong" in reciprocity_note(wrong, driving_pairs(wrong))


def test_a_hammer_known_to_be_turned_needs_no_second_word() -> None:
    model = structure(7, 3)
    turned = replace(model, participation=model.participation * [1.0, -1.0, 1.0])
    assert reciprocity_note(turned, [p for p in driving_pairs(turned) if p[1] != 1]) == ""


def test_one_point_tells_nothing() -> None:
    model = structure(8, 1)
    assert np.isnan(reciprocity(model)).all()
    assert reciprocity_note(model, driving_pairs(model)) == ""
