"""MSC, NX or Autodesk Nastran by a configured command: SOL 103 for modes, SOL 200 for their
derivatives.
"""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.decks.nastran.results.printed import sturm_counts
from ringtrue.decks.nastran.results.sensitivity import Sensitivities, read_sensitivities
from ringtrue.decks.nastran.writer import format_card
from ringtrue.errors import (
    ConfigError,
    DataError,
    SolverFailed,
    SolverMissing,
    UnsupportedError,
    did_you_mean,
)
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.nastran_design import SET, design_cards, response_cards, spread
from ringtrue.solvers.runner import METHOD, DeckAnalysis, Finished, bulk, case_control, tail

COMMAND, MAKE = "RINGTRUE_NASTRAN", "RINGTRUE_NASTRAN_MAKE"
Make = Literal["msc", "nx", "autodesk"]
_MAKES: tuple[Make, ...] = ("msc", "nx", "autodesk")
_USUAL = {
    "msc": "nastran {deck} scr=yes bat=no old=no",
    "nx": "nastran {deck} scr=yes old=no",
    "autodesk": "nastran {deck}",
}
MOST = 200_000  # responses of one run
REPEATED = 1e-8  # of the highest eigenvalue
SAME = 1e-4  # relative: eigenvalues of the given modes and of the run's


def nastran_command() -> str:
    """The command line, `{deck}` where the deck goes: the variable RINGTRUE_NASTRAN, or `nastran`
    on the PATH.

    Raises
    ------
    SolverMissing
        If neither is there.
    """
    named = os.environ.get(COMMAND)
    if named:
        return named if "{deck}" in named else f"{named} {{deck}}"
    if shutil.which("nastran"):
        return _USUAL[nastran_make()]
    raise SolverMissing(f"no nastran: set {COMMAND} to its command, such as {_USUAL['msc']!r}")


def nastran_make() -> Make:
    """Whose Nastran: the variable RINGTRUE_NASTRAN_MAKE, msc if it is not set.

    Raises
    ------
    ConfigError
        If it is none of msc, nx, autodesk.
    """
    named = os.environ.get(MAKE, "msc").lower()
    for make in _MAKES:
        if make == named:
            return make
    raise ConfigError(f"{MAKE}={named}{did_you_mean(named, _MAKES)}")


def sensitivity_deck(
    model: Model, program: NastranSolver, parameters: ParameterSet, count: int, grids: Int
) -> str:
    """A SOL 200 deck that ends after the sensitivities of the lowest `count` modes.

    Raises
    ------
    UnsupportedError
        If a field cannot be a design variable.
    InputError
        If a target is not in the model or blank.
    """
    model, design = design_cards(model, parameters)
    case = ["SOL 200", "CEND", *case_control(model), "DISPLACEMENT(PRINT,PLOT) = ALL"]
    case += ["DSAPRT(FORMATTED,EXPORT,END=SENS) = ALL", "DESOBJ(MIN) = 1", f"DESSUB = {SET}"]
    case += ["SUBCASE 1", "  ANALYSIS = MODES", "BEGIN BULK"]
    eigrl = format_card("EIGRL", (METHOD, None, None, count, None, None, None, "MASS"))
    return (
        "\n".join(case)
        + "\n"
        + eigrl
        + design
        + response_cards(count, grids)
        + bulk(model, program)
        + "ENDDATA\n"
    )


class NastranAnalysis(DeckAnalysis):
    """A model in Nastran, with derivatives by SOL 200."""

    capabilities = frozenset({"modes", "derivatives"})
    program: NastranSolver

    def derivatives(self, modes: ModeSet, parameters: ParameterSet) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at a = 1 of modes of this model, one SOL 200 run.

        Raises
        ------
        UnsupportedError
            If a parameter is no design variable of SOL 200, eigenvalues are repeated, or there are
            too many responses.
        SolverMissing, SolverFailed
            If the program is not there, fails or gives other modes or no sensitivities.
        """
        count = self._count(modes)
        grids = np.asarray(self.model["GRID"].ids)
        if 6 * count * grids.size > MOST:
            raise UnsupportedError(
                f"{6 * count * grids.size} responses; at most {MOST}: use the embedded solver"
            )
        done = self.run(sensitivity_deck(self.model, self.program, parameters, count, grids))
        d_lambda, local = spread(self._sensitivities(done), count, grids, len(parameters))
        at, sign = self._matched(self._read(done), modes)
        return d_lambda[at], self._basic(local)[:, at] * sign[:, None]

    def _count(self, modes: ModeSet) -> int:
        """The lowest modes that hold the given ones; repeated ones have no derivative by SOL
        200.
        """
        f = np.sort(modes.frequencies)
        near = np.abs(np.diff(np.sign(f) * f**2)) < REPEATED * max(
            float(np.max(f**2, initial=0.0)), 1e-30
        )
        if near.any():
            at = float(f[1:][near][0])
            raise UnsupportedError(
                f"repeated modes at {at:.6g} Hz: SOL 200 has no derivatives there; use embedded"
            )
        mine = self.modes(ModesRequest(len(modes))).modes.frequencies
        return len(modes) if mine[-1] >= f[-1] * (1 - SAME) else 2 * len(modes)

    def _sensitivities(self, done: Finished) -> Sensitivities:
        problems = []
        for path in done.files(".op2", ".h5", ".f06", ".csv"):
            try:
                return read_sensitivities(path)
            except DataError as e:
                problems.append(str(e))
        raise SolverFailed(
            f"nastran wrote no sensitivities: {'; '.join(problems) or 'no results'}{tail(done.log)}"
        )

    def _matched(self, run: ModeSet, modes: ModeSet) -> tuple[Int, Float]:
        """Which modes of the run the given ones are, and the sign that turns one into the other."""
        cross = run.shapes.T @ modes.shapes
        size = np.linalg.norm(run.shapes, axis=0)[:, None] * np.linalg.norm(modes.shapes, axis=0)
        likeness = cross / np.where(size > 0, size, 1.0)
        at = np.abs(likeness).argmax(axis=0)
        worst = float(np.abs(likeness[at, np.arange(len(modes))]).min(initial=1.0))
        if np.unique(at).size != at.size or worst < 0.99:
            raise SolverFailed(
                f"SOL 200 found other modes than those given (a likeness of {worst:.3f})"
            )
        return at, np.sign(likeness[at, np.arange(len(modes))])

    def _basic(self, local: Float) -> Float:
        """Shapes (g, 6, m, p) in displacement frames to (dof, m, p) in basic; scalar points have
        none and get 0.
        """
        turn = axes(self.model, self.model["GRID"]["CD"], positions(self.model))
        g, _, m, p = local.shape
        basic = np.einsum("nji,nkjmp->nkimp", turn, local.reshape(g, 2, 3, m, p)).reshape(
            6 * g, m, p
        )
        return np.concatenate([basic, np.zeros((len(self.dofs) - 6 * g, m, p))])


class NastranSolver:
    """`with NastranSolver().open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    command : str, optional
        With `{deck}` where the deck goes; the variable RINGTRUE_NASTRAN if not given.
    make : {"msc", "nx", "autodesk"}, optional
        The variable RINGTRUE_NASTRAN_MAKE if not given.
    timeout : float, s
    keep : Path, optional
        A folder that keeps decks and results; without it they are removed.
    progress : callable, optional
    """

    name = "nastran"

    def __init__(
        self,
        *,
        command: str | None = None,
        make: Make | None = None,
        timeout: float = 24 * 3600.0,
        keep: Path | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._command, self.make = command, make or nastran_make()
        self.timeout, self.keep, self.progress = timeout, keep, progress

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> NastranAnalysis:
        """Hand the model over.

        Raises
        ------
        SolverMissing
            If no command is configured.
        """
        self.command(Path("model.bdf"))
        return NastranAnalysis(model, self, keep=self.keep, progress=self.progress)

    def command(self, deck: Path) -> Sequence[str | Path]:
        """The command line for a deck."""
        return [
            word.replace("{deck}", deck.name)
            for word in shlex.split(self._command or nastran_command())
        ]

    def adapted(self, model: Model) -> Model:
        """The model as it is."""
        return model

    def params(self) -> Sequence[tuple[str, int | float | str]]:
        """PARAMs that write OP2."""
        return (("POST", -1),)

    def more_bulk(self) -> str:
        """What makes MSC Nastran write HDF5."""
        return format_card("MDLPRM", ("HDF5", 0)) if self.make == "msc" else ""

    def endings(self) -> tuple[str, ...]:
        """Double precision first."""
        return (".h5", ".op2", ".f06", ".pch")

    def band_by_count(self) -> bool:
        """Its Lanczos method takes bands."""
        return False

    def proof(self, run: Finished, modes: ModeSet, request: ModesRequest) -> tuple[bool, str]:
        """Sturm counts of the Lanczos method, as printed."""
        counts = [c for f in run.files(".f06") for c in sturm_counts(f)]
        if not len(modes):
            return False, "no mode found, nothing counted"
        top, f = float(modes.frequencies[-1]), modes.frequencies
        above = [
            c
            for c in counts
            if c[0] > top and (request.band is None or c[0] >= request.band[1] * (1 - 1e-3))
        ]
        low = request.band[0] if request.band else 0.0
        under = [c for c in counts if c[0] <= low * (1 + 1e-3)] if low > 0 else [(0.0, 0)]
        if not above or not under:
            return False, "Nastran printed no Sturm count above the last mode"
        there = above[0][1] - under[-1][1]
        words = (
            f"{there} eigenvalues below {above[0][0]:.6g} Hz by Nastran's Sturm count, "
            f"{f.size} taken"
        )
        return there == f.size, words
