"""The stages of a study in order: what each needs, and which settings and files decide whether it
is up to date.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ringtrue.core.progress import Progress
from ringtrue.study.stages import (
    compare,
    configurations,
    configured,
    correlate,
    damping,
    final,
    identify,
    localise,
    model,
    plan,
    predict,
    sensitivity,
    tune,
    uncertainty,
    update,
)
from ringtrue.study.workbench import Workbench


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage.

    Attributes
    ----------
    name, title : str
    run : callable (Workbench, Progress) -> result
    settings : tuple of str
        Sections of study.toml that it depends on, or single settings as `update.left_out`.
    needs : tuple of str
        Stages that it takes results of.
    inputs : callable, Workbench -> files
        Files that it reads.
    sections : tuple of str
        Sections without which it does not apply; `a|b` means one of the two.
    """

    name: str
    title: str
    run: Callable[[Workbench, Progress], Any]
    settings: tuple[str, ...]
    needs: tuple[str, ...]
    inputs: Callable[[Workbench], list[Path]]
    sections: tuple[str, ...]

    def applies(self, desk: Workbench) -> bool:
        """Whether the study has what the stage needs."""
        return not self.lacks(desk)

    def lacks(self, desk: Workbench) -> list[str]:
        """Sections that the study would need for it."""
        return [s for s in self.sections if not any(getattr(desk.config, n) for n in s.split("|"))]

    def files(self, desk: Workbench) -> list[Path]:
        """Files that it reads."""
        return self.inputs(desk)


def _nothing(desk: Workbench) -> list[Path]:
    return []


def _deck(desk: Workbench) -> list[Path]:
    return [Path(f) for f in desk.initial.model.files]


def _remodelled(desk: Workbench) -> list[Path]:
    return [*_deck(desk), *(desk.base / step.cards for step in desk.config.remodel)]


def _residual_files(desk: Workbench) -> list[Path]:
    return [desk.base / f for s in desk.config.residual if (f := getattr(s, "file", None))]


_BOTH = ("model", "test")
STAGES = (
    Stage("model", "modes of the deck", model.run, ("model",), (), _deck, ("model",)),
    Stage("plan", "test plan", plan.run, ("model", "plan"), ("model",), _deck, ("model", "plan")),
    Stage(
        "identify",
        "modes from the signals",
        identify.run,
        ("test", "identify", "lending"),
        (),
        identify.files,
        ("test",),
    ),
    Stage(
        "compare",
        "ambient against hammer",
        compare.run,
        ("correlate",),
        ("identify",),
        _nothing,
        ("test",),
    ),
    Stage(
        "correlate",
        "model against test",
        correlate.run,
        ("model", "correlate", "remodel", "identify", "update.left_out"),
        ("identify", "model"),
        _remodelled,
        _BOTH,
    ),
    Stage(
        "configurations",
        "other configurations against their tests",
        configurations.run,
        ("model", "identify", "correlate", "remodel", "configuration", "candidate", "suspension"),
        ("correlate",),
        lambda desk: [*_remodelled(desk), *configurations.files(desk)],
        (*_BOTH, "configuration"),
    ),
    Stage(
        "localise",
        "where the model is wrong",
        localise.run,
        ("candidate", "suspension", "localise", "update", "residual", "constraint"),
        ("correlate", "configurations"),
        lambda desk: [*_remodelled(desk), *_residual_files(desk)],
        _BOTH,
    ),
    Stage(
        "sensitivity",
        "sensitivities and parameter sets",
        sensitivity.run,
        ("candidate", "update", "residual", "constraint", "set"),
        ("correlate", "configurations", "localise"),
        lambda desk: [*_remodelled(desk), *_residual_files(desk)],
        (*_BOTH, "candidate|propose"),
    ),
    Stage(
        "update",
        "updating",
        update.run,
        ("update",),
        ("configurations", "sensitivity"),
        _nothing,
        (*_BOTH, "candidate|propose"),
    ),
    Stage(
        "tune",
        "rigid-body tuning",
        tune.run,
        ("suspension",),
        ("correlate", "configurations", "update"),
        _nothing,
        (*_BOTH, "suspension"),
    ),
    Stage(
        "final",
        "delivered deck",
        final.run,
        (),
        ("update", "tune"),
        _nothing,
        (*_BOTH, "candidate|suspension|propose"),
    ),
    Stage(
        "configured",
        "delivered decks of the other configurations",
        configured.run,
        (),
        ("configurations", "update", "tune", "final"),
        _nothing,
        (*_BOTH, "configuration", "candidate|suspension|propose"),
    ),
    Stage(
        "uncertainty",
        "uncertainty and left-out modes",
        uncertainty.run,
        ("uncertainty",),
        ("update", "tune", "final"),
        _nothing,
        (*_BOTH, "candidate|propose"),
    ),
    Stage(
        "damping",
        "damping by region",
        damping.run,
        ("damping", "suspension"),
        ("identify", "correlate", "final", "configured"),
        _nothing,
        (*_BOTH, "candidate|suspension|propose"),
    ),
    Stage(
        "predict",
        "run-up of the rotor",
        predict.run,
        ("predict", "suspension"),
        ("update", "tune", "final", "damping"),
        _remodelled,
        (*_BOTH, "candidate|propose", "predict"),
    ),
)
