"""FRFs of given poles with the residues that fit measured ones best, for a look at a choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.signals import FrfSet
from ringtrue.identification.frf.lines import (
    Lines,
    functions,
    mirrored,
    mirrored_rows,
    prepare,
)
from ringtrue.identification.frf.residues import (
    driving_pairs,
    lsfd,
    noise,
    solve_shapes,
    synthesise_windowed,
)


def weighted_lines(frfs: FrfSet) -> Lines:
    """The lines of FRFs (> 0 Hz) as a fit takes them; the same for all poles."""
    return prepare(frfs, noise(frfs))


def fit_poles(frfs: FrfSet, lines: Lines, poles: Complex) -> FrfSet:
    """The FRFs of a modal model of given poles, its residues of rank one and residual terms fitted
    as in an identification.

    Parameters
    ----------
    frfs : FrfSet, lines > 0 Hz
    lines : Lines
        `weighted_lines` of them.
    poles : (m,) complex128, rad/s
        Without the exponential window.
    """
    part = participations(lines, poles)
    shapes = solve_shapes(lines, poles, part)
    model = lsfd(frfs, lines, poles, part, shapes=shapes, points=driving_pairs(frfs))
    fitted = synthesise_windowed(model, lines)
    return replace(frfs, data=fitted, coherence=np.full(fitted.shape, np.nan))


def participations(lines: Lines, poles: Complex) -> Complex:
    """(m, in) participation vectors of poles: of their free residues the part of rank one that
    holds most.
    """
    q = functions(lines, poles)
    normal = mirrored(q.conj().T @ q)
    scale: Float = 1 / np.sqrt(np.maximum(np.diag(normal).real, np.finfo(float).tiny))
    right = scale[:, None] * mirrored_rows(q.conj().T @ lines.y)
    free = np.linalg.pinv(scale[:, None] * normal * scale, hermitian=True) @ right
    residue = (scale[:, None] * free)[:, : poles.size] * lines.response  # (in, m, out)
    left, _, _ = np.linalg.svd(residue.transpose(1, 0, 2), full_matrices=False)
    return np.asarray(left[:, :, 0] / lines.input, dtype=np.complex128)
