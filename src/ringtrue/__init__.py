"""Finite element model validation: from a deck and vibration signals to a model that rings true.

The names in `__all__` are the public interface; every other module, class and function of the
package is private to the project and may change without notice. Parts are imported on first use.

>>> import ringtrue as rt
>>> model = rt.read_deck(rt.example_deck(), units="SI")
>>> fe = rt.solve_modes(model, band=(0, 100))
>>> fe.frequencies.round(2)
array([2.24, 6.28, 9.07])
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from ringtrue.api.checking import check_deck
    from ringtrue.api.comparison import correlate
    from ringtrue.api.improvement import (
        TestedModel,
        fit_damping,
        localise,
        parameter,
        tune_suspension,
        update,
    )
    from ringtrue.api.inspection import inspect_file
    from ringtrue.api.lookup import place_sensors, region_parameters
    from ringtrue.api.measurements import (
        estimate_frfs,
        identify_ambient,
        identify_ambient_setups,
        identify_frfs,
        modes_of_test,
        read_frfs,
        read_modes,
        read_record,
        read_sensors,
        write_modes,
    )
    from ringtrue.api.models import (
        frf,
        read_deck,
        read_deflections,
        solve_modes,
        static,
        write_deck,
    )
    from ringtrue.api.reduction import reduce_model
    from ringtrue.api.studies import open_study, plan_test, predict, run_study
    from ringtrue.api.trial import trial_model, trial_plan
    from ringtrue.core.parameters import ParameterSet
    from ringtrue.core.signals import Channel, FrfSet, TimeHistory
    from ringtrue.errors import (
        InputError,
        NumericalError,
        RingtrueError,
        SolverError,
        UnsupportedError,
    )
    from ringtrue.reduction.components import ReductionSettings
    from ringtrue.solvers.matrices import MatrixModel
    from ringtrue.solvers.observed import at_factors
    from ringtrue.study.config_sections import CorrelateSection as CorrelateSettings
    from ringtrue.study.config_sections import PlanSection as PlanSettings
    from ringtrue.study.config_sections import PredictSection as PredictSettings
    from ringtrue.study.config_update import UpdateSection as UpdateSettings

_PLACES = {  # module -> public names in it
    "api.checking": "check_deck",
    "api.lookup": "place_sensors region_parameters",
    "api.models": "frf read_deck read_deflections solve_modes static write_deck",
    "api.measurements": "estimate_frfs identify_ambient identify_ambient_setups identify_frfs "
    "modes_of_test read_frfs read_modes read_record read_sensors write_modes",
    "api.comparison": "correlate",
    "api.inspection": "inspect_file",
    "api.improvement": "TestedModel fit_damping localise parameter tune_suspension update",
    "api.reduction": "reduce_model",
    "reduction.components": "ReductionSettings",
    "api.studies": "open_study plan_test predict run_study",
    "api.trial": "trial_model trial_plan",
    "core.parameters": "ParameterSet",
    "core.signals": "Channel FrfSet TimeHistory",
    "errors": "InputError NumericalError RingtrueError SolverError UnsupportedError",
    "solvers.matrices": "MatrixModel",
    "solvers.observed": "at_factors",
}
_SETTINGS = {  # public name -> module and the section of study.toml that it is
    "CorrelateSettings": ("study.config_sections", "CorrelateSection"),
    "PlanSettings": ("study.config_sections", "PlanSection"),
    "PredictSettings": ("study.config_sections", "PredictSection"),
    "UpdateSettings": ("study.config_update", "UpdateSection"),
}
_WHERE = {
    name: (module, name) for module, names in _PLACES.items() for name in names.split()
}
_WHERE |= _SETTINGS

__all__ = [
    "Channel",
    "CorrelateSettings",
    "FrfSet",
    "InputError",
    "MatrixModel",
    "NumericalError",
    "ParameterSet",
    "PlanSettings",
    "PredictSettings",
    "ReductionSettings",
    "RingtrueError",
    "SolverError",
    "TestedModel",
    "TimeHistory",
    "UnsupportedError",
    "UpdateSettings",
    "at_factors",
    "check_deck",
    "correlate",
    "estimate_frfs",
    "example_deck",
    "fit_damping",
    "frf",
    "identify_ambient",
    "identify_ambient_setups",
    "identify_frfs",
    "inspect_file",
    "localise",
    "modes_of_test",
    "open_study",
    "parameter",
    "place_sensors",
    "plan_test",
    "predict",
    "read_deck",
    "read_deflections",
    "read_frfs",
    "read_modes",
    "read_record",
    "read_sensors",
    "reduce_model",
    "region_parameters",
    "run_study",
    "solve_modes",
    "static",
    "trial_model",
    "trial_plan",
    "tune_suspension",
    "update",
    "write_deck",
    "write_modes",
]


def example_deck() -> Path:
    """The path of a deck of three floors on springs, for examples."""
    return Path(__file__).parent / "api" / "example.bdf"


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'ringtrue' has no attribute {name!r}")
    module, inside = _WHERE[name]
    value = getattr(import_module(f"ringtrue.{module}"), inside)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
