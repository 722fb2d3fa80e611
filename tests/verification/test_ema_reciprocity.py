"""Faults at the points struck that only reciprocity shows: exchanged references, a wrong number."""

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.modes import ModalModel, Norm
from ringtrue.core.signals import Channel
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.identification.frf.scaling import reciprocity_note


def structure(seed: int, points: int, noise: float = 0.02) -> ModalModel:
    """Six modes at eight channels, the first `points` of them struck; noise of the typical
    component.
    """
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((8, 6)) + 0j
    at = [Channel(f"{i + 1}+Z", "acceleration") for i in range(8)]
    force = tuple(Channel(f"{i + 1}+Z", "force", "N") for i in range(points))
    # any scale of a mode
    turn = np.exp(1j * rng.uniform(0, 6, 6)) * rng.uniform(0.2, 5, 6)
    shapes, struck = (
        x + noise * rng.standard_normal(x.shape) for x in (phi, phi[:points])
    )
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


@pytest.mark.parametrize("points", [2, 3, 4])
def test_a_sound_structure_is_reciprocal_and_nothing_is_said(points: int) -> None:
    for seed in range(20):
        model = structure(seed, points)
        assert reciprocity_note(model, driving_pairs(model)) == ""


def test_exchanged_references_are_named() -> None:
    model = structure(5, 3)
    wrong = replace(model, participation=model.participation[:, [2, 1, 0]])
    assert "references 1+Z and 3+Z look exchanged" in reciprocity_note(
        wrong, driving_pairs(wrong)
    )


def test_a_reference_struck_elsewhere_is_named() -> None:
    model = structure(6, 3)
    wrong = replace(model, inputs=(*model.inputs[:2], Channel("7+Z", "force", "N")))
    assert "7+Z was not excited where" in reciprocity_note(wrong, driving_pairs(wrong))


def test_of_two_points_that_fit_in_no_way_no_reason_is_made_up() -> None:
    model = structure(6, 2)
    wrong = replace(model, inputs=(model.inputs[0], Channel("7+Z", "force", "N")))
    assert "a point or direction is wrong" in reciprocity_note(
        wrong, driving_pairs(wrong)
    )


def test_a_hammer_known_to_be_turned_needs_no_second_word() -> None:
    model = structure(7, 3)
    turned = replace(model, participation=model.participation * [1.0, -1.0, 1.0])
    points = driving_pairs(turned)
    assert reciprocity_note(turned, points.take(points.input != 1)) == ""


def test_one_point_tells_nothing() -> None:
    model = structure(8, 1)
    assert reciprocity_note(model, driving_pairs(model)) == ""
