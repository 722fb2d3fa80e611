"""Elastic modes that strain a suspension, after it was tuned to the rigid-body modes.

A chain of 8 masses on a ground spring k at each end, springs 3k between them:

    |-k-o-3k-o- ... -o-k-|      the first mode is the body on its springs, the others bend it and strain k, too
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.reduction.matrix_model import DenseModel
from ringtrue.study.stages.tune import disagreeing
from ringtrue.updating.target import Target, Weights

N, STIFF = 8, np.array([np.log(2.0)])
STD = np.array([0.02])


def chain() -> DenseModel:
    links = np.eye(N - 1, N, k=1) - np.eye(N - 1, N)
    ground = np.zeros((1, N, N))
    ground[0, 0, 0] = ground[0, -1, -1] = 1e4
    spring = Parameter("ground", lower=0.1, upper=10.0, std=1.0)
    return DenseModel.springs(
        3e4 * links.T @ links + ground[0], np.eye(N), ground, ParameterSet((spring,))
    )


def elastic(x: np.ndarray) -> Target:
    """The modes above the first as measured with the springs at x, without error."""
    now = chain().modes(x)
    some = slice(1, 5)
    weights = Weights(frequency=0.005)
    f = now.frequencies[some]
    return Target(
        f, now.shapes[:, some], np.full(f.size, 1e-3), np.ones(f.size, dtype=bool), weights
    )


def test_modes_that_agree_with_the_tuning_are_not_named() -> None:
    assert disagreeing(chain(), elastic(STIFF), STIFF, STD) == ()


def test_modes_that_the_tuning_puts_off_are_named_with_their_share() -> None:
    aim = elastic(np.zeros(1))
    told = disagreeing(chain(), aim, STIFF, STD)
    now = chain().linearise(STIFF)
    share = (
        now.d_lambda[1:5, 0] / (2 * np.pi * now.frequencies[1:5]) ** 2
    )  # strain energy of the ground springs
    off = now.frequencies[1:5] / aim.frequencies - 1
    loud = np.flatnonzero((share > 0.1) & (off > 2 * 2.0 * np.hypot(0.005, share / 2 * STD[0])))
    assert loud.size
    for t in loud.tolist():
        assert any(
            f"elastic test mode {t + 1} " in line and f"{100 * share[t]:.0f} %" in line
            for line in told
        )
    assert not any(
        f"elastic test mode {t + 1} " in line
        for t in np.flatnonzero(share < 0.09).tolist()
        for line in told
    )
    assert "+0.0 % off before" in told[0] or "-0.0 % off before" in told[0]
    assert f"{100 * off[loud[0]]:+.1f} % off after" in told[0]


def test_a_mode_that_loses_its_partner_is_named() -> None:
    gates = PairingSettings(mac_gate=0.5, frequency_gate=0.02)
    told = disagreeing(chain(), replace(elastic(np.zeros(1)), pairing=gates), STIFF, STD)
    assert any("0.0 % off before and without partner after" in line for line in told)


def test_a_tuning_that_is_known_so_badly_explains_them() -> None:
    assert disagreeing(chain(), elastic(np.zeros(1)), STIFF, np.array([1.0])) == ()


@pytest.mark.parametrize("x", [0.0, 0.7])
def test_the_share_of_strain_energy_does_not_depend_on_the_scale_of_the_parameter(x: float) -> None:
    """log and linear parameters of the same factor name the same modes."""
    model, aim = chain(), elastic(np.zeros(1))
    spring = Parameter("ground", lower=0.1, upper=10.0, std=1.0, scale="linear")
    linear = DenseModel.springs(
        model.stiffness, np.eye(N), model.d_stiffness, ParameterSet((spring,))
    )
    one = disagreeing(model, aim, np.array([x]), STD)
    other = disagreeing(linear, aim, np.array([np.exp(x) - 1]), STD * np.exp(x))
    assert one == other
