"""Where to factorise K − σM for the lowest modes: a shift below zero, near the first elastic mode.

A shift nearer to zero loses digits to rounding, one farther off brings the modes close together. A
few Lanczos blocks judge a shift and place the next one.

More modes near zero than a block of Lanczos has, of several free bodies, of mechanisms or of loose
parts, are one root of high multiplicity seen from a shift far from zero. Lanczos finds a block of
them, and the rest by rounding only. Inertia counts find the gap above them, and subspace iteration
(Bathe and Wilson, 1972) with as many vectors finds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.eigen import lanczos
from ringtrue.eigen.eigenpairs import eigenvalue
from ringtrue.eigen.lanczos import rayleigh_ritz
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import SingularModel

EXTRA = 4  # modes beyond the requested ones, so that the count can stand in a gap
# share of the upper end of a band: how far below zero its modes are sought from
LOW = 0.03


@dataclass(frozen=True, slots=True)
class ShiftSearch:
    """How a shift is judged.

    Attributes
    ----------
    blocks : int
        Lanczos blocks of a trial.
    modes : int
        Lowest modes that judge it.
    tries : int
        Trials at most.
    near : float
        Share of the largest λ judged by: no shift is nearer to zero.
    still : float
        Share of the shift under which a block of modes is thought to be of rigid bodies.
    noise : float
        Multiple of the λ of such modes, which is rounding: no shift is nearer to zero.
    blurred : float
        Relative error of the first pair after them from which the modes lie too close together.
    rounding : float
        Share of the first guess, 1000 ε of the usual k/m: no shift is nearer to zero.
    """

    blocks: int = 4
    modes: int = 10
    tries: int = 6
    near: float = 1e-5
    still: float = 1e-4
    noise: float = 1e3
    blurred: float = 1e-2
    rounding: float = 2e-6


@dataclass(frozen=True, slots=True)
class SubspaceIteration:
    """When the modes near zero are found.

    Attributes
    ----------
    turns : int
        Steps at most; the gap takes an error to less than an eleventh in each.
    settled : float
        Error of the vectors in the M norm.
    """

    turns: int = 12
    settled: float = 1e-5


SEARCH = ShiftSearch()
SUBSPACE = SubspaceIteration()


def start_shift(stiffness: Float, mass: Float) -> float:
    """A first guess from the diagonals (f,) of K and M, far below the first elastic mode or near
    it.
    """
    return -1e-7 * float(np.median(_stiffness_per_mass(stiffness, mass))) or -1.0


def rounding_shift(stiffness: sparse.csr_array, mass: sparse.csr_array) -> float:
    """Below what rounding of the stiffest DOFs makes of rigid-body modes, where the usual ones are
    so soft that `start_shift` is not.
    """
    return (
        -1e3
        * np.finfo(float).eps
        * float(_stiffness_per_mass(stiffness.diagonal(), mass.diagonal()).max())
    )


def _stiffness_per_mass(stiffness: Float, mass: Float) -> Float:
    """|k| / m of the DOFs that have mass, (k,), from the diagonals (f,)."""
    massive = mass > 1e-12 * mass.max()
    return np.asarray(np.abs(stiffness[massive]) / mass[massive])


def low_shift(pencil: Pencil, fmax: float) -> float:
    """Where K − σM is factorised for all modes up to `fmax`, Hz: (rad/s)², beyond the rounding of
    rigid-body modes.
    """
    return shift_below(
        start_shift(pencil.stiffness.diagonal(), pencil.mass.diagonal()), fmax
    )


def shift_below(start: float, fmax: float) -> float:
    """`low_shift` where the first guess is known."""
    return min(-LOW * eigenvalue(fmax), SEARCH.rounding * start)


def suitable_shift(values: Float) -> float:
    """The distance of a good shift below zero: of the order of the first elastic λ, not under 1e-3
    of the last.
    """
    top = float(np.abs(values).max())
    elastic = values[values > 1e-6 * top]
    first = float(elastic.min()) if elastic.size else top
    return max(0.3 * first, 1e-3 * top) or 1.0


def find_shift(pencil: Pencil, count: int) -> tuple[float, lanczos.Krylov, int]:
    """Probe with a few Lanczos blocks and move the shift until it suits the modes that are asked
    for.

    The probe of the last shift is the beginning of the solution, in which so many modes near zero
    are known.
    """
    shift = start_shift(pencil.stiffness.diagonal(), pencil.mass.diagonal())
    nearest = SEARCH.rounding * shift
    known = (np.zeros((pencil.size, 0)), np.zeros(0))
    searched = False
    for last in (*(False,) * SEARCH.tries, True):
        still = known[1].size
        columns = lanczos.capacity(pencil.size, max(count - still, 0) + EXTRA, still)
        krylov = lanczos.Krylov(
            pencil.at(shift),
            pencil.mass,
            columns,
            rng=np.random.default_rng(0),
            labels=pencil.labels,
        )
        krylov.start(known[0], 1 / (known[1] - shift))
        if last:
            break
        for _ in range(SEARCH.blocks):
            if krylov.ahead:
                krylov.step()
        theta, _, error = krylov.ritz()
        if (
            not searched
            and (
                np.abs(shift + 1 / theta[: lanczos.BLOCK]) < SEARCH.still * -shift
            ).all()
        ):
            values, vectors, shift = near_zero_modes(pencil, shift)
            known = (vectors, values)
            searched = True
            nearest = min(
                nearest, -SEARCH.noise * float(np.abs(values).max(initial=0.0))
            )
            continue
        theta = theta[still:]
        error = error[still:]
        if not theta.size:  # there are no others
            break
        first = shift + 1 / float(theta[0])
        if error[0] > SEARCH.blurred * theta[0] and first < -shift:
            shift = min(-0.3 * abs(first), 1e-4 * shift, nearest)
            continue
        values = (shift + 1 / theta[theta > 1e-12 * theta.max()])[: SEARCH.modes]
        better = -suitable_shift(values)
        top = float(np.abs(values).max())
        # of the order of the highest mode asked for
        far = 2 * top * max(count / SEARCH.modes, 1.0)
        if -SEARCH.near * top > shift > -far or (better > shift and shift == nearest):
            break
        shift = min(better, nearest)
    return shift, krylov, still


def near_zero_modes(pencil: Pencil, shift: float) -> tuple[Float, Float, float]:
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
    factor = pencil.at(middle)
    last = np.inf
    x = factor.solve(
        pencil.mass @ np.random.default_rng(0).standard_normal((pencil.size, count))
    )
    for _ in range(SUBSPACE.turns):
        values, x = rayleigh_ritz(pencil, x)
        y = factor.solve(pencil.mass @ x)
        rest = y * (values - middle) - x
        error = float(
            np.sqrt(np.abs(np.einsum("ij,ij->j", rest, pencil.mass @ rest)).max())
        )
        # what is left is the rounding of K
        if error < SUBSPACE.settled and error > last / 2:
            return values, x, middle
        x = y
        last = error
    return none


def _group(pencil: Pencil, shift: float) -> tuple[int, float]:
    """How many modes stand below the widest gap, and a shift in the middle of it; 0 if there is no
    gap.
    """
    above = -1
    try:
        # of the first guess: marks between which no mode stands above the group near zero
        for high, low in pairwise(-shift * mark for mark in (10.0, 1e-1, 1e-3, 1e-5)):
            above = pencil.at(high).negatives if above < 0 else above
            below = pencil.at(low).negatives
            if below == above > 0:
                return below, -high / 10
            above = below
    except SingularModel:  # a mark stands on a mode
        pass
    return 0, shift
