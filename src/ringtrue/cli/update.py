"""`update`: the candidates of a study, fitted to a file of test modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from ringtrue.cli.model import TimeLimit
from ringtrue.cli.show import Json, err, one_of, progress, write_json
from ringtrue.cli.stated import stated
from ringtrue.cli.updated import show_summary, summary_of
from ringtrue.core.progress import part
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.editor import edit_fields, refuse_copy, refuse_unwritable
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.model.edit import field_changes
from ringtrue.model.model import Model
from ringtrue.solvers.registry import EMBEDDED, solver
from ringtrue.study.config import StudyConfig, read_config
from ringtrue.study.config_update import (
    DataResidual,
    Discrepancy,
    FrfResidual,
    MassResidual,
    Search,
    StaticResidual,
    UpdateSection,
)
from ringtrue.study.direct import (
    AGREE,
    direct_problem,
    not_told_apart,
    read_target,
    solved,
    unmoved_by,
)
from ringtrue.study.messages import held_sentences
from ringtrue.study.objective import KINDS as KINDS_OF_MODES
from ringtrue.study.objective import LOSSES
from ringtrue.study.opened import Opened
from ringtrue.study.placing import seat_words, seats_json
from ringtrue.updating.regularisation import RULES
from ringtrue.updating.solver import KINDS
from ringtrue.updating.strategy import Verified


def update(
    study: Annotated[Path, typer.Argument(help="study.toml with a deck and candidates.")],
    test: Annotated[
        Path,
        typer.Argument(
            help="Test modes, .json, .h5, .uff, .csv or .xlsx; channels of the study's sheet, or "
            "DOFs such as 101+Z."
        ),
    ],
    folder: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where the updated deck goes.")
    ] = None,
    leave_out: Annotated[
        str, typer.Option(metavar="LIST", help="Test modes to judge by, from 1: 3,7.")
    ] = "",
    method: Annotated[str | None, one_of("--method", KINDS, "Kind of step")] = None,
    prior: Annotated[
        str | None, one_of("--prior", ("study", *RULES), "Weight of the prior")
    ] = None,
    loss: Annotated[str | None, one_of("--loss", LOSSES, "Against a wrong mode")] = None,
    discrepancy: Annotated[
        str | None,
        one_of("--discrepancy", get_args(Discrepancy), "Deviations that the best model keeps"),
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(
            metavar="%", help="Deviation of a frequency that the best model keeps.", min=1e-3
        ),
    ] = None,
    mac_percent: Annotated[
        float | None, typer.Option("--mac", metavar="%", help="The same for 100 - MAC.", min=1e-3)
    ] = None,
    residuals: Annotated[
        str | None,
        typer.Option(
            metavar="LIST", help=f"What is compared of modes, any of {', '.join(KINDS_OF_MODES)}."
        ),
    ] = None,
    frf: Annotated[
        Path | None,
        typer.Option(
            "--frf", metavar="FILE", help="Measured FRFs, compared too: .uff, .h5 or .npz."
        ),
    ] = None,
    static: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Static tests: CSV with case, channel, load, deflection."
        ),
    ] = None,
    mass: Annotated[
        float | None, typer.Option(metavar="KG", help="Weighed mass of the structure.", min=0)
    ] = None,
    starts: Annotated[
        int | None, typer.Option(metavar="N", help="Starts; the first is the deck as it is.", min=1)
    ] = None,
    search: Annotated[
        str | None,
        one_of(
            "--search",
            get_args(Search),
            "Where it begins: at the best of the starts, or a global search",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of starts and search.", min=0)
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Keep the last iterate here; go on from it if it is there."
        ),
    ] = None,
    solver_name: Annotated[
        str | None,
        typer.Option(
            "--solver",
            help="That of the study, or embedded, mystran, nastran, slepc, a plug-in: solved at "
            "each point.",
        ),
    ] = None,
    time_limit: TimeLimit = None,
    json: Json = None,
) -> int:
    """Update a model to test modes: factors with their uncertainty, deviations before and after,
    the deck edited.

    What no option says is as the study updates; what is compared beside modes comes from the
    residual tables of the study and --frf, --static, --mass.

    Example: ringtrue update study.toml modes.json --leave-out 3,7 --out updated
    """
    words = {
        "step": method,
        "prior": prior,
        "loss": loss,
        "discrepancy": discrepancy,
        "starts": starts,
        "search": search,
    }
    config = _settings(
        read_config(study), words, residuals, frequency, mac_percent, (frf, static, mass)
    )
    solver_name = solver_name or (config.model.solver if config.model else EMBEDDED)
    anew = solver_name != EMBEDDED
    _check(config.update, checkpoint, anew)
    if time_limit is not None and not anew:
        raise ConfigError("--time-limit is for a --solver that is another program")
    engine = solver(solver_name, timeout=time_limit) if anew else None
    if config.model is None or not config.candidate:
        raise ConfigError(
            f"{study}: an updating needs a [model] with a deck and at least one [[candidate]]"
        )
    if anew and config.residual:
        raise ConfigError(
            f"--solver {solver_name} gives modes alone: FRFs, static tests and a weighed mass "
            "need the embedded solver"
        )
    with progress("updating") as show:
        show(0.0, "reading")
        opened = Opened(
            stated(read_deck(study.parent / config.model.deck), config.model.units),
            UNIT_SYSTEMS[config.model.units].length,
        )
        model = opened.model
        config, target, modes, notes = read_target(config, opened, test)
        target = replace(
            target, used=~np.isin(np.arange(len(modes)), _left_out(leave_out, len(modes)))
        )
        if folder is not None:
            refuse_unwritable(model, config.candidates())
            refuse_copy(model, folder)
        show(0.1, f"first runs of {solver_name}" if anew else "reduced basis")
        problem, extra, places = direct_problem(opened, config, target, modes, study.parent, None)
        held = not_told_apart(problem)
        config = config.model_copy(
            update={"candidate": [c for c in config.candidate if c.name not in held]}
        )
        if held or engine is not None:
            problem, extra, places = direct_problem(
                opened, config, target, modes, study.parent, engine
            )
        seed = config.study.seed if seed is None else seed
        done = solved(problem, config.update, seed, checkpoint, part(show, 0.3, 1.0))
    written = _edited(model, config, done, folder)
    summary = summary_of(config, problem, done, extra, solver_name, not notes) | {
        "deck": [str(p) for p in written],
        "notes": [*notes, *seat_words(places), *held_sentences(held)],
    }
    summary |= {"sensors": seats_json(places)} if places else {}
    if json:
        write_json(summary, json)
    if json != "-":
        show_summary(study, summary)
    good = done.solution.outcome.ok and done.error <= AGREE
    if not good:
        err.print(f"not to be trusted: {summary['why']}")
    return 0 if good else 1


def _check(u: UpdateSection, checkpoint: Path | None, anew: bool) -> None:
    """Options before any work."""
    if anew and u.search == "global":
        raise ConfigError("--search global takes thousands of points: it needs the embedded solver")
    if not u.one_start and checkpoint is not None:
        raise ConfigError(
            "--checkpoint keeps one iterate: it does not go with --starts and --search global"
        )
    if u.prior != "study" and checkpoint is not None:
        raise ConfigError(
            "--checkpoint keeps no weight of the prior: it goes with --prior study only"
        )


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
    """The study with what the options say in place of it, and files and a mass beside its
    [[residual]]s.
    """
    change: dict[str, Any] = {n: v for n, v in words.items() if v is not None}
    if words["search"] == "global" and words["starts"] is not None:
        raise ConfigError("--starts N or --search global: an updating begins in one way")
    if residuals is not None:
        names = [t.strip() for t in residuals.split(",") if t.strip()]
        for name in names:
            if name not in KINDS_OF_MODES:
                raise ConfigError(f"--residuals {name!r}{did_you_mean(name, KINDS_OF_MODES)}")
        if not names:
            raise ConfigError(
                f"--residuals {residuals!r}: at least one of {', '.join(KINDS_OF_MODES)}"
            )
        change["residuals"] = list(dict.fromkeys(names))
    change |= {
        n: v / 100 for n, v in (("frequency_error", frequency), ("mac_error", mac)) if v is not None
    }
    frf, static, mass = more
    extra: list[DataResidual] = list(config.residual)
    if wrong := [r for r in extra if r.configuration]:
        raise ConfigError(
            f"[[residual]] of configuration {wrong[0].configuration!r}: use ringtrue run"
        )
    extra += [FrfResidual(kind="frf", file=str(frf.absolute()))] if frf else []
    extra += [StaticResidual(kind="static", file=str(static.absolute()))] if static else []
    extra += [MassResidual(kind="mass", mass=mass)] if mass else []
    return config.model_copy(update={"update": config.update.otherwise(change), "residual": extra})


def _edited(model: Model, config: StudyConfig, done: Verified, folder: Path | None) -> list[Path]:
    """The deck with its fields changed in place, in another folder."""
    if folder is None:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    parameters, end = config.candidates(), done.solution
    factors = np.where(unmoved_by(done.solution), 1.0, end.factors)
    moved = [i for i, a in enumerate(factors.tolist()) if a != 1.0]
    return edit_fields(model, field_changes(model, parameters.take(moved), factors[moved]), folder)
