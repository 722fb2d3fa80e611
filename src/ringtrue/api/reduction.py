"""Parts of a model as matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.display import Displayed
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import elastic
from ringtrue.decks.nastran import reader
from ringtrue.decks.nastran.external import ExternalPart, write_part
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.fem.assembly import assemble, refuse_held
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, table
from ringtrue.reduction.components import (
    ReductionSettings,
    kept_rows,
    largest_shift,
    reduce_part,
    reduction_error,
)


@dataclass(frozen=True, eq=False)
class ReducedPart(Displayed):
    """A part reduced to some of its points, with what the reduction does to each of its modes.

    Attributes
    ----------
    frequencies : (mode,) float64, Hz
        Of the whole part, up to the frequency that was asked for.
    reduced : (mode,) float64, Hz
        Of the reduced part; NaN where it has no further mode.
    deviations : (mode,) float64, %
        Of the reduced from the whole; of rigid-body modes in shares of the frequency that was asked
        for.
    captured : (mode,) float64
        Share of the kinetic energy that motions of the reduced part can have.
    bound : float, %
        What the reduction moves a mode at the frequency that was asked for by at most, in any
        whole; lower modes move less, but for the dynamic condensation, which holds at its own.
    kept : tuple of str
        The degrees of freedom of the matrices, modal coordinates last.
    external : ExternalPart
        The matrices, in units of the deck.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "frequencies": "Hz",
        "reduced": "Hz",
        "deviations": "%",
        "captured": "-",
        "bound": "%",
    }

    frequencies: Float
    reduced: Float
    deviations: Float
    captured: Float
    bound: float
    kept: tuple[str, ...]
    external: ExternalPart

    def write(self, stem: str | Path, *, op4: bool = False) -> tuple[Path, ...]:
        """Write `stem`.asm, for the main bulk data of a deck, and `stem`.pch, for its end; with
        `op4` the matrices in `stem`.op4 in place of DMIG.
        """
        return write_part(self.external, stem, op4=op4)


def reduce_model(
    model: Model | str | Path,
    keep: Sequence[str] | str,
    settings: ReductionSettings,
    *,
    number: int = 1,
) -> ReducedPart:
    """Reduce a part to some of its points, as a superelement that other decks include.

    Parameters
    ----------
    model : Model or path of a deck
        With the supports that the part has besides the points that are kept.
    keep : sequence of str
        Points such as `101`, with all of their free degrees of freedom, or `101+Z`.
    settings : ReductionSettings
    number : int
        Of the superelement.

    Raises
    ------
    InputError
        If a point is not in the model, or cannot move.
    SingularModel
        If the part can move while the kept points are held: keep more.

    Examples
    --------
    >>> import ringtrue as rt
    >>> part = rt.reduce_model(rt.example_deck(), "4", rt.ReductionSettings(below=8.0))
    >>> part.kept
    ('4+X', '90010001', '90010002')
    >>> bool(part.bound < 1e-6)  # with all of its modes nothing is lost
    True
    """
    if not isinstance(model, Model):
        model = reader.read_deck(Path(model))
    model = whole_mesh(model)
    system = assemble(model)  # what may spin alone may be held by the rest
    refuse_held(system)
    texts = [keep] if isinstance(keep, str) else keep
    points = DofSet.parse(p for text in texts for p in text.split(","))
    rows = kept_rows(system.free, points)
    part = reduce_part(system, rows, settings)
    found = reduction_error(model, system, part, settings.below)
    flexible = elastic(np.append(found.frequencies, settings.below))[:-1]
    scale = np.where(flexible, found.frequencies, settings.below)
    off = 100 * (found.reduced - found.frequencies) / scale
    first = 90_000_001 + 10_000 * number  # above the numbers of a deck
    modal = np.arange(first, first + part.frequencies.size)
    labels = system.free.take(rows).joined(DofSet(modal, 0 * modal))
    external = ExternalPart(
        number=number,
        points=_boundary(model, system.free.node[rows]),
        rows=labels,
        stiffness=part.stiffness,
        mass=part.mass / model.time**2,
    )
    return ReducedPart(
        frequencies=found.frequencies,
        reduced=found.reduced,
        deviations=off,
        captured=found.captured,
        bound=100 * largest_shift(system, part, settings.below),
        kept=labels.labels(),
        external=external,
    )


def _boundary(model: Model, nodes: Int) -> Model:
    """GRID of the kept points in basic, and the frames that they move in as CORD2R."""
    grid = model["GRID"]
    at = np.unique(grid.find(np.unique(nodes)))
    at = at[at >= 0]
    if not at.size:
        raise InputError("keep: at least one GRID must be kept, to join the part by")
    xyz = positions(model)[at]
    cd = grid["CD"][at]
    turned = axes(model, cd, xyz)
    tables = {}
    frames = []
    for frame in np.unique(cd[cd > 0]).tolist():
        same = turned[cd == frame]
        if np.abs(same - same[0]).max() > 1e-9:  # of unit vectors
            raise UnsupportedError(
                f"kept points move in frame {frame}, which is curved: give them a rectangular CD"
            )
        frames.append((frame, *np.zeros(3), *same[0][2], *same[0][0]))
    if frames:
        places = np.array([place for _, *place in frames]).T
        names = [f"{end}{k}" for end in "ABC" for k in (1, 2, 3)]
        tables["CORD2R"] = table(
            "CORD2R",
            CID=[frame for frame, *_ in frames],
            RID=[0] * len(frames),
            **dict(zip(names, places, strict=True)),
        )
    zero = np.zeros(at.size, dtype=np.int64)
    tables["GRID"] = table(
        "GRID",
        ID=grid.ids[at],
        CP=zero,
        X1=xyz[:, 0],
        X2=xyz[:, 1],
        X3=xyz[:, 2],
        CD=cd,
        PS=[""] * at.size,
        SEID=zero,
    )
    return Model(tables)
