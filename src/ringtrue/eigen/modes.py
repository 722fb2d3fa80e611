"""Modes of K φ = λ M φ with a proof that none is missing: choice of the shift, solution, inertia
counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.core.iterate import Progress, quiet
from ringtrue.eigen import lanczos
from ringtrue.eigen.eigenpairs import EigenModes, eigenvalue, frequencies, polish
from ringtrue.eigen.lanczos import rayleigh_ritz
from ringtrue.eigen.pencil import SIZES, Pencil, refuse_negative_mass, spectrum
from ringtrue.eigen.shift import (
    EXTRA,
    find_shift,
    low_shift,
    rounding_shift,
    start_shift,
    suitable_shift,
)
from ringtrue.errors import InputError, NumericalError, SingularModel


@dataclass(frozen=True, slots=True)
class ModeChecks:
    """What is asked of the pairs before they are the modes.

    Attributes
    ----------
    gap : float
        Share of λ: a narrower gap is too narrow for a count.
    fine : float
        Share of λ: with a shift nearer to zero the rigid-body modes cost the others digits; refined
        once.
    sharp : float
        Relative residual of all pairs together, beyond which they are refined once.
    same : float
        Share of the distance from the shift, by which a shape's Rayleigh quotient may miss what was
        counted.
    edge : float
        Share of λ beyond the ends of a band that counts as within.
    """

    gap: float = 1e-4
    fine: float = 1e-6
    sharp: float = 1e-5
    same: float = 1e-2
    edge: float = 1e-9


CHECKS = ModeChecks()


@dataclass(frozen=True, slots=True)
class _Count:
    below: int  # eigenvalues under `shift`
    shift: float


def solve_modes(
    pencil: Pencil,
    count: int = 20,
    *,
    band: tuple[float, float] | None = None,
    shift: float | None = None,
    progress: Progress = quiet,
) -> EigenModes:
    """The lowest `count` modes, or all in `band`.

    Parameters
    ----------
    pencil : Pencil
    count : int
    band : (low, high), Hz, optional
        In its place; a mode at an end is in it.
    shift : float, optional
        A known good negative shift (rad/s)²; found from the problem if not given.

    Raises
    ------
    InputError
        On a count below 1 or an empty band.
    SingularModel
        If K − σM is singular: a mechanism without mass.
    NumericalError
        If the mass is negative in some direction.
    NotConverged
        If Lanczos does not converge.
    """
    if band is None and count < 1:
        raise InputError(f"{count} modes asked for; at least 1")
    if band is not None and not band[1] > band[0]:
        raise InputError(f"band {band[0]} to {band[1]} Hz is empty")
    if not pencil.mass.nnz or not np.abs(pencil.mass.data).max() > 0:
        raise InputError("the mass matrix is zero: check densities and mass elements")
    if pencil.mass.diagonal().max() <= 0:  # nothing that a shift could be guessed from
        refuse_negative_mass(pencil.mass, pencil.labels)
    if pencil.size <= SIZES.always or (band is None and _most_of(pencil, count)):
        return _dense(pencil, count, band)
    refuse_negative_mass(pencil.mass, pencil.labels)
    if band is not None:
        return _band(pencil, band, shift, progress)
    return _lowest(pencil, count, shift, progress)


def _most_of(pencil: Pencil, count: int) -> bool:
    """So many of the modes of a small system that the dense solution is faster."""
    return pencil.size <= SIZES.limit and count > SIZES.share * pencil.size


def _dense(pencil: Pencil, count: int, band: tuple[float, float] | None) -> EigenModes:
    shift = start_shift(pencil.stiffness.diagonal(), pencil.mass.diagonal())
    farthest = min(1e3 * shift, rounding_shift(pencil.stiffness, pencil.mass))
    values, vectors = _first_definite(pencil, (shift, 1e3 * shift, farthest))
    for _ in range(4):  # each pass places the shift better
        n = (
            min(count, values.size)
            if band is None
            else int((values <= eigenvalue(band[1])).sum())
        )
        better = -suitable_shift(values[: max(n, 1)])
        if 0.1 < better / shift < 10:
            break
        try:
            values, vectors = _first_definite(pencil, (better, 1e3 * better))
        # all that is asked for is rounding: the shift before is near enough
        except SingularModel:
            break
        shift = better
    if band is None:
        at = np.arange(min(count, values.size))
    else:
        at = np.flatnonzero(
            (values >= _low(band) * (1 - CHECKS.edge))
            & (values <= eigenvalue(band[1]) * (1 + CHECKS.edge))
        )
    values, vectors, residuals, orthogonality = polish(
        pencil.stiffness, pencil.mass, values[at], vectors[:, at]
    )
    proof = f"all eigenvalues of the {pencil.size} DOFs were computed"
    return EigenModes(
        values=values,
        vectors=vectors,
        residuals=residuals,
        orthogonality=orthogonality,
        complete=True,
        proof=proof,
        shift=shift,
    )


def _low(band: tuple[float, float]) -> float:
    """The lowest eigenvalue of a band; one from 0 Hz takes rigid-body modes along, which may stand
    a little below.
    """
    return eigenvalue(band[0]) if band[0] > 0 else -np.inf


def _first_definite(pencil: Pencil, shifts: tuple[float, ...]) -> tuple[Float, Float]:
    """The solution from the first shift that is not too near to zero, as of a free structure."""
    for shift in shifts[:-1]:
        try:
            return spectrum(pencil.stiffness, pencil.mass, shift, pencil.labels)
        except SingularModel:
            continue
    # or a mechanism
    return spectrum(pencil.stiffness, pencil.mass, shifts[-1], pencil.labels)


def _lowest(
    pencil: Pencil, count: int, shift: float | None, progress: Progress
) -> EigenModes:
    pencil.reserve(lanczos.capacity(pencil.size, count + EXTRA) + 3 * count)
    progress(0.0, f"factorising {pencil.size} DOFs")
    shift, begun, still = (
        (shift, None, 0) if shift is not None else find_shift(pencil, count)
    )
    factor = pencil.at(shift)
    start = _Count(factor.negatives, shift)
    most = max(count, still)

    def enough(theta: Float) -> bool:
        values = np.sort(shift + 1 / theta)
        return (
            values.size > count and _gap_after(values, count, shift) is not None
        ) or values.size >= most + 40

    expected = most + EXTRA
    if begun is None:
        begun = lanczos.begin(factor, pencil, expected)
    pairs = lanczos.solve(begun, enough, expected=expected, progress=progress)
    del begun
    pairs = _sharp(pencil, pairs, shift)
    values = np.sort(shift + 1 / pairs.theta)
    at = _gap_after(values, count, shift)
    if pairs.exhausted:
        complete = True
        proof = f"the mass has rank {values.size}: all modes were found"
    elif at is None:
        complete, proof = _proved_below(pencil, values[:count], values[-1], start)
    else:
        mark = (
            float((values[at - 1] + values[at]) / 2)
            if at < values.size
            else float(1.01 * values[-1])
        )
        top = _Count(pencil.at(mark).negatives, mark)
        if top.below > at and start.below == 0:
            # fewer are found sooner than a lower end
            if top.below > at + lanczos.BLOCK:
                top = _lowest_end(pencil, values[:at], count, top=top, shift=shift)
            pairs = _filled(pencil, pairs, shift, top)
            at = int((shift + 1 / pairs.theta < top.shift).sum())
        complete, proof = _judge(top.below, at, start, top.shift)
    return _finish(
        pencil, pairs, shift, take=slice(0, count), complete=complete, proof=proof
    )


def _sharp(pencil: Pencil, pairs: lanczos.RitzPairs, shift: float) -> lanczos.RitzPairs:
    """The pairs, after a step of subspace iteration where they need one.

    They do where the shift is too near to zero, and after a long recurrence with a singular mass:
    it does not see some motions, of which the rounding grows from step to step.
    """
    near = (
        0
        < -shift
        < CHECKS.fine * float(np.abs(shift + 1 / pairs.theta).max(initial=0.0))
        and not pairs.exhausted
    )
    if not near and _residual(pencil, pairs, shift) < CHECKS.sharp:
        return pairs
    x = pencil.at(shift).solve(pencil.mass @ pairs.vectors) / pairs.theta
    values, vectors = rayleigh_ritz(pencil, x)
    return lanczos.RitzPairs(1 / (values - shift), vectors, pairs.exhausted)


def _residual(pencil: Pencil, pairs: lanczos.RitzPairs, shift: float) -> float:
    """‖(K − σM)Xθ − MX‖ / ‖MX‖ of one combination of all pairs."""
    x = pairs.vectors @ np.column_stack([np.ones(pairs.theta.size), pairs.theta])
    load = pencil.mass @ x
    rest = pencil.stiffness @ x[:, 1] - shift * load[:, 1] - load[:, 0]
    return float(
        np.linalg.norm(rest) / max(np.linalg.norm(load[:, 0]), np.finfo(float).tiny)
    )


def _lowest_end(
    pencil: Pencil, values: Float, count: int, top: _Count, shift: float
) -> _Count:
    """The lowest gap between the values (k,) below which `count` eigenvalues stand or more; `top`
    if there is none.
    """
    gaps = np.flatnonzero(_gaps(values, shift))
    low = 0
    high = gaps.size
    while low < high:
        middle = (low + high) // 2
        at = _counted(pencil, float(values[gaps[middle] :][:2].mean()), 1)
        if at.below >= count:
            high = middle
            top = at
        else:
            low = middle + 1
    return top


def _filled(
    pencil: Pencil,
    pairs: lanczos.RitzPairs,
    sigma: float,
    top: _Count,
    bottom: _Count | None = None,
    progress: Progress = quiet,
) -> lanczos.RitzPairs:
    """The pairs with all others between `bottom`, or the lowest, and `top`: sought from `sigma` as
    long as more come.

    A search goes on with random directions orthogonal to what is known: a root repeated more often
    than a block is wide comes a block at a time.
    """
    factor = pencil.at(sigma)
    low, expected = (
        (-np.inf, top.below)
        if bottom is None
        else (bottom.shift, top.below - bottom.below)
    )

    def inside(theta: Float) -> Bool:
        values = sigma + 1 / theta
        return (values < top.shift) & (values > low)

    found = int(inside(pairs.theta).sum())
    before = -1
    while before < found < expected:
        keep = inside(pairs.theta)
        locked = (pairs.theta[keep], pairs.vectors[:, keep])
        before = found
        more = expected - found + EXTRA
        pairs = lanczos.solve(
            lanczos.begin(factor, pencil, more, locked),
            lambda theta: (
                inside(theta).sum() >= expected
                or _beyond(sigma + 1 / theta, top, bottom)
            ),
            expected=more,
            known=locked[0].size,
            progress=progress,
        )
        pairs = _sharp(pencil, pairs, sigma)
        found = int(inside(pairs.theta).sum())
    return pairs


def _gap_after(values: Float, count: int, shift: float) -> int | None:
    """How many values stand below the first sufficient gap at or after `count`; None if there is
    none yet.

    Rigid-body modes differ by rounding only, however many of them are known: the shift says
    their scale.
    """
    wide = _gaps(values, shift)[max(count - 1, 0) :]
    return count + int(np.argmax(wide)) if wide.any() else None


def _gaps(values: Float, shift: float) -> Any_:
    """Between which values (k,) the gap (k - 1,) is wide enough for a count."""
    least = max(1e-6 * abs(float(values[-1])), 1e-3 * abs(shift))
    return np.diff(values) > CHECKS.gap * np.maximum(np.abs(values[1:]), least)


def _proved_below(
    pencil: Pencil, values: Float, top: float, start: _Count
) -> tuple[bool, str]:
    """Where repeated roots have no end in sight, up to `top`: a count below the last group of
    them.
    """
    at = int(np.flatnonzero(_gaps(values, start.shift)).max(initial=-1)) + 1
    mark = float((values[at - 1] if at else start.shift) + values[at]) / 2
    complete, proof = _judge(pencil.at(mark).negatives, at, start, mark)
    if top - values[at] > CHECKS.gap * max(abs(top), abs(start.shift)):
        return False, f"{proof}; no gap above the highest mode: not counted there"
    return complete, f"{proof}; above stands one root, {values.size - at} times or more"


def _judge(counted: int, found: int, start: _Count, mark: float) -> tuple[bool, str]:
    hz = float(frequencies(np.array([mark]))[0])
    if counted < 0 or start.below < 0:
        return False, "the factorisation gives no inertia: not counted"
    where = (
        f"{counted} eigenvalues below {hz:.6g} Hz by inertia (Sturm), {start.below} below "
        "the shift; "
    )
    if counted == found and start.below == 0:
        return True, where + f"{found} found"
    return False, where + f"{found} found: NOT complete"


def _band(
    pencil: Pencil,
    band: tuple[float, float],
    shift: float | None,
    progress: Progress,
) -> EigenModes:
    low = _low(band)
    high = eigenvalue(band[1])
    progress(0.0, f"factorising {pencil.size} DOFs")
    top = _counted(pencil, high, 1)
    bottom = _counted(pencil, low, -1) if band[0] > 0 else _Count(0, -np.inf)
    wanted = top.below - bottom.below
    # then it is cheaper to take the lower ones along
    few = bottom.below <= 0.5 * wanted + 2 * lanczos.BLOCK
    if few:
        sigma = low_shift(pencil, band[1]) if shift is None else shift
        expected = top.below
    else:
        sigma = (low + high) / 2
        expected = wanted
    if sigma < 0:
        below = pencil.at(sigma).negatives
        if below != 0:
            raise NumericalError(
                f"{below} eigenvalues below {sigma:.4g} (rad/s)^2: the stiffness is indefinite "
                "or the inertia "
                "is not available; ask for a number of modes in place of a band"
            )
    if not wanted:
        proof = (
            f"no eigenvalue between {band[0]:g} and {band[1]:g} Hz by inertia (Sturm)"
        )
        empty = np.zeros((pencil.size, 0))
        return EigenModes(
            values=np.zeros(0),
            vectors=empty,
            residuals=np.zeros(0),
            orthogonality=0.0,
            complete=True,
            proof=proof,
            shift=pencil.shift,
        )
    if _most_of(pencil, expected):
        return _dense(pencil, wanted, band)
    pencil.reserve(lanczos.capacity(pencil.size, expected + EXTRA) + 3 * expected)
    none = lanczos.RitzPairs(np.zeros(0), np.zeros((pencil.size, 0)), False)
    pairs = _filled(
        pencil, none, sigma, top=top, bottom=None if few else bottom, progress=progress
    )
    proof = (
        f"{wanted} eigenvalues between {band[0]:g} and {band[1]:g} Hz by inertia (Sturm) at "
        "both ends"
    )
    values = sigma + 1 / pairs.theta
    at = np.flatnonzero((values >= bottom.shift) & (values <= top.shift))
    chosen = lanczos.RitzPairs(pairs.theta[at], pairs.vectors[:, at], pairs.exhausted)
    complete = at.size == wanted
    return _finish(
        pencil,
        chosen,
        sigma,
        take=slice(None),
        complete=complete,
        proof=proof + f"; {at.size} found",
    )


def _beyond(values: Float, top: _Count, bottom: _Count | None) -> bool:
    """Both ends of the band have been passed by several modes: what is still missing needs new
    directions.
    """
    over = (values > top.shift).sum() >= EXTRA
    return bool(over and (bottom is None or (values < bottom.shift).sum() >= EXTRA))


def _counted(pencil: Pencil, value: float, side: int) -> _Count:
    """Inertia at a band end, moved outward by 1e-9 for a mode that stands there, and on if one does
    then.

    Without inertia the count is negative.
    """
    found = None
    for push in (CHECKS.edge, 3 * CHECKS.edge, 1000 * CHECKS.edge):
        at = value * (1 + side * push)
        try:
            found = _Count(pencil.at(at).negatives, at)
        except SingularModel:
            continue
        if found.below >= 0:
            break
    if found is None:
        raise NumericalError(
            f"cannot count at {value:.6g} (rad/s)^2: a band end stands on a mode; move it"
        )
    return found


def _finish(
    pencil: Pencil,
    pairs: lanczos.RitzPairs,
    shift: float,
    take: slice,
    complete: bool,
    proof: str,
) -> EigenModes:
    roots = np.sort(shift + 1 / pairs.theta)
    values, vectors, residuals, orthogonality = polish(
        pencil.stiffness, pencil.mass, shift + 1 / pairs.theta, pairs.vectors
    )
    if (np.abs(values - roots) > CHECKS.same * np.abs(roots - shift)).any():
        complete = False
        proof = f"{proof}; their shapes have other eigenvalues: NOT complete"
    if pairs.theta.size > 1 and orthogonality > 1e-10:
        values, vectors = rayleigh_ritz(pencil, vectors)
        values, vectors, residuals, orthogonality = polish(
            pencil.stiffness, pencil.mass, values, vectors
        )
    return EigenModes(
        values=values[take],
        vectors=vectors[:, take],
        residuals=residuals[take],
        orthogonality=orthogonality,
        complete=complete,
        proof=proof,
        shift=shift,
    )
