"""Modes, static deflections and frequency responses as a program recorded them, and what makes
results of them: frames, scale and labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Float, Int, freeze_arrays
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.errors import DataError
from ringtrue.io.files import refuse_large
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model

SCALE = 1e-4  # modal masses this near to 1 are 1: a program prints seven digits


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotions:
    """Motions of nodes in a results file.

    Attributes
    ----------
    nodes : (n,) int64
    scalar : (n,) bool
        Scalar points: their motion is the first component.
    motion : (n, 6, m) float64, of responses complex128
        Translations and rotations in each node's displacement frame (or basic, see `frames`).
    frames : (n,) int64
        The displacement frame (CD) of each node as the file says; -1 where it does not; 0 is basic.
    """

    nodes: Int
    scalar: Bool
    motion: Any_
    frames: Int


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDeflections(RecordedMotions):
    """Static deflections (n, 6, case); `cases` are the numbers of the subcases."""

    cases: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)
        refuse_large(self.motion, "deflection")


@dataclass(frozen=True, slots=True, eq=False)
class RecordedResponses(RecordedMotions):
    """Frequency responses (n, 6, f) of a subcase.

    Attributes
    ----------
    frequencies : (f,) float64, Hz
    quantity : str
        "displacements", "velocities" or "accelerations".
    case : int
        Number of the subcase.
    """

    frequencies: Float
    quantity: str
    case: int

    def __post_init__(self) -> None:
        freeze_arrays(self)
        refuse_large(self.motion, "response")


@dataclass(frozen=True, slots=True, eq=False)
class RecordedModes(RecordedMotions):
    """Modes (n, 6, m).

    Attributes
    ----------
    eigenvalues : (m,) float64, (rad/s)²
    modal_mass : (m,) float64
        Generalised masses; NaN where the file does not say.
    """

    eigenvalues: Float
    modal_mass: Float

    def __post_init__(self) -> None:
        freeze_arrays(self)
        n = self.nodes.size
        m = self.eigenvalues.size
        if not m or not n:
            raise DataError(
                "no modes with shapes: ask the program for DISPLACEMENT = ALL"
            )
        if (
            self.motion.shape != (n, 6, m)
            or self.modal_mass.shape != (m,)
            or self.scalar.shape != (n,)
        ):
            raise DataError(
                f"{m} eigenvalues and {n} nodes do not fit shapes {self.motion.shape}"
            )
        if np.unique(self.nodes).size != n:
            raise DataError(
                "a node occurs twice in a mode: the file holds several subcases or superelements"
            )
        if not (np.isfinite(self.eigenvalues).all() and np.isfinite(self.motion).all()):
            raise DataError("a number is not finite")
        refuse_large(self.eigenvalues, "eigenvalue")
        refuse_large(self.motion, "motion")


Rows = Sequence[tuple[Int, Bool, Any_]]


def motions(rows: Rows, frames: dict[int, int] | None = None) -> RecordedMotions:
    """One object of the rows of each mode or case: nodes (n,), scalar (n,), motion (n, 6), equal
    nodes in all.

    Raises
    ------
    DataError
        If they are given at different nodes.
    """
    nodes, scalar, _ = rows[0]
    for k, (other, _, _) in enumerate(rows):
        if not np.array_equal(other, nodes):
            raise DataError(
                f"number {k + 1} is given at {other.size} nodes, the first at {nodes.size}: the "
                "file is cut off?"
            )
    known = frames or {}
    cd = np.array([known.get(n, -1) for n in nodes.tolist()], dtype=np.int64)
    return RecordedMotions(nodes, scalar, np.stack([r[2] for r in rows], axis=2), cd)


def gathered(
    eigenvalues: Float,
    modal_mass: Float,
    rows: Rows,
    frames: dict[int, int] | None = None,
) -> RecordedModes:
    """Modes of the rows of each; see `motions`.

    Raises
    ------
    DataError
        If there are none, or the modes are given at different nodes.
    """
    if not rows:
        raise DataError("no modes with shapes: ask the program for DISPLACEMENT = ALL")
    m = motions(rows, frames)
    return RecordedModes(**_fields(m), eigenvalues=eigenvalues, modal_mass=modal_mass)


def deflections(m: RecordedMotions, cases: tuple[int, ...]) -> RecordedDeflections:
    """Motions that are static deflections of subcases."""
    return RecordedDeflections(**_fields(m), cases=cases)


def responses(
    m: RecordedMotions, frequencies: Float, quantity: str, case: int
) -> RecordedResponses:
    """Motions that are frequency responses of a subcase, frequencies (f,) in Hz."""
    return RecordedResponses(
        **_fields(m), frequencies=frequencies, quantity=quantity, case=case
    )


def _fields(m: RecordedMotions) -> dict[str, Any]:
    return {name: getattr(m, name) for name in ("nodes", "scalar", "motion", "frames")}


def to_deflections(
    found: RecordedDeflections, model: Model | None = None
) -> tuple[DofSet, Float]:
    """DOFs, and deflections (case, dof) in the basic frame; see `to_mode_set`."""
    found = _basic(found, model)
    dofs, rows = _labels(found)
    return dofs, found.motion.reshape(-1, len(found.cases))[rows].T


def to_responses(
    found: RecordedResponses, model: Model | None = None
) -> tuple[DofSet, Any_]:
    """DOFs, and responses (frequency, dof) complex128 in the basic frame; see `to_mode_set`."""
    found = _basic(found, model)
    dofs, rows = _labels(found)
    return dofs, found.motion.reshape(-1, found.frequencies.size)[rows].T


def to_mode_set(
    found: RecordedModes,
    model: Model | None = None,
    *,
    mass_normalised: bool = False,
    source: str = "",
) -> ModeSet:
    """Modes in ascending frequency, in the basic frame, of unit modal mass where the file gives the
    masses.

    Parameters
    ----------
    found : RecordedModes
    model : Model, optional
        The deck; its displacement frames (CD) turn the shapes to basic. Rows then follow the order
        of its GRID cards.
    mass_normalised : bool
        The shapes are known to have unit modal mass although the file does not say so.
    source : str

    Raises
    ------
    DataError
        If a node is not in the model, or shapes are in displacement frames that only the deck
        defines.
    """
    found = _basic(found, model)
    order = np.argsort(found.eigenvalues, kind="stable")
    lam = found.eigenvalues[order]
    motion = found.motion
    mass = found.modal_mass
    if (mass > 0).all():
        mass_normalised = True
        motion = motion * np.where(np.abs(mass - 1) < SCALE, 1.0, 1 / np.sqrt(mass))
    dofs, rows = _labels(found)
    return ModeSet(
        frequencies=np.sign(lam) * np.sqrt(np.abs(lam)) / (2 * np.pi),
        damping=np.zeros(lam.size),
        shapes=motion.reshape(-1, lam.size)[rows][:, order],
        labels=dofs,
        norm=Norm.MASS if mass_normalised else Norm.UNSCALED,
        source=source,
    )


def _labels(found: RecordedMotions) -> tuple[DofSet, Int]:
    """Six DOFs a grid point and one a scalar point, grid points first, and their places in (node,
    6).
    """
    order = np.argsort(found.scalar, kind="stable")
    n = np.where(found.scalar[order], 1, 6)
    node = np.repeat(found.nodes[order], n)
    component = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    direction = np.where(np.repeat(found.scalar[order], n), 0, component + 1)
    return DofSet(node, direction), 6 * np.repeat(order, n) + component


Motions = TypeVar("Motions", bound=RecordedMotions)


def _basic(found: Motions, model: Model | None) -> Motions:
    if model is None:
        turned = (found.frames > 0) & ~found.scalar
        if turned.any():
            raise DataError(
                f"node {found.nodes[turned][0]} moves in displacement frame "
                f"{found.frames[turned][0]}; "
                "name the deck, too, to turn its shapes to the basic frame"
            )
        return found
    grid = model["GRID"]
    at = grid.find(found.nodes)
    scalar_points = (
        model["SPOINT"].ragged("ID").values
        if "SPOINT" in model
        else np.empty(0, dtype=np.int64)
    )
    lost = (at < 0) & ~found.scalar & ~np.isin(found.nodes, scalar_points)
    if lost.any():
        raise DataError(
            f"node {found.nodes[lost][0]} is not in the deck: the results are of another model"
        )
    scalar = at < 0
    order = np.lexsort((np.arange(at.size), at, scalar))
    at = at[order]
    frames = found.frames[order]
    turn = np.broadcast_to(np.eye(3), (at.size, 3, 3)).copy()
    g = ~scalar[order] & (frames != 0)
    turn[g] = axes(model, grid["CD"][at[g]], positions(model)[at[g]])
    local = found.motion[order].reshape(at.size, 2, 3, -1)
    basic = np.einsum("nji,nkjm->nkim", turn, local).reshape(at.size, 6, -1)
    zero = np.zeros(at.size, dtype=np.int64)
    return replace(
        found, nodes=found.nodes[order], scalar=scalar[order], motion=basic, frames=zero
    )
