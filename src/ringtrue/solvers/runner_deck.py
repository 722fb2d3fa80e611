"""Programs that read a Nastran deck and write results files: what `mystran` and `nastran` share."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.decks.nastran.bulk import NOT_MODEL, write_bulk
from ringtrue.decks.nastran.bulk_special import large_card
from ringtrue.decks.nastran.results.f06 import fatal_messages
from ringtrue.decks.nastran.results.modes import read_nastran_modes
from ringtrue.decks.nastran.writer import format_card
from ringtrue.errors import DataError, SolverFailed, UnsupportedError
from ringtrue.fem.mesh import mesh
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.solvers.runner import Finished, run_program, tail

DECK = "model.bdf"
METHOD = 1
_OWN_PARAMS = frozenset(("POST", "OUGCORD", "OPTEXIT", "GRDPNT", "POSTEXT", "PRTMAXIM"))


class DeckProgram(Protocol):
    """What differs from program to program."""

    name: str
    timeout: float

    def command(self, deck: Path) -> Sequence[str | Path]:
        """The command line; it runs in the folder of the deck."""
        ...

    def adapted(self, model: Model) -> Model:
        """The model with what this program wants to have written out."""
        ...

    def params(self) -> Sequence[tuple[str, int | float | str]]:
        """PARAM cards that make it write what is read."""
        ...

    def more_bulk(self) -> str:
        """Further bulk data."""
        ...

    def endings(self) -> tuple[str, ...]:
        """Results files, the most precise first."""
        ...

    def band_by_count(self) -> bool:
        """Whether its Lanczos method takes a number of modes only, not a band."""
        ...

    def proof(self, run: Finished, modes: ModeSet, request: ModesRequest) -> tuple[bool, str]:
        """Whether and how it proves that no mode is missing."""
        ...


def modes_deck(model: Model, request: ModesRequest, program: DeckProgram) -> str:
    """A SOL 103 deck: unit modal mass, all displacements printed and plotted."""
    low, high = request.band or (None, None)
    low = None if low is None or low <= 0 else low  # a rigid-body mode may be a little below 0
    count = None if request.band else request.count
    eigrl = large_card("EIGRL", (METHOD, low, high, count, None, None, None, "MASS"))
    case = ["SOL 103", "CEND", *case_control(model), "DISPLACEMENT(PRINT,PLOT) = ALL", "BEGIN BULK"]
    return "\n".join(case) + "\n" + eigrl + bulk(model, program) + "ENDDATA\n"


def case_control(model: Model) -> list[str]:
    """The choices of constraint sets and method."""
    chosen = [
        ("SPC", model.case.spc),
        ("MPC", model.case.mpc),
        ("NSM", model.case.nsm),
        ("METHOD", METHOD),
    ]
    matrices = [("K2GG", model.case.k2gg), ("M2GG", model.case.m2gg), ("B2GG", model.case.b2gg)]
    added = [
        f"{name} = " + ", ".join(f"{a:.9G}*{m}" for a, m in terms)
        for name, terms in matrices
        if terms
    ]
    return [
        "TITLE = RINGTRUE",
        "ECHO = NONE",
        *(f"{name} = {sid}" for name, sid in chosen if sid),
        *added,
    ]


def bulk(model: Model, program: DeckProgram) -> str:
    """The model and the parameters of the program."""
    own = [format_card("PARAM", p) for p in program.params()]
    leave = {*NOT_MODEL, *_OWN_PARAMS, *(name for name, _ in program.params())}
    return "".join(own) + program.more_bulk() + write_bulk(program.adapted(model), without=leave)


class DeckAnalysis:
    """A model handed to a program as a deck; see `ringtrue.model.ports.Analysis`.

    Each request is a run in a folder of its own, removed at the end unless `keep` names a folder.
    """

    capabilities = frozenset({"modes"})

    def __init__(
        self,
        model: Model,
        program: DeckProgram,
        *,
        keep: Path | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.model, self.program, self._progress = model, program, progress
        self.dofs: DofSet = mesh(model).dofs
        self._temporary = None if keep else tempfile.mkdtemp(prefix=f"ringtrue-{program.name}-")
        self._folder = Path(self._temporary or str(keep))
        self._done: dict[ModesRequest, ModesResult] = {}

    def modes(self, request: ModesRequest) -> ModesResult:
        """Natural modes; one run of the program a request.

        Raises
        ------
        SolverMissing, SolverFailed
            If the program is not there, ends with a fatal error or writes no modes.
        """
        if request not in self._done:
            by_count = request.band is not None and self.program.band_by_count()
            self._done[request] = self._band(request) if by_count else self._modes(request)
        return self._done[request]

    def derivatives(self, modes: ModeSet, parameters: ParameterSet) -> tuple[Float, Any_]:
        """Not offered by this program.

        Raises
        ------
        UnsupportedError
            Always; `capabilities` says so beforehand.
        """
        raise UnsupportedError(f"{self.program.name} gives no derivatives; use the embedded solver")

    def run(self, deck: str) -> Finished:
        """Run a deck; fatal messages of the printed file become an error."""
        number = len(list(self._folder.glob("run*"))) if self._folder.is_dir() else 0
        folder = self._folder / f"run{number + 1}"
        folder.mkdir(parents=True)
        path = folder / DECK
        path.write_text(deck, encoding="ascii")
        name = self.program.name
        if self._progress:
            self._progress(0.0, f"{name} runs")
        done = run_program(
            self.program.command(path), folder, name=name, timeout=self.program.timeout
        )
        fatal = [m for f in done.files(".f06", ".err") for m in fatal_messages(f)]
        if fatal:
            raise SolverFailed(
                f"{name} stopped with a fatal error:\n  " + "\n  ".join(fatal[0].splitlines())
            )
        if done.status:
            raise SolverFailed(f"{name} ended with exit status {done.status}{tail(done.log)}")
        return done

    def _modes(self, request: ModesRequest) -> ModesResult:
        done = self.run(modes_deck(self.model, request, self.program))
        modes = self._read(done)
        if request.band is None:
            modes = modes.take(slice(0, request.count))
        complete, proof = self.program.proof(done, modes, request)
        return ModesResult(modes, np.full(len(modes), np.nan), complete, proof)

    def _band(self, request: ModesRequest) -> ModesResult:
        """All modes of a band from a program that takes a number: asked for twice as many until
        they pass the band.
        """
        low, high = request.band or (0.0, 0.0)
        count, most = request.count, len(self.dofs) // 2
        while True:
            found = self.modes(ModesRequest(count))
            if (
                not len(found.modes)
                or found.modes.frequencies[-1] > high
                or len(found.modes) < count
                or count >= most
            ):
                break
            count = min(2 * count, most)
        inside = found.modes.band(-np.inf if low <= 0 else low, high)
        return ModesResult(inside, np.full(len(inside), np.nan), found.complete, found.proof)

    def _read(self, done: Finished) -> ModeSet:
        """Modes from the most precise file that holds them, on this analysis' DOFs."""
        files, written = done.files(*self.program.endings()), self.program.adapted(self.model)
        problems = []
        for path in files:
            try:
                found = read_nastran_modes(path, written, mass_normalised=True)
            except DataError as e:
                problems.append(str(e))
                continue
            return self._aligned(found)
        nothing = (
            f"no file {' or '.join(self.program.endings())}; its command must wait for the "
            "job (MSC: bat=no)"
        )
        what = "; ".join(problems) or nothing
        raise SolverFailed(f"{self.program.name} wrote no modes: {what}{tail(done.log)}")

    def _aligned(self, found: ModeSet) -> ModeSet:
        labels = found.labels
        assert isinstance(labels, DofSet)
        at = labels.find(self.dofs.node, self.dofs.direction)
        if (at < 0).any():
            lost = self.dofs.labels()[int(np.flatnonzero(at < 0)[0])]
            raise SolverFailed(
                f"{self.program.name} wrote modes without {lost} and {int((at < 0).sum()) - 1} "
                "more DOFs"
            )
        return replace(
            found,
            shapes=found.shapes[at],
            labels=self.dofs,
            norm=Norm.MASS,
            source=self.program.name,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._temporary:
            shutil.rmtree(self._temporary, ignore_errors=True)
