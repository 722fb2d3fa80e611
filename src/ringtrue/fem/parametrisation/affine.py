"""K and M as functions of all parameters together: fixed matrices times functions of the factors.

Where all that acts on an element are polynomials, these are products of powers, exactly
(`products`); on the other elements they are what interpolates the matrices between chosen factors
(`interpolation`).
"""

from __future__ import annotations

from dataclasses import replace

from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.core.progress import Progress, part
from ringtrue.errors import UnsupportedError
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import Mesh, mesh, union, without
from ringtrue.fem.parametrisation.interpolation import interpolated
from ringtrue.fem.parametrisation.interpolation_nodes import MOST, learn
from ringtrue.fem.parametrisation.parameter_groups import Group, cubic, few, groups_of, regions
from ringtrue.fem.parametrisation.polynomials import AffineTerm, products
from ringtrue.model.model import Model

SAMPLE = 40  # elements of a kind that tell a polynomial


def affine_terms(
    model: Model,
    parameters: ParameterSet,
    system: System,
    *,
    progress: Progress | None = None,
) -> tuple[AffineTerm, ...]:
    """The parts of K(a) = K(1) + Σ g_t(a) K_t, M likewise, in the free degrees of freedom.

    What is a polynomial of degree three or less in each factor is exact; the rest (laminates, the
    sections of beams with shear, Poisson's ratio) is interpolated between the bounds, to 1e-8 of
    the roots of the diagonal entries. Only the affected elements are computed.

    Raises
    ------
    UnsupportedError
        If a parameter moves nodes, or the matrices are no smooth function of it between its bounds.
    InputError
        If a target or element is not in the model.
    """
    m = mesh(model)
    groups = [g for i, p in enumerate(parameters.parameters) for g in groups_of(model, i, p)]
    powers = [_parts(m, g) for g in groups]
    smooth = {k for k, some in enumerate(powers) if some is not None}
    linear = {k for k, some in enumerate(powers) if some == (1,)}
    while True:
        curved = union(g.rows for k, g in enumerate(groups) if k not in smooth)
        rest = {k: replace(groups[k], rows=without(groups[k].rows, curved)) for k in sorted(smooth)}
        terms, lost = products(m, rest, linear, system=system, progress=part(progress, 0.0, 0.5))
        if not lost:
            return (
                *terms,
                *interpolated(m, groups, curved, system=system, progress=part(progress, 0.5, 1.0)),
            )
        smooth -= lost  # elements that are not in the sample, or what two of them do together


def matrices_kept(model: Model, *parameters: Parameter, most: int = MOST) -> int | None:
    """How many matrices the interpolation of parameters together keeps of an element, seen on a
    sample of elements.

    0 where powers of each do; None where K and M are no smooth function of them (`affine_terms` has
    no parts), or take more than `most`.

    Raises
    ------
    InputError
        If a target or element is not in the model.
    """
    m = mesh(model)
    groups = [g for i, p in enumerate(parameters) for g in groups_of(model, i, p)]
    try:
        parts = [_parts(m, g) for g in groups]
        rough = [g.rows for g, powers in zip(groups, parts, strict=True) if powers is None]
        found = [n for rows in rough for n in learn(m, regions(groups, few(rows, SAMPLE)), most)]
    except UnsupportedError:
        return None
    return max((len(n.factors) for n in found), default=0) if rough or any(parts) else None


def _parts(m: Mesh, g: Group) -> tuple[int, ...] | None:
    """The powers of a polynomial, seen in a sample; None if it is none."""
    try:
        return tuple(cubic(m, replace(g, rows=few(g.rows, SAMPLE))))
    except UnsupportedError:
        return None
