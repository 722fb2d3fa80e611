"""What each stage of a study leaves in the store: one frozen type a stage, nothing filled in later.

A store names a type by its module: one written before this was a package finds it here.
"""

from ringtrue.study.results.correlated import (
    CompareStage,
    ConfigurationsStage,
    ConfiguredStage,
    ConfiguredTest,
    CorrelateStage,
    DeliveredConfiguration,
    Evidence,
    Expansion,
    FrfEvidence,
    RemodelStep,
    Seat,
)
from ringtrue.study.results.identified import (
    IdentifiedRecord,
    IdentifyStage,
    RecordSummary,
)
from ringtrue.study.results.model import (
    ModelStage,
    PlanStage,
    Provenance,
    Scene,
)
from ringtrue.study.results.updated import (
    DampedConfiguration,
    DampedModes,
    DampedRegions,
    DampingStage,
    DataResult,
    FinalStage,
    FinishedSet,
    LocaliseStage,
    PredictStage,
    SensitivityStage,
    SetResult,
    TunedConfiguration,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)

__all__ = [
    "CompareStage",
    "ConfigurationsStage",
    "ConfiguredStage",
    "ConfiguredTest",
    "CorrelateStage",
    "DampedConfiguration",
    "DampedModes",
    "DampedRegions",
    "DampingStage",
    "DataResult",
    "DeliveredConfiguration",
    "Evidence",
    "Expansion",
    "FinalStage",
    "FinishedSet",
    "FrfEvidence",
    "IdentifiedRecord",
    "IdentifyStage",
    "LocaliseStage",
    "ModelStage",
    "PlanStage",
    "PredictStage",
    "Provenance",
    "RecordSummary",
    "RemodelStep",
    "Scene",
    "Seat",
    "SensitivityStage",
    "SetResult",
    "TuneStage",
    "TunedConfiguration",
    "UncertaintyStage",
    "UpdateStage",
]
