"""`update`: the candidates of a study, fitted to a file of test modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from ringtrue.backends.observed import PRINTED, UNTOLD, FullModel, reduced
from ringtrue.backends.registry import EMBEDDED, solver
from ringtrue.cli.show import Json, err, one_of, progress, write_json
from ringtrue.cli.updated import show_summary, summary_of
from ringtrue.core.arrays import Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.observation import Observation
from ringtrue.core.progress import Progress, part
from ringtrue.correlate.assign import PairingSettings
from ringtrue.correlate.observe import at_dofs
from ringtrue.errors import ConfigError, DataError, NumericalError, did_you_mean
from ringtrue.io.modes_json import read_modes, read_std
from ringtrue.io.nastran.edit import edit_fields, refuse_unwritable
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.edit import field_changes
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.shapes.scale import realise_modes
from ringtrue.study.config import StudyConfig, read_config
from ringtrue.study.config_update import (
    DataResidual,
    Discrepancy,
    FrfResidual,
    MassResidual,
    StaticResidual,
    UpdateSection,
)
from ringtrue.study.course import course_of, further, settled
from ringtrue.study.lent import compared_alone, lent
from ringtrue.study.measured import (
    LENGTH,
    Data,
    channels_of,
    check_moving,
    excited,
    flexible,
    measured,
    residual_data,
    rigid_mass,
)
from ringtrue.study.objective import KINDS as KINDS_OF_MODES
from ringtrue.study.objective import LOSSES, constraints, mass_at, modal_terms
from ringtrue.study.opened import Opened
from ringtrue.study.parametric import AtChannels
from ringtrue.study.placing import placed
from ringtrue.study.reference import measured_part
from ringtrue.update.objective import Target, Weights
from ringtrue.update.residuals import Weighted
from ringtrue.update.settle import displaced, whole_cost
from ringtrue.update.several import Configuration, Problem
from ringtrue.update.trust import KINDS, Solution
from ringtrue.update.verified import Verified, solve_verified
from ringtrue.update.weights import RULES

ABOVE = 1.5  # modes of the model up to here over the highest test mode
AGREE = 1e-4  # relative frequency error of the reduced model that is accepted at the end


@dataclass(frozen=True, slots=True)
class Asked:
    """Where the command looks beside the study."""

    solver: str
    seed: int
    checkpoint: Path | None


def update(
    study: Annotated[Path, typer.Argument(help="study.toml with a deck and candidates.")],
    test: Annotated[
        Path,
        typer.Argument(help="Test modes, .json, .h5 or .uff; channels of the study's sheet, or DOFs such as 101+Z."),
    ],
    folder: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where the updated deck goes.")] = None,
    leave_out: Annotated[str, typer.Option(metavar="LIST", help="Test modes to judge by, from 1: 3,7.")] = "",
    method: Annotated[str | None, one_of("--method", KINDS, "Kind of step")] = None,
    prior: Annotated[str | None, one_of("--prior", ("study", *RULES), "Weight of the prior")] = None,
    loss: Annotated[str | None, one_of("--loss", LOSSES, "Against a wrong mode")] = None,
    discrepancy: Annotated[
        str | None, one_of("--discrepancy", get_args(Discrepancy), "Deviations that the best model keeps")
    ] = None,
    frequency: Annotated[
        float | None, typer.Option(metavar="%", help="Deviation of a frequency that the best model keeps.", min=1e-3)
    ] = None,
    mac_percent: Annotated[
        float | None, typer.Option("--mac", metavar="%", help="The same for 100 - MAC.", min=1e-3)
    ] = None,
    residuals: Annotated[
        str | None, typer.Option(metavar="LIST", help=f"What is compared of modes, any of {', '.join(KINDS_OF_MODES)}.")
    ] = None,
    frf: Annotated[
        Path | None, typer.Option("--frf", metavar="FILE", help="Measured FRFs, compared too: .uff, .h5 or .npz.")
    ] = None,
    static: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Static tests: CSV with case, channel, load, deflection.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Weighed mass of the structure.", min=0)] = None,
    starts: Annotated[
        int | None, typer.Option(metavar="N", help="Starts; the first is the deck as it is.", min=1)
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Of the starts.", min=0)] = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keep the last iterate here; go on from it if it is there.")
    ] = None,
    solver_name: Annotated[
        str | None,
        typer.Option(
            "--solver", help="That of the study, or embedded, mystran, nastran, slepc, a plug-in: solved at each point."
        ),
    ] = None,
    json: Json = None,
) -> int:
    """Update a model to test modes: factors with their uncertainty, deviations before and after, the deck edited.

    What no option says is as the study updates; what is compared beside modes comes from the residual tables of the
    study and --frf, --static, --mass.

    Example: ringtrue update study.toml modes.json --leave-out 3,7 --out updated
    """
    words = {"step": method, "prior": prior, "loss": loss, "discrepancy": discrepancy, "starts": starts}
    config = _settings(read_config(study), words, residuals, frequency, mac_percent, (frf, static, mass))
    solver_name = solver_name or (config.model.solver if config.model else EMBEDDED)
    asked = Asked(solver_name, config.study.seed if seed is None else seed, checkpoint)
    engine = solver(solver_name)
    _check(config.update, asked)
    if config.model is None or not config.candidate:
        raise ConfigError(f"{study}: an updating needs a [model] with a deck and at least one [[candidate]]")
    anew = solver_name != EMBEDDED
    if anew and config.residual:
        raise ConfigError(
            f"--solver {solver_name} gives modes alone: FRFs, static tests and a weighed mass need the embedded solver"
        )
    with progress("updating") as show:
        show(0.0, "reading")
        opened = Opened(read_deck(study.parent / config.model.deck), LENGTH[config.model.units])
        config, target, modes, notes = _target(config, opened, test, leave_out)
        model = opened.model
        if folder is not None:
            refuse_unwritable(model, config.candidates())
        show(0.1, f"first runs of {solver_name}" if anew else "reduced basis")
        if anew:
            problem = _by_runs(opened, config, target, modes, engine, study.parent)
            extra: tuple[Data, ...] = ()
        else:
            problem, extra = _problem(opened, config, target, modes, study.parent)
        problem = replace(problem, loss=LOSSES[config.update.loss])
        done = _solved(problem, config.update, asked, part(show, 0.3, 1.0))
    written = _edited(model, config, done, folder)
    summary = summary_of(config, problem, done, extra, asked.solver) | {
        "deck": [str(p) for p in written],
        "notes": notes,
    }
    if json:
        write_json(summary, json)
    if json != "-":
        show_summary(study, summary)
    good = done.solution.outcome.ok and done.error <= AGREE
    if not good:
        err.print(f"not to be trusted: {summary['why']}")
    return 0 if good else 1


def _check(u: UpdateSection, asked: Asked) -> None:
    """Options before any work."""
    if u.starts > 1 and asked.checkpoint is not None:
        raise ConfigError("--checkpoint keeps one iterate: it does not go with --starts")
    if u.prior != "study" and asked.checkpoint is not None:
        raise ConfigError("--checkpoint keeps no weight of the prior: it goes with --prior study only")


def _left_out(text: str, count: int) -> list[int]:
    numbers = [t.strip() for t in text.split(",") if t.strip()]
    wrong = [t for t in numbers if not t.isdigit() or not 1 <= int(t) <= count]
    if wrong or len(set(numbers)) >= count:
        raise ConfigError(f"--leave-out {text}: must name some of the modes 1 to {count}, not all")
    return [int(t) - 1 for t in numbers]


def _settings(
    config: StudyConfig,
    words: Mapping[str, str | int | None],
    residuals: str | None,
    frequency: float | None,
    mac: float | None,
    more: tuple[Path | None, Path | None, float | None],
) -> StudyConfig:
    """The study with what the options say in place of it, and files and a mass beside its [[residual]]s."""
    change: dict[str, Any] = {n: v for n, v in words.items() if v is not None}
    if residuals is not None:
        names = [t.strip() for t in residuals.split(",") if t.strip()]
        for name in names:
            if name not in KINDS_OF_MODES:
                raise ConfigError(f"--residuals {name!r}{did_you_mean(name, KINDS_OF_MODES)}")
        if not names:
            raise ConfigError(f"--residuals {residuals!r}: at least one of {', '.join(KINDS_OF_MODES)}")
        change["residuals"] = list(dict.fromkeys(names))
    change |= {n: v / 100 for n, v in (("frequency_error", frequency), ("mac_error", mac)) if v is not None}
    frf, static, mass = more
    extra: list[DataResidual] = list(config.residual)
    if wrong := [r for r in extra if r.configuration]:
        raise ConfigError(f"[[residual]] of configuration {wrong[0].configuration!r}: use ringtrue run")
    extra += [FrfResidual(kind="frf", file=str(frf.absolute()))] if frf else []
    extra += [StaticResidual(kind="static", file=str(static.absolute()))] if static else []
    extra += [MassResidual(kind="mass", mass=mass)] if mass else []
    return config.model_copy(update={"update": config.update.model_copy(update=change), "residual": extra})


def _target(
    config: StudyConfig, opened: Opened, test: Path, leave_out: str
) -> tuple[StudyConfig, Target, ModeSet, tuple[str, ...]]:
    """What the file says, less the channels that the study leaves out, and its modes; the study, which compares
    frequencies alone where the file has no shapes, and what there is to say.
    """
    whole, (spread, _), notes = read_modes(test), read_std(test), tuple[str, ...]()
    if not whole.channels and len(whole):
        whole, at, notes = lent(whole, opened, config)
        spread, config = spread[at], compared_alone(config)
    if config.test and config.test.leave_out:
        whole = whole.rows([c for c in whole.channels if c not in config.test.leave_out])
    kept, channels = measured_part(whole)
    modes: ModeSet = realise_modes(whole.take(kept).rows(channels))
    if not len(modes) or not modes.channels:
        raise DataError(f"{test}: no mode was measured at a common set of channels")
    relative = np.nan_to_num(spread[kept] / modes.frequencies, nan=0.0)
    used = ~np.isin(np.arange(len(modes)), _left_out(leave_out, len(modes)))
    gates = PairingSettings(mac_gate=config.correlate.mac_gate, frequency_gate=config.correlate.frequency_gate)
    u = config.update
    weights = Weights(u.frequency_error, u.mac_error, u.shape_weight)
    shapes = np.asarray(modes.shapes.real, dtype=np.float64)
    return config, Target(modes.frequencies, shapes, relative, used, weights, gates), modes, notes


def _problem(
    opened: Opened, config: StudyConfig, target: Target, modes: ModeSet, base: Path
) -> tuple[Problem, tuple[Data, ...]]:
    """The objective on the reduced model of the deck, and what was measured beside the modes."""
    assert config.model is not None
    model, parameters, units = opened.model, config.candidates(), config.model.units
    found = [measured(s, base, modes) for s in config.residual]
    named = tuple(dict.fromkeys((*modes.channels, *channels_of(found))))
    at = {c: i for i, c in enumerate(named)}
    loaded = excited(found, at)
    dofs, more = opened.analysis.dofs, named[len(modes.channels) :]
    observation = _observation(opened, config, modes.channels, base)
    observation = observation.and_also(at_dofs(more, dofs)) if more else observation
    top = ABOVE * float(target.frequencies.max())
    count = len(opened.modes(top).modes)
    basis = reduced(model, parameters, observation, count)
    check_moving(found, at, basis.basis.observe)
    seen = AtChannels(flexible(basis, found, loaded), np.arange(len(modes.channels)), loaded)
    every = tuple(range(len(parameters)))
    data = tuple(residual_data(m, at, units, lambda: rigid_mass(model, parameters), every) for m in found)
    modal = modal_terms(config.update, lambda: mass_at(opened, observation, modes.channels, config, top))
    terms = (*modal, *(Weighted(d.term, d.weight) for d in data))
    rows, limits = constraints(config, parameters)
    return Problem((Configuration(seen, target, terms),), rows=rows, limits=limits), data


def _observation(
    opened: Opened, config: StudyConfig, channels: tuple[str, ...], base: Path, dofs: DofSet | None = None
) -> Observation:
    """The channels of the test modes: on the sheet of the study, if it has one."""
    sheet, c = base / config.test.sheet if config.test else None, config.correlate
    return placed(opened, channels, sheet, tolerance=c.tolerance, method=c.match, align=c.align, dofs=dofs)


def _by_runs(
    opened: Opened, config: StudyConfig, target: Target, modes: ModeSet, engine: ModalSolver, base: Path
) -> Problem:
    """The objective on the modes that a solver finds anew at each point."""
    model, parameters = opened.model, config.candidates()
    with engine.open(model) as analysis:
        observation = _observation(opened, config, modes.channels, base, analysis.dofs)
    full = FullModel(model, parameters, observation, ModesRequest(2 * len(modes)), engine)
    top = ABOVE * float(target.frequencies.max())
    full = full.reaching(top)
    terms = modal_terms(config.update, lambda: mass_at(opened, observation, modes.channels, config, top))
    rows, limits = constraints(config, parameters)
    return Problem((Configuration(full, target, terms),), rows=rows, limits=limits)


def _solved(problem: Problem, u: UpdateSection, asked: Asked, show: Progress) -> Verified:
    """As a study updates a set of parameters, on a basis verified by full solutions.

    From further starts, too, where used modes that the model has are left without partner; the end of lower J.
    """
    if isinstance(problem.configurations[0].model, FullModel):
        return _on_full(problem, u, asked, show)
    done, more = _on_basis(problem, u, asked, show), further(u)
    if more is None or asked.checkpoint is not None or not displaced(problem, done.solution.end):
        return done
    show(0.5, "modes without partner: further starts")
    try:
        other = _on_basis(problem, more, asked, show)
    except NumericalError:  # the end from the deck stands
        return done
    return min(done, other, key=lambda d: whole_cost(problem, d.solution.end))


def _on_full(problem: Problem, u: UpdateSection, asked: Asked, show: Progress) -> Verified:
    """On modes that a solver finds anew at each point."""
    model, course = problem.configurations[0].model, course_of(u)
    assert isinstance(model, FullModel)
    course = replace(course, method=replace(course.method, step=PRINTED, gradient=UNTOLD))
    end = settled(problem, u, asked.seed, show, course=course, told=show, checkpoint=asked.checkpoint)
    return Verified(end.solution, end.problem, 0.0, model.ledger.runs)


def _on_basis(problem: Problem, u: UpdateSection, asked: Asked, show: Progress) -> Verified:
    def solved(p: Problem, y: Float | None) -> tuple[Solution, Problem]:
        end = settled(p, u, asked.seed, show, start=y, checkpoint=asked.checkpoint)
        return end.solution, end.problem

    return solve_verified(problem, solved=solved, tolerance=AGREE, progress=show)


def _edited(model: Model, config: StudyConfig, done: Verified, folder: Path | None) -> list[Path]:
    """The deck with its fields changed in place, in another folder."""
    if folder is None:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    parameters, factors = config.candidates(), done.solution.factors
    moved = [i for i, a in enumerate(factors.tolist()) if a != 1.0]
    return edit_fields(model, field_changes(model, parameters.take(moved), factors[moved]), folder)
