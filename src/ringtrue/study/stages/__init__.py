"""The stages of a study in order: what each needs, and what decides whether it is up to date."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ringtrue.core.iterate import Progress
from ringtrue.study.session import Session
from ringtrue.study.stages import (
    conditions,
    correlate,
    damping,
    final,
    identify,
    localise,
    model,
    plan,
    predict,
    tune,
    uncertainty,
    update,
)


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage.

    Attributes
    ----------
    name, title : str
    run : callable (Session, Progress) -> result
    sections : tuple of str
        Sections of study.toml without which it does not apply; `a|b` means one of the two.
    settings : tuple of str
        Sections that its result depends on, or single settings as `update.left_out`.
    needs : tuple of str
        Stages that it takes results of.
    files : callable, Session -> paths
        Files that it reads.
    """

    name: str
    title: str
    run: Callable[[Session, Progress], Any]
    sections: tuple[str, ...]
    settings: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    files: Callable[[Session], list[Path]] = lambda _: []

    def applies(self, session: Session) -> bool:
        """Whether the study has what the stage needs."""
        return not self.missing(session)

    def missing(self, session: Session) -> list[str]:
        """Sections that the study would need for it."""
        config = session.config
        return [
            s
            for s in self.sections
            if not any(getattr(config, n) for n in s.split("|"))
        ]


def _deck(session: Session) -> list[Path]:
    return [Path(f) for f in session.initial.model.files]


def _remodelled(session: Session) -> list[Path]:
    return [
        *_deck(session),
        *(session.base / step.cards for step in session.config.remodel),
    ]


def _configurations(session: Session) -> list[Path]:
    return [*_remodelled(session), *correlate.configuration_files(session)]


def _with_residuals(session: Session) -> list[Path]:
    files = [getattr(s, "file", None) for s in session.config.residual]
    return [*_remodelled(session), *(session.base / f for f in files if f)]


_BOTH = ("model", "test")
_UPDATED = (*_BOTH, "candidate|propose")
_CHANGED = (*_BOTH, "candidate|suspension|propose")

STAGES = (
    Stage(
        name="model",
        title="modes of the deck",
        run=model.run,
        sections=("model",),
        settings=("model",),
        files=_deck,
    ),
    Stage(
        name="plan",
        title="test plan",
        run=plan.run,
        sections=("model", "plan"),
        settings=("study.seed", "model", "plan", "candidate"),
        needs=("model",),
        files=_deck,
    ),
    Stage(
        name="identify",
        title="modes from the signals",
        run=identify.run,
        sections=("test",),
        settings=("test", "identify", "lending"),
        files=identify.files,
    ),
    Stage(
        name="compare",
        title="ambient against hammer",
        run=correlate.compare_tests,
        sections=("test",),
        settings=("correlate",),
        needs=("identify",),
    ),
    Stage(
        name="conditions",
        title="days, temperatures and levels",
        run=conditions.run,
        sections=("test",),
        needs=("identify", "compare"),
    ),
    Stage(
        name="correlate",
        title="model against test",
        run=correlate.correlate,
        sections=_BOTH,
        settings=("model", "correlate", "remodel", "identify", "update.left_out"),
        needs=("identify", "model"),
        files=_remodelled,
    ),
    Stage(
        name="configurations",
        title="other configurations against their tests",
        run=correlate.correlate_configurations,
        sections=(*_BOTH, "configuration"),
        settings=(
            "model",
            "identify",
            "correlate",
            "remodel",
            "configuration",
            "candidate",
            "suspension",
        ),
        needs=("correlate",),
        files=_configurations,
    ),
    Stage(
        name="localise",
        title="where the model is wrong",
        run=localise.run,
        sections=_BOTH,
        settings=(
            "study.seed",
            "candidate",
            "suspension",
            "localise",
            "update",
            "residual",
            "constraint",
        ),
        needs=("correlate", "configurations"),
        files=_with_residuals,
    ),
    Stage(
        name="sensitivity",
        title="sensitivities and parameter sets",
        run=update.choose_sets,
        sections=_UPDATED,
        settings=("study.seed", "candidate", "update", "residual", "constraint", "set"),
        needs=("correlate", "configurations", "localise"),
        files=_with_residuals,
    ),
    Stage(
        name="update",
        title="updating",
        run=update.update_sets,
        sections=_UPDATED,
        settings=("study.seed", "update"),
        needs=("configurations", "sensitivity"),
    ),
    Stage(
        name="tune",
        title="rigid-body tuning",
        run=tune.run,
        sections=(*_BOTH, "suspension"),
        settings=("suspension",),
        needs=("correlate", "configurations", "update"),
    ),
    Stage(
        name="final",
        title="delivered deck",
        run=final.deliver_final,
        sections=_CHANGED,
        needs=("update", "tune"),
    ),
    Stage(
        name="configured",
        title="delivered decks of the other configurations",
        run=final.deliver_configurations,
        sections=(*_BOTH, "configuration", "candidate|suspension|propose"),
        needs=("configurations", "update", "tune", "final"),
    ),
    Stage(
        name="uncertainty",
        title="uncertainty and left-out modes",
        run=uncertainty.run,
        sections=_UPDATED,
        settings=("study.seed", "uncertainty"),
        needs=("update", "tune", "final"),
    ),
    Stage(
        name="damping",
        title="damping by region",
        run=damping.run,
        sections=_CHANGED,
        settings=("damping", "suspension"),
        needs=("identify", "correlate", "final", "configured"),
    ),
    Stage(
        name="predict",
        title="run-up of the rotor",
        run=predict.run,
        sections=(*_UPDATED, "predict"),
        settings=("study.seed", "predict", "suspension"),
        needs=("update", "tune", "final", "damping"),
        files=_remodelled,
    ),
)
