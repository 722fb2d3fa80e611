"""The candidates of a study, fitted to one file of test modes: what `ringtrue update` does."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.api.models import open_model, read_deck
from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.side_by_side import Workers, checked_workers, reached
from ringtrue.decks.nastran.editor import edit_fields, refuse_copy, refuse_unwritable
from ringtrue.errors import ConfigError
from ringtrue.model.edit import field_changes
from ringtrue.model.model import Model
from ringtrue.shapes import paired_mac
from ringtrue.solvers.registry import EMBEDDED
from ringtrue.study.config import StudyConfig, read_config
from ringtrue.study.direct import (
    AGREE,
    as_stated,
    direct_problem,
    not_fitted,
    not_told_apart,
    only_proven,
    read_target,
    solved,
)
from ringtrue.study.measured_data import Data
from ringtrue.study.messages import held_sentences, not_written_sentences
from ringtrue.study.objective import Minimisation
from ringtrue.study.placing import seat_words, seats_json
from ringtrue.study.results import Seat
from ringtrue.study.summary import finite
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.problem import Problem
from ringtrue.updating.residuals.modal import Point
from ringtrue.updating.strategy import Verified, kept
from ringtrue.updating.target import Target
from ringtrue.updating.validation import Misfit

SIDES = ("measured", "before", "after")


@dataclass(frozen=True, slots=True, eq=False)
class UpdateRequest:
    """What is asked for besides the study.

    Attributes
    ----------
    leave_out : str
        Test modes, from 1, to judge the result by: `3,7`.
    folder : Path, optional
        Where the updated deck goes.
    seed : int, optional
        Of the starts; that of the study if not given.
    checkpoint : Path, optional
        The last iterate is kept here.
    engine : str
        The solver; that of the study if empty.
    time_limit : float, s, optional
        Longest run of an engine that is another program.
    workers : int or str, optional
        That starts are spread over; those of the study if not given.
    """

    leave_out: str = ""
    folder: Path | None = None
    seed: int | None = None
    checkpoint: Path | None = None
    engine: str = ""
    time_limit: float | None = None
    workers: Workers | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FittedStudy:
    """An updating of the candidates of a study.

    Attributes
    ----------
    config : StudyConfig
        Without candidates that are held.
    model : Model
        The deck before the updating.
    problem : Problem
        As stated.
    done : Verified
        The solution, verified by full solutions.
    data : tuple of Data
        What was measured besides the modes.
    seats : tuple of Seat
        Where each sensor reads the model.
    notes : tuple of str
    files : tuple of Path
        The updated deck.
    frequencies_only : bool
        Whether no shapes were measured.
    engine : str
    misfits : tuple of Misfit
        Kinds of residuals beyond their stated errors.
    """

    config: StudyConfig
    model: Model
    problem: Problem
    done: Verified
    data: tuple[Data, ...]
    seats: tuple[Seat, ...]
    notes: tuple[str, ...]
    files: tuple[Path, ...]
    frequencies_only: bool
    engine: str
    misfits: tuple[Misfit, ...]

    @property
    def solved(self) -> bool:
        """Whether it converged on a reduced model that agrees with the full one."""
        return self.done.solution.outcome.ok and self.done.error <= AGREE

    @property
    def ok(self) -> bool:
        """Whether it was solved and fits all data within their errors."""
        return self.solved and not self.misfits


def update_study(
    study: Path,
    test: Path,
    asked: UpdateRequest,
    *,
    on_deck: Callable[[Model], None] | None = None,
    progress: Progress = quiet,
) -> FittedStudy:
    """Fit the candidates of a study to a file of test modes.

    Parameters
    ----------
    study, test : Path
    asked : UpdateRequest
    on_deck : callable (model), optional
        Is given the deck as soon as it is read.

    Raises
    ------
    ConfigError
        If the study has no deck or no candidate, or settings do not go together.
    DataError
        If no test mode was measured at a common set of channels.
    """
    config = read_config(study)
    if config.model is None or not config.candidate:
        raise ConfigError(
            f"{study}: an updating needs a [model] with a deck and at least one [[candidate]]"
        )
    given = config.study.workers if asked.workers is None else asked.workers
    workers = reached(checked_workers(given))
    base = study.parent
    model = read_deck(base / config.model.deck, units=config.model.units)
    if on_deck is not None:
        on_deck(model)
    if wrong := [r for r in config.residual if r.configuration]:
        raise ConfigError(
            f"[[residual]] of configuration {wrong[0].configuration!r}: run the whole study"
        )
    engine = asked.engine or config.model.solver
    _refuse(config, asked, engine)
    runner = config.model.engine(engine, asked.time_limit)
    opened = open_model(model)
    outside = replace(opened, engine=runner)
    if outside.reduces:  # no matrix of the deck in this process
        opened = outside
    config, target, modes, notes = read_target(config, opened, test)
    left_out = _left_out(asked.leave_out, len(modes))
    target = replace(target, used=~np.isin(np.arange(len(modes)), left_out))
    if asked.folder is not None:
        refuse_unwritable(model, config.candidates())
        refuse_copy(model, asked.folder)
    progress(0.1, "reduced basis" if runner is None else f"first runs of {engine}")
    problem, data, places = direct_problem(
        opened, config, target=target, modes=modes, base=base, engine=None
    )
    held = not_told_apart(problem)
    free = [c for c in config.candidate if c.name not in held]
    config = config.model_copy(update={"candidate": free})
    if held or runner is not None:
        problem, data, places = direct_problem(
            opened, config, target=target, modes=modes, base=base, engine=runner
        )
    how = Minimisation(
        settings=config.update,
        seed=config.study.seed if asked.seed is None else asked.seed,
        checkpoint=asked.checkpoint,
        workers=workers,
    )
    done = solved(problem, how, part(progress, 0.3, 0.9))
    problem, done, dropped = only_proven(
        problem, done, how, config.uncertainty.level, part(progress, 0.9, 1.0)
    )
    unproven = not_written_sentences(dropped)
    return FittedStudy(
        config=config,
        model=model,
        problem=problem,
        done=done,
        data=data,
        seats=places,
        notes=(*notes, *seat_words(places), *held_sentences(held), *unproven),
        files=_write(model, config, done, dropped, asked.folder),
        frequencies_only=bool(notes),
        engine=engine,
        misfits=not_fitted(problem, done, data),
    )


def _refuse(config: StudyConfig, asked: UpdateRequest, engine: str) -> None:
    """Refuse settings that do not go together, before any work."""
    if engine == EMBEDDED:
        if asked.time_limit is not None:
            raise ConfigError("a time limit is for a solver that is another program")
    elif config.residual:
        raise ConfigError(
            f"the solver {engine} gives modes alone: FRFs, static tests and a weighed mass need "
            "the embedded solver"
        )
    if asked.checkpoint is None:
        return
    if config.update.starts > 1:
        raise ConfigError("a checkpoint keeps one iterate: it needs one start")
    if config.update.prior != "study":
        raise ConfigError(
            'a checkpoint keeps no weight of the prior: it needs prior = "study"'
        )


def _left_out(text: str, count: int) -> list[int]:
    """Test modes from 0, of `3,7`."""
    numbers = [t.strip() for t in text.split(",") if t.strip()]
    wrong = [t for t in numbers if not t.isdigit() or not 1 <= int(t) <= count]
    if wrong or len(set(numbers)) >= count:
        raise ConfigError(
            f"leave out {text}: must name some of the modes 1 to {count}, not all"
        )
    return [int(t) - 1 for t in numbers]


def _write(
    model: Model,
    config: StudyConfig,
    done: Verified,
    dropped: Collection[str],
    folder: Path | None,
) -> tuple[Path, ...]:
    """The deck with its fields changed in place, in another folder; not those of `dropped`."""
    if folder is None:
        return ()
    folder.mkdir(parents=True, exist_ok=True)
    names = done.problem.parameters.names
    factors = np.where(np.isin(names, list(dropped)), 1.0, done.solution.factors)
    moved = np.flatnonzero(factors != 1.0)
    parameters = config.candidates().take(moved.tolist())
    return tuple(
        edit_fields(model, field_changes(model, parameters, factors[moved]), folder)
    )


def update_json(found: FittedStudy) -> dict[str, Any]:
    """The updating as JSON has it."""
    end = found.done.solution
    # the deck and the end on the verified model, paired by the gates and weighed as assumed
    y = found.done.solution.y
    same = as_stated(found.problem, found.done)
    before, after = (same.evaluate(0 * y), same.evaluate(y))
    free = np.flatnonzero(found.problem.link.any(axis=1)).tolist()
    parameters = found.problem.parameters.take(free)
    x = end.x[free]
    factors = end.factors[free]
    std = end.std * parameters.derivative(x) / factors
    columns = (
        parameters.names,
        factors.tolist(),
        std.tolist(),
        end.identifiability.tolist(),
    )
    table = [
        {
            "name": name,
            "factor": factor,
            "relative_std": deviation,
            "posterior_over_prior": ratio,
        }
        for name, factor, deviation, ratio in zip(*columns, strict=True)
    ]
    discrepancy = (100 * kept(found.done.problem)).tolist()
    target = found.problem.configurations[0].target
    points = (before.points[0], after.points[0])
    value = {
        "outcome": end.outcome.value,
        "why": end.why if end.outcome.ok else f"{end.outcome.value} ({end.why})",
        "objective": [before.cost, after.cost],
        "discrepancy_percent": dict(
            zip(("frequency", "mac"), discrepancy, strict=True)
        ),
        "solver": found.engine,
        "basis_error": found.done.error,
        "full_solutions": found.done.full_solutions,
        "parameters": table,
        "misfits": [asdict(m) for m in found.misfits],
        "flags": [f.text for f in plausibility(parameters, x, end.identifiability)],
        "modes": _modes(target, points, shapes=not found.frequencies_only),
    }
    if found.data:
        value["measured"] = _measured(found.data, points)
    value["deck"] = [str(p) for p in found.files]
    value["notes"] = list(found.notes)
    if found.seats:
        value["sensors"] = seats_json(found.seats)
    result = finite(value)
    assert isinstance(result, dict)
    return result


def _measured(
    data: Sequence[Data], points: tuple[Point, Point]
) -> list[dict[str, Any]]:
    """What was measured besides the modes, by the model before and after."""
    found = []
    for d in data:
        columns = (d.measured, d.shown(d.term(points[0])), d.shown(d.term(points[1])))
        for label, unit, *values in zip(d.labels, d.units, *columns, strict=True):
            numbers = dict(zip(SIDES, map(float, values), strict=True))
            found.append({"name": d.name, "what": label, "unit": unit} | numbers)
    return found


def _modes(
    target: Target, points: tuple[Point, Point], *, shapes: bool
) -> list[dict[str, Any]]:
    """Deviation and MAC of each test mode, before and after; NaN where it is unpaired, or no shapes
    were measured.
    """
    frequencies = target.frequencies
    table = [
        {"frequency_hz": f, "used": used}
        for f, used in zip(frequencies.tolist(), target.used.tolist(), strict=True)
    ]
    for when, at in zip(("_before", ""), points, strict=True):
        test, fe = at.every.T
        columns: Float = np.full((3, frequencies.size), np.nan)
        columns[0, test] = 100 * (at.now.frequencies[fe] / frequencies[test] - 1)
        if shapes:
            columns[1, test] = 100 * paired_mac(
                target.shapes[:, test], at.now.shapes[:, fe]
            )
            columns[2, test] = 100 * at.mac
        for row, values in zip(table, columns.T.tolist(), strict=True):
            for name, value in zip(
                ("deviation", "mac", "subspace_mac"), values, strict=True
            ):
                row[f"{name}{when}_percent"] = value
    return table
