"""Target modes: effective mass of a chain, energies that sum up, and modes that tell parameters
apart.

A chain of n equal masses m on springs k, held at one end: K = k·tridiag(-1, 2, -1) with the last
entry k, M = m·1.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, sparse

from ringtrue.errors import InputError
from ringtrue.planning.exciters import (
    choose_targets,
    effective_mass,
    in_band,
    informative_modes,
    kinetic_share,
    readable,
)

N = 6


def spring(i: int) -> np.ndarray:
    """Stiffness of spring i alone; spring 0 holds mass 0 to the ground."""
    k = np.zeros((N, N))
    k[i, i] = 1.0
    if i:
        k[i - 1, i - 1] = 1.0
        k[i, i - 1] = k[i - 1, i] = -1.0
    return k


def chain() -> tuple[np.ndarray, np.ndarray]:
    lam, phi = linalg.eigh(sum(spring(i) for i in range(N)))
    return np.sqrt(lam) / (2 * np.pi), phi


def test_effective_mass_sums_to_the_whole() -> None:
    _, phi = chain()
    rigid = np.zeros((N, 6))
    rigid[:, 0] = 1.0
    share = effective_mass(phi, sparse.eye_array(N), rigid)
    np.testing.assert_allclose(share[:, 0].sum(), 1.0)
    np.testing.assert_allclose(share[0, 0], phi[:, 0].sum() ** 2 / N)
    assert share[0, 0] > 0.8  # the first mode of a cantilevered chain
    assert (share[:, 1:] == 0).all()  # nothing moves there


def test_energies_of_all_regions_sum_to_one() -> None:
    _, phi = chain()
    kinetic = kinetic_share(phi, np.eye(N), [np.arange(2), np.arange(2, N)])
    np.testing.assert_allclose(kinetic.sum(axis=1), 1.0)
    np.testing.assert_allclose(kinetic[:, 0], (phi[:2] ** 2).sum(axis=0))


def test_modes_that_tell_parameters_apart() -> None:
    """Modes 0 and 1 see the sum of the parameters, mode 2 less strongly their difference, mode 3
    nothing.
    """
    d = np.array([[1.0, 1.0], [0.99, 0.99], [0.5, -0.5], [0.0, 0.0]])
    lam = np.ones(4)
    assert informative_modes(d, lam, 0.01, np.ones(2), 2).tolist() == [0, 2]
    assert informative_modes(d, lam, 0.01, np.ones(2), 4).tolist() == [0, 2, 1]
    # a parameter known beforehand is no reason to measure
    assert informative_modes(
        np.array([[1.0, 0.0], [0.0, 0.9]]), np.ones(2), 0.01, np.array([0.001, 1.0]), 1
    ).tolist() == [1]


def test_reasons_are_told() -> None:
    f, phi = chain()
    strain = np.diff(phi, axis=0, prepend=0.0).T ** 2  # of each spring, (m, N)
    strain /= strain.sum(axis=1, keepdims=True)
    chosen = choose_targets(
        f, {"band": in_band(f, 0, f[2]), "spring 6": strain[:, 5] > 0.2}
    )
    assert chosen.modes[0] == 0
    assert chosen.reasons[0] == "band"
    assert all(r for r in chosen.reasons)
    limited = choose_targets(f, {"all": f > 0}, within=f < f[2])
    assert limited.modes.tolist() == [0, 1]
    with pytest.raises(InputError, match="widen"):
        choose_targets(f, {"nowhere": f > 1e9})


def test_modes_that_no_sensor_reads_are_no_targets() -> None:
    """A line of beams twists without a translation, but for round-off, be it ever so large beside
    that of no mode.
    """
    f = np.array([4.0, 11.0, 12.0])
    shapes = np.zeros((5, 3, 3))
    shapes[:, 1, 1] = shapes[:, 2, 2] = np.linspace(0.02, 0.1, 5)
    shapes[:, :, 0] = 1e-12
    seen = readable(shapes, 300.0)
    wanted = choose_targets(f, {"all": f > 0})
    kept, told = wanted.among(seen)
    assert kept.modes.tolist() == [1, 2]
    assert kept.reasons == ("all", "all")
    assert told[0].endswith("mode 1")
    assert wanted.among(readable(shapes + 0.01, 300.0))[1] == ()
    with pytest.raises(InputError, match="no candidate sensor"):
        choose_targets(f, {"twist": f < 5}).among(
            readable(shapes[:, :, :1], 300.0).repeat(3)
        )
