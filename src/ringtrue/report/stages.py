"""The stage results of a study by name, any of them absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, get_args, get_type_hints

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, did_you_mean
from ringtrue.plots.scene import thinned
from ringtrue.report.parts import Acceptance
from ringtrue.study.acceptance import Check
from ringtrue.study.results import (
    CompareStage,
    ConfigurationsStage,
    ConfiguredStage,
    CorrelateStage,
    DampingStage,
    FinalStage,
    IdentifyStage,
    LocaliseStage,
    ModelStage,
    PlanStage,
    PredictStage,
    Provenance,
    SensitivityStage,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)

DRAWN = 1_000_000  # nodes of all shapes together, eight bytes each in the page
FEWEST, MOST = 3000, 12_000  # nodes that are drawn of a model


@dataclass(frozen=True, slots=True)
class Stages:
    """What a report is made of; a stage that was not run is None."""

    title: str
    system_text: str
    acceptance: Acceptance
    checks: tuple[Check, ...] = ()
    model: ModelStage | None = None
    plan: PlanStage | None = None
    identify: IdentifyStage | None = None
    compare: CompareStage | None = None
    correlate: CorrelateStage | None = None
    configurations: ConfigurationsStage | None = None
    localise: LocaliseStage | None = None
    sensitivity: SensitivityStage | None = None
    update: UpdateStage | None = None
    tune: TuneStage | None = None
    final: FinalStage | None = None
    configured: ConfiguredStage | None = None
    uncertainty: UncertaintyStage | None = None
    damping: DampingStage | None = None
    predict: PredictStage | None = None
    provenance: Provenance | None = None

    @classmethod
    def of(
        cls,
        stages: Mapping[str, object],
        title: str,
        system_text: str,
        acceptance: Acceptance,
        checks: Sequence[Check] = (),
    ) -> Stages:
        """From a mapping.

        Raises
        ------
        ConfigError
            On an unknown name or a result of the wrong type.
        """
        known: dict[str, Any] = {}
        for name, value in stages.items():
            if name not in KINDS:
                raise ConfigError(f"no stage {name!r}{did_you_mean(name, KINDS)}")
            if value is not None and not isinstance(value, KINDS[name]):
                raise ConfigError(
                    f"stage {name}: got {type(value).__name__}, needs {KINDS[name].__name__}"
                )
            known[name] = value
        if (m := known.get("model")) is not None:
            most = min(max(DRAWN // max(len(m.modes), 1), FEWEST), MOST)
            known["model"] = replace(m, scene=thinned(m.scene, most))
        return cls(title, system_text, acceptance, tuple(checks), **known)

    @property
    def test(self) -> TestModel | None:
        """The test model as measured, else as planned; none of frequencies alone."""
        if self.identify is not None:
            hammer = self.identify.hammer
            return None if hammer is not None and hammer.lent else self.identify.test
        return self.plan.test if self.plan is not None else None

    @property
    def computed(self) -> Float:
        """Frequencies of the initial deck, Hz: up to [model] fmax, or as far as the test asked for
        them.
        """
        found = [
            s.frequencies
            for s in (self.model and self.model.modes, self.correlate and self.correlate.fe_initial)
            if s
        ]
        return max(found, key=len, default=np.zeros(0))

    @property
    def reference(self) -> ModeSet | None:
        """The test modes the model is judged by."""
        return self.correlate.reference if self.correlate is not None else None


KINDS: dict[str, type] = {
    n: get_args(h)[0] for n, h in get_type_hints(Stages).items() if NoneType in get_args(h)
}
