"""Modes near zero that are more than a block of Lanczos: of several free bodies, of mechanisms, of
loose parts.

Seen from a shift far from zero they are one root of high multiplicity, of which Lanczos finds a
block, and the rest by rounding only; nor does it then see the modes that a better shift is to be
judged by. Inertia counts find the gap above them, subspace iteration (Bathe and Wilson 1972) with
as many vectors finds them.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float
from ringtrue.eigen.factor import Pencil
from ringtrue.errors import SingularModel

LADDER = (
    10.0,
    1e-1,
    1e-3,
    1e-5,
)  # of the first guess, negative: marks between which no mode stands above the group
TURNS = 12  # of the subspace; the gap takes an error to less than an eleventh in each
SETTLED = 1e-5  # error of the vectors in the M norm


def rayleigh_ritz(pencil: Pencil, vectors: Float) -> tuple[Float, Float]:
    """Eigenvalues (k,), ascending, and M-orthonormal vectors (f, k) of the problem in the space of
    some vectors.
    """
    k, m = vectors.T @ (pencil.stiffness @ vectors), vectors.T @ (pencil.mass @ vectors)
    values, y = linalg.eigh(k, m)
    return values, vectors @ y


def still_modes(pencil: Pencil, shift: float) -> tuple[Float, Float, float]:
    """All modes below a gap of two decades of λ near the distance of `shift` from zero.

    Returns
    -------
    values : (k,) float64, (rad/s)²; none if there is no such gap
    vectors : (f, k) float64, M-orthonormal
    shift : float
        In the middle of the gap, negative.
    """
    none = np.zeros(0), np.zeros((pencil.size, 0)), shift
    count, middle = _group(pencil, shift)
    if not count:
        return none
    pencil.reserve(4 * count)
    factor, last = pencil.at(middle), np.inf
    x = factor.solve(pencil.mass @ np.random.default_rng(0).standard_normal((pencil.size, count)))
    for _ in range(TURNS):
        values, x = rayleigh_ritz(pencil, x)
        y = factor.solve(pencil.mass @ x)
        rest = y * (values - middle) - x
        error = float(np.sqrt(np.abs(np.einsum("ij,ij->j", rest, pencil.mass @ rest)).max()))
        if error < SETTLED and error > last / 2:  # what is left is the rounding of K
            return values, x, middle
        x, last = y, error
    return none


def _group(pencil: Pencil, shift: float) -> tuple[int, float]:
    """How many modes stand below the widest gap, and a shift in the middle of it; 0 if there is no
    gap.
    """
    above = -1
    try:
        for high, low in pairwise(-shift * mark for mark in LADDER):
            above = pencil.at(high).negatives if above < 0 else above
            below = pencil.at(low).negatives
            if below == above > 0:
                return below, -high / 10
            above = below
    except SingularModel:  # a mark stands on a mode
        pass
    return 0, shift
