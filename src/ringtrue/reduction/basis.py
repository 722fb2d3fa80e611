"""A model whose K and M are fixed matrices times functions of its parameters' factors, and where it
is observed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.pencil import Pencil
from ringtrue.errors import InputError
from ringtrue.fem.assembly import System
from ringtrue.fem.parametrisation.derivatives import affine_terms
from ringtrue.fem.parametrisation.interpolation import on_axis
from ringtrue.fem.parametrisation.parameter_groups import Pair
from ringtrue.fem.parametrisation.polynomials import (
    AffineTerm,
    ParameterFunction,
    Product,
)
from ringtrue.model.model import Model

CHUNK = 32  # right-hand sides solved together


@dataclass(frozen=True, slots=True, eq=False)
class AffineSystem:
    """K(a) and M(a) of a model, and where it is observed.

    Attributes
    ----------
    stiffness, mass : (f, f) csr_array float64
        At a = 1.
    parameters : ParameterSet
    terms : tuple of AffineTerm
        K(a) = K(1) + Σ g_t(a) K_t, M likewise; see `fem.parametrisation.derivatives`.
    observe : (channel, f) csr_array float64
    """

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    parameters: ParameterSet
    terms: tuple[AffineTerm, ...]
    observe: sparse.csr_array

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms))

    def terms_of(self, which: int) -> tuple[Pair, ...]:
        """K and M that one parameter adds by itself: of each of its powers, or at some factors
        where it has others.
        """
        own = [t for t in self.terms if which in t.function.which]
        if all(isinstance(t.function, Product) for t in own):
            return tuple(
                (t.stiffness, t.mass) for t in own if t.function.which == (which,)
            )
        k = sparse.csr_array(self.stiffness.shape)
        m = sparse.csr_array(self.mass.shape)
        only = replace(self, stiffness=k, mass=m, terms=tuple(own))
        each = np.arange(len(self.parameters))
        return tuple(
            only.at(np.where(each == which, x, 1.0), 1e-9)  # less is the rounding of 0
            for x in on_axis(self.parameters.parameters[which])
        )

    def at(self, factors: Float, least: float = 0.0) -> Pair:
        """K and M at the factors a (p,); without terms whose functions are up to `least` there."""
        k = self.stiffness
        m = self.mass
        for t in self.terms:
            if abs(value := t.function.value(factors)) > least:
                k = k + value * t.stiffness
                m = m + value * t.mass
        return sparse.csr_array(k), sparse.csr_array(m)


def observed_system(
    model: Model,
    system: System,
    parameters: ParameterSet,
    observation: Observation,
    *,
    progress: Progress = quiet,
) -> AffineSystem:
    """The affine system of a model, of which `system` is assembled."""
    transform = system.transform
    if observation.matrix.shape[1] != transform.shape[0]:
        raise InputError(
            f"the observation has {observation.matrix.shape[1]} DOFs, the model "
            f"{transform.shape[0]}"
        )
    return AffineSystem(
        stiffness=system.stiffness,
        mass=system.mass,
        parameters=parameters,
        terms=affine_terms(model, parameters, system, progress=progress),
        observe=sparse.csr_array(observation.matrix @ transform),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedSystem:
    """The projected system.

    Attributes
    ----------
    parameters : ParameterSet
    vectors : (f, r) float64
        Orthonormal in the nominal energy K − σM; by the free DOFs, or by vectors that others hold
        (`reduction.projected`).
    stiffness, mass : (r, r) float64
        At a = 1.
    terms : tuple of (function, stiffness (r, r), mass (r, r))
    observe : (channel, r) float64
    of : dict
        Positions of the terms that depend on each parameter.
    acting : tuple of two dicts
        The stiffnesses, and the masses, that are not 0, by the positions of their terms.
    """

    parameters: ParameterSet
    vectors: Float
    stiffness: Float
    mass: Float
    terms: tuple[tuple[ParameterFunction, Float, Float], ...]
    observe: Float
    of: dict[int, list[int]] = field(init=False)
    acting: tuple[dict[int, Float], dict[int, Float]] = field(init=False)

    def __post_init__(self) -> None:
        of: dict[int, list[int]] = {}
        for i, (function, _, _) in enumerate(self.terms):
            for which in function.which:
                of.setdefault(which, []).append(i)
        object.__setattr__(self, "of", of)
        matrices = [k for _, k, _ in self.terms], [m for _, _, m in self.terms]
        object.__setattr__(
            self,
            "acting",
            tuple({t: a for t, a in enumerate(each) if a.any()} for each in matrices),
        )

    @property
    def size(self) -> int:
        """Number of vectors."""
        return int(self.vectors.shape[1])


def project(
    system: AffineSystem, vectors: Float, old: ProjectedSystem | None = None
) -> ProjectedSystem:
    """Project on `vectors`; the leading ones are those of `old`, whose products are kept."""
    n = 0 if old is None else old.size
    fresh = vectors[:, n:]

    def block(a: sparse.csr_array, kept: Float | None) -> Float:
        rows = np.flatnonzero(np.diff(a.indptr))  # a region touches few DOFs
        some = 2 * rows.size < a.shape[0]
        right = vectors[rows].T @ (a[rows] @ fresh) if some else vectors.T @ (a @ fresh)
        if kept is None:
            return np.asarray((right + right.T) / 2)
        corner = (right[n:] + right[n:].T) / 2
        return np.block([[kept, right[:n]], [right[:n].T, corner]])

    pairs = [
        (system.stiffness, system.mass),
        *((t.stiffness, t.mass) for t in system.terms),
    ]
    kept: list[tuple[Float | None, Float | None]] = [(None, None)] * len(pairs)
    if old is not None:
        kept = [(old.stiffness, old.mass), *((k, m) for _, k, m in old.terms)]
    blocks = [
        (block(k, kept_k), block(m, kept_m))
        for (k, m), (kept_k, kept_m) in zip(pairs, kept, strict=True)
    ]
    terms = tuple(
        (t.function, *b) for t, b in zip(system.terms, blocks[1:], strict=True)
    )
    return ProjectedSystem(
        parameters=system.parameters,
        vectors=vectors,
        stiffness=blocks[0][0],
        mass=blocks[0][1],
        terms=terms,
        observe=np.asarray(system.observe @ vectors),
    )


Inner = Callable[[Float, Float], Float]  # aᵀ(K − σM)b of columns a, b: (k, l)


def inner_product(
    stiffness: sparse.csr_array, mass: sparse.csr_array, shift: float
) -> Inner:
    """That of the energy K − σM, for columns over all free DOFs."""
    energy = sparse.csr_array(stiffness - shift * mass)
    return lambda a, b: np.asarray(a.T @ (energy @ b))


@dataclass(frozen=True, slots=True, eq=False)
class StaticSensitivities:
    """(K − σM)⁻¹ (K_j − λ_k M_j) φ_k of terms j and modes k, without the part in the modes, scaled
    to the energy of mode k.

    Attributes
    ----------
    values : (n,) float64, (rad/s)²
    shapes : (f, n) float64
        Of unit modal mass, in the rows of the terms.
    shift : float, (rad/s)²
    respond : callable
        Static responses to loads (f, k) in the rows of the terms, both free of the modes.
    inner : callable
    """

    values: Float
    shapes: Float
    shift: float
    respond: Callable[[Float, Progress], Float]
    inner: Inner

    @classmethod
    def of(cls, pencil: Pencil, modes: EigenModes, count: int) -> StaticSensitivities:
        """Of the lowest modes of a model that this process holds as a whole."""
        return cls(
            values=modes.values[:count],
            shapes=modes.vectors[:, :count],
            shift=modes.shift,
            respond=partial(_responses, pencil, modes),
            inner=inner_product(pencil.stiffness, pencil.mass, modes.shift),
        )

    def of_each(self, terms: Sequence[Pair], progress: Progress) -> Float:
        """Of each term and mode, (f, terms · count); at least one term."""
        found = []
        for done, term in enumerate(terms):
            load = np.zeros(self.shapes.shape, order="F")
            rows, load[rows] = self._forces(term)
            found.append(self.respond(load, quiet))
            progress((done + 1) / len(terms), "static sensitivities")
        return np.concatenate(found, axis=1)

    def mixed(self, terms: Sequence[Pair], columns: int, progress: Progress) -> Float:
        """As many random mixtures of all of them: their range, for a solve each (Halko et al. 2011,
        4.1).
        """
        rng = np.random.default_rng(0)
        load = np.zeros((len(self.shapes), columns))
        for term in terms:  # over parameters and their powers
            rows, forces = self._forces(term)
            mixture = rng.standard_normal((self.values.size, columns)) / np.sqrt(
                columns
            )
            load[rows] += forces @ mixture
        return self.respond(load, progress)

    def _forces(self, term: Pair) -> tuple[Int, Float]:
        """The rows that a term touches, and its forces (r, n) there."""
        stiffness, mass = term
        rows = np.union1d(*(np.flatnonzero(np.diff(a.indptr)) for a in term))
        phi = self.shapes
        lam = self.values
        scale = 1 / np.sqrt(np.maximum(lam - self.shift, np.abs(self.shift)))
        return rows, (stiffness[rows] @ phi - (mass[rows] @ phi) * lam) * scale


def _responses(
    pencil: Pencil, modes: EigenModes, load: Float, progress: Progress
) -> Float:
    """Static responses to loads (f, k), both free of the modes; by columns, as the factor takes and
    gives them.
    """
    factor = pencil.at(modes.shift)
    phi = modes.vectors
    mphi = pencil.mass @ phi
    x = np.empty(load.shape, order="F")
    for s in range(0, load.shape[1], CHUNK):
        some = load[:, s : s + CHUNK].T
        part = factor.solve((some - (some @ phi) @ mphi.T).T).T
        x[:, s : s + CHUNK] = (part - (part @ mphi) @ phi.T).T
        progress(min(1.0, (s + CHUNK) / load.shape[1]), "static sensitivities")
    return x


def principal(inner: Inner, x: Float, most: int, drop: float) -> Float:
    """Principal directions of x in the energy K − σM, at most `most`, above `drop` of the largest,
    in their size.
    """
    if not x.shape[1] or most <= 0:
        return x[:, :0]
    gram = inner(x, x)
    s, u = linalg.eigh((gram + gram.T) / 2)
    keep = np.flatnonzero(s > drop**2 * s[-1])[::-1][:most]
    return x @ u[:, keep]


def compress(inner: Inner, x: Float, most: int, drop: float) -> Float:
    """The principal directions of x, each of unit energy."""
    return _scaled(inner, principal(inner, x, most, drop))


def _scaled(inner: Inner, x: Float) -> Float:
    """Each column with unit energy; few at a time, of which no other products are needed."""
    parts = [x[:, s : s + CHUNK] for s in range(0, x.shape[1], CHUNK)]
    energy = np.concatenate(
        [np.empty(0), *(np.diag(inner(part, part)) for part in parts)]
    )
    return np.asarray(x / np.sqrt(energy))


def orthonormal_part(inner: Inner, old: Float, x: Float) -> Float:
    """Part of x outside `old`, orthonormal in the energy K − σM as `old` is; what is nearly inside
    is dropped.

    Energy and not mass: a part too small to be seen in the mass may still be too stiff to be left
    out.
    """
    if not x.shape[1]:
        return x
    x = _scaled(inner, x)
    for _ in range(2):
        x = x - old @ inner(old, x)
    s, u = linalg.eigh(inner(x, x))
    keep = s > 1e-13
    q = x @ (u[:, keep] / np.sqrt(s[keep]))
    for _ in range(2):  # what was kept may have been small
        q = q - old @ inner(old, q)
        s, u = linalg.eigh(inner(q, q))
        q = q @ (u / np.sqrt(s))
    return q
