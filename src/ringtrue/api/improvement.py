"""From pairs to a better model: localisation, updating, suspension, damping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ringtrue.api.measurements import TestModes, modes_at
from ringtrue.api.models import open_model
from ringtrue.core.arrays import Bool, Float
from ringtrue.core.display import Displayed, plot
from ringtrue.core.iterate import Outcome, Progress, part, quiet
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.assignment import NO_LOCKS, PairingSettings
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.table import CorrelationTable, correlation_table
from ringtrue.errors import DataError, InputError
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.parametric import modes_of
from ringtrue.shapes import realise_modes
from ringtrue.solvers.matrices import MatrixModel
from ringtrue.solvers.observed import at_factors, reduced
from ringtrue.study.config_sections import (
    CorrelateSection,
    LocaliseSection,
    parse_target,
)
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.direct import (
    DirectProposal,
    mode_count,
    not_fitted,
    not_told_apart,
    propose_parameters,
    solved,
)
from ringtrue.study.form import UpdatedDeck, form_of
from ringtrue.study.objective import LOSSES, Minimisation, modal_terms
from ringtrue.study.opened import Opened
from ringtrue.study.placing import placed, seat_words, seats
from ringtrue.study.reference import highest, measured_part
from ringtrue.study.results import Seat
from ringtrue.study.stages.damping import DampedDeck, MeasuredDamping, fit_regions
from ringtrue.study.stages.tune import WEIGHTS as RIGID_WEIGHTS
from ringtrue.study.stages.tune import tuned
from ringtrue.study.supplied import pair_frequencies
from ringtrue.updating.damping_regions import DampingRegion, default_regions
from ringtrue.updating.form_uncertainty import FormPosterior, form_posterior
from ringtrue.updating.problem import Configuration, Evaluated, Problem, held_to
from ringtrue.updating.selection.candidates import CandidateSettings
from ringtrue.updating.selection.form import FormFindings
from ringtrue.updating.selection.missing_members import MissingMember
from ringtrue.updating.solver import Solution
from ringtrue.updating.target import Target, Weights
from ringtrue.updating.uncertainty import laplace
from ringtrue.updating.validation import Misfit, misfits


def parameter(
    name: str, *fields: str, lower: float = 0.2, upper: float = 5.0, std: float = 0.7
) -> Parameter:
    """A parameter of an updating: a common factor on fields of a deck.

    Parameters
    ----------
    name : str
    fields : str
        Such as `"MAT1 7 E"` or `"PBUSH 3 K1,K2,K3"`.
    lower, upper : float
        Bounds of the factor; they enclose 1.
    std : float
        Prior standard deviation of ln(factor).

    Raises
    ------
    InputError
        If a field is not of this form, or the bounds do not enclose 1.

    Examples
    --------
    >>> import ringtrue as rt
    >>> rt.parameter("foot", "PELAS 1 K", lower=0.5, upper=2.0).name
    'foot'
    """
    try:
        targets = tuple(target for text in fields for target in parse_target(text))
    except ValueError as e:
        raise InputError(f"parameter {name}: {e}") from e
    return Parameter(name, targets, lower, upper, std=std)


@dataclass(frozen=True, eq=False)
class Localisation(Displayed):
    """Parameters that the test modes ask for.

    Attributes
    ----------
    names : tuple of str
        The proposed parameters, the most worthwhile first.
    factors : (k,) float64
        Updated over initial value, of a short updating.
    std : (k,) float64
        Standard deviation of ln(factor).
    worth : (k,) float64
        By how much AICc falls.
    proposal : ParameterSet
        The factors, to be handed to `update`. Missing masses are in `found` alone.
    members : tuple of MissingMember
        Braces, joints and supports that the deck may lack, ranked by what one stiffness explains of
        what the proposal leaves; each is judged by itself.
    form : FormFindings
        What the deviations follow: missing shear flexibility, soft supports, a factor in common,
        one mode alone, joints that dissipate; its `notes` name what stands out.
    notes : tuple of str
    seats : tuple of Seat
        Where each sensor reads the model.
    found : DirectProposal
        All candidates and the reasons of the choice.
    """

    names: tuple[str, ...]
    factors: Float
    std: Float
    worth: Float
    proposal: ParameterSet
    members: tuple[MissingMember, ...]
    form: FormFindings
    notes: tuple[str, ...]
    seats: tuple[Seat, ...]
    found: DirectProposal


def localise(
    model: Model,
    test: ModeSet | TestModes,
    *,
    sensors: SensorSheet | str | Path | None = None,
    tolerance: float | None = None,
    most: int = 8,
    pool: int = LocaliseSection.model_fields["pool"].default,
    progress: Progress = quiet,
) -> Localisation:
    """Which regions of a model may be wrong: candidates from the deck, ranked and explained.

    Parameters
    ----------
    model : Model
    test : ModeSet or TestModes
        Without channels, frequencies alone are compared.
    sensors : SensorSheet or path, optional
        Where the channels are; without it they are degrees of freedom such as `101+Z`.
    tolerance : float, m, optional
        Largest distance of a sensor from a node.
    most : int
        Most parameters that are proposed.
    pool : int
        Candidates that are looked at closely: those that explain most of the misfit.

    Returns
    -------
    Localisation

    Raises
    ------
    DataError
        If a channel is not on the model.

    References
    ----------
    Friswell and Mottershead (1995), ch. 6; Burnham and Anderson (2002), AICc.

    Examples
    --------
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> foot = rt.ParameterSet([rt.parameter("foot", "PELAS 1 K")])
    >>> true = rt.solve_modes(rt.at_factors(model, foot, [0.7]))
    >>> len(rt.localise(model, true.at(["2+X", "3+X", "4+X"])).proposal) > 0
    True
    """
    opened = open_model(model)
    at = _at_channels(opened, test, sensors, tolerance)
    form = _form(opened, at)
    settings = CandidateSettings(units=model.units)
    found = propose_parameters(
        opened,
        realise_modes(at.modes),
        bridge=at.bridge,
        settings=settings,
        limits=(pool, most),
        progress=part(progress, 0.1, 1.0),
    )
    members = found.proposal.members
    by_name = {c.name: c.parameter for c in found.candidates}
    return Localisation(
        names=tuple(m.name for m in members),
        factors=np.array([m.factor for m in members]),
        std=np.array([m.std for m in members]),
        worth=np.array([m.worth for m in members]),
        proposal=ParameterSet(tuple(by_name[m.name] for m in members if not m.lump)),
        members=found.members,
        form=form,
        notes=at.notes,
        seats=at.seats,
        found=found,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """Test modes and where their channels are on a model; without shapes, those of the model."""

    modes: ModeSet
    std: Uncertainty | None
    bridge: Observation
    notes: tuple[str, ...]
    seats: tuple[Seat, ...] = ()


def _at_channels(
    opened: Opened,
    test: ModeSet | TestModes,
    sensors: SensorSheet | str | Path | None,
    tolerance: float | None,
) -> _Placed:
    """The test on the model; where it has no channels, frequencies alone are paired."""
    modes = modes_at(test)
    std = test.uncertainty if isinstance(test, TestModes) else None
    if not modes.channels:
        borrowed = pair_frequencies(modes, opened, CorrelateSection().gates(), NO_LOCKS)
        bridge = opened.observation(borrowed.points, np.inf)
        kept = measured_part(borrowed.modes)[0]
        std = None if std is None else std.take(kept)
        return _Placed(borrowed.modes.take(kept), std, bridge, borrowed.notes)
    sheet = read_sensor_sheet(sensors) if isinstance(sensors, str | Path) else sensors
    bridge = placed(opened, modes.channels, _place(sensors), tolerance=tolerance)
    places = seats(bridge, sheet.model) if sheet is not None else ()
    return _Placed(modes, std, bridge, seat_words(places), places)


def form_findings(
    model: Model,
    test: ModeSet | TestModes,
    *,
    sensors: SensorSheet | str | Path | None = None,
    tolerance: float | None = None,
) -> FormFindings:
    """`Localisation.form` by itself: arguments as of `localise`."""
    opened = open_model(model)
    return _form(opened, _at_channels(opened, test, sensors, tolerance))


def _form(opened: Opened, at: _Placed) -> FormFindings:
    """Patterns of form of a test on a model."""
    modes = realise_modes(at.modes)
    elastic = modes.frequencies > 0
    aim = Target(
        frequencies=modes.frequencies,
        shapes=np.asarray(modes.shapes.real, dtype=np.float64),
        std=np.zeros(len(modes)),
        used=elastic,
        weights=Weights(shape=0.0) if modes.frequency_only else Weights(),
        frequency_only=modes.frequency_only,
    )
    request = ModesRequest(modes_of(mode_count(len(modes))))
    found = opened.analysis.modes(request).modes
    return form_of(
        opened, found, modes, std=at.std, target=aim, observe=at.bridge.matrix
    )


def _place(sensors: SensorSheet | str | Path | None) -> SensorSheet | Path | None:
    return Path(sensors) if isinstance(sensors, str) else sensors


@dataclass(frozen=True, slots=True, eq=False)
class TestedModel:
    """A model with its test, one of several configurations of an updating.

    Attributes
    ----------
    model : Model or MatrixModel
    test : TestModes or ModeSet
    sensors : SensorSheet or path, optional
    parameters : tuple of str, optional
        Names of the parameters that this model has; all if not given.
    """

    __test__: ClassVar[bool] = False  # not a test of pytest

    model: Model | MatrixModel
    test: TestModes | ModeSet
    sensors: SensorSheet | str | Path | None = None
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ModeBands:
    """Where an updated model expects the frequencies of a test.

    Attributes
    ----------
    test, predicted : (m,) float64, Hz
        NaN in `predicted` where a test mode has no partner.
    low, high : (m,) float64, Hz
        90 % band of the measured frequency, with the errors of parameters, test and form.
    used : (m,) bool
        Whether the updating has seen it; a band of such a mode is narrow.
    """

    test: Float
    predicted: Float
    low: Float
    high: Float
    used: Bool

    @classmethod
    def of(cls, problem: Problem, at: Evaluated, ratio: Float) -> ModeBands:
        """From intervals (m, 2) of the measured frequency over the model's."""
        aim = problem.configurations[0].target
        here = at.points[0]
        predicted = np.full(aim.frequencies.size, np.nan)
        test, fe = here.every.T
        predicted[test] = here.now.frequencies[fe]
        low, high = predicted * ratio.T
        return cls(aim.frequencies, predicted, low, high, aim.used)


@dataclass(frozen=True, slots=True, eq=False)
class FormErrors:
    """What errors of the model's form leave open.

    Attributes
    ----------
    flags : dict of str to str
        Parameters that may take them up, with what each would be without.
    bands : ModeBands, optional
    """

    flags: Mapping[str, str] = field(default_factory=dict)
    bands: ModeBands | None = None


@dataclass(frozen=True, eq=False)
class UpdatedModel(Displayed):
    """An updated model.

    Attributes
    ----------
    names : tuple of str
    factors : (p,) float64
        Updated over initial value; 1 where held. All of them, whether the test proves them or not:
        see `low` and `high`.
    interval : (p, 2) float64
        The 90 % interval of each factor, also `low` and `high`; the bounds of the parameter where
        held. With one model and stated errors of its frequencies, errors of form count, too.
    models : tuple of Model or MatrixModel
        With the factors applied, of all configurations.
    before, after : CorrelationTable
        Of the first configuration.
    outcome : Outcome
        Converged, stalled or stopped.
    why : str
        What met the tolerance, or why the updating ended.
    basis_error : float
        Relative frequency error of the reduced model at the end.
    misfits : tuple of Misfit
        Kinds of residuals beyond their stated errors: the end is no global minimum, or the form of
        the model is wrong.
    held : dict of str to tuple of str
        Parameters that the data cannot distinguish from others, with those that stand for them.
    form : FormErrors
        Parameters that may take up errors of the model's form, and bands of the frequencies, left
        out ones too: with one model and stated errors of its frequencies.
    """

    names: tuple[str, ...]
    factors: Float
    interval: Float
    models: tuple[Model | MatrixModel, ...]
    before: CorrelationTable
    after: CorrelationTable
    outcome: Outcome
    why: str
    basis_error: float
    misfits: tuple[Misfit, ...] = ()
    held: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    form: FormErrors = field(default_factory=lambda: FormErrors())

    @property
    def low(self) -> Float:
        """Lower ends (p,) of the intervals."""
        return self.interval[:, 0]

    @property
    def high(self) -> Float:
        """Upper ends (p,) of the intervals."""
        return self.interval[:, 1]

    @property
    def model(self) -> Model | MatrixModel:
        """With the factors applied; of several configurations the first."""
        return self.models[0]

    def displayed(self) -> Mapping[str, Any]:
        """What is shown, by name: the fields, the ends of the intervals as columns."""
        ends = {"low": self.low, "high": self.high}
        others = {k: v for k, v in super().displayed().items() if k != "interval"}
        return {"names": self.names, "factors": self.factors, **ends, **others}

    def plot(self) -> Any:
        """The MAC matrix of the updated model, a plotly figure."""
        return plot(self.after)


def update(
    model: Model | MatrixModel | Sequence[TestedModel],
    test: TestModes | ModeSet | None,
    parameters: ParameterSet | Sequence[Parameter],
    *,
    sensors: SensorSheet | str | Path | None = None,
    leave_out: Sequence[int] = (),
    shape_std: Float | Sequence[float] | None = None,
    settings: UpdateSection | None = None,
    seed: int = 0,
    progress: Progress = quiet,
) -> UpdatedModel:
    """Update parameters of a model so that its modes are those of a test.

    Parameters
    ----------
    model : Model, MatrixModel, or several TestedModel
        Several configurations have common parameters by name; `test` and `sensors` are then None.
    test : TestModes or ModeSet
        The standard deviations of its frequencies count, one a mode.
    parameters : ParameterSet or sequence of Parameter
        Each has bounds and a prior standard deviation.
    sensors : SensorSheet or path, optional
        Where the channels are; without it they are degrees of freedom such as `101+Z`.
    leave_out : sequence of int
        Test modes, from 1, to judge the result by.
    shape_std : (channel,), optional
        Standard deviations of the shape components, one a channel; equal if not given.
    settings : UpdateSettings, optional
        What is compared, weights, prior, loss, starts.
    seed : int
        Of the starts.

    Returns
    -------
    UpdatedModel

    Raises
    ------
    InputError
        If a parameter is not in the model.
    NumericalError
        If no step can be solved.

    References
    ----------
    Friswell and Mottershead (1995), Finite Element Model Updating in Structural Dynamics, ch. 8.

    Examples
    --------
    >>> import numpy as np
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> foot = rt.ParameterSet([rt.parameter("foot", "PELAS 1 K")])
    >>> true = rt.solve_modes(rt.at_factors(model, foot, [0.7]))
    >>> result = rt.update(model, true.at(["2+X", "4+X"]), foot)
    >>> result.factors.round(3), result.outcome.ok
    (array([0.7]), True)
    """
    u = settings or UpdateSection()
    every = (
        parameters
        if isinstance(parameters, ParameterSet)
        else ParameterSet(tuple(parameters))
    )
    if isinstance(model, Model | MatrixModel):
        if test is None:
            raise InputError("update: a model needs its test modes")
        tests: Sequence[TestedModel] = (TestedModel(model, test, sensors),)
    else:
        tests = model
        if not tests or test is not None:
            raise InputError(
                "update: of several configurations each TestedModel has its own test"
            )
    scale = None if shape_std is None else np.asarray(shape_std, dtype=np.float64)
    configurations = []
    for k, one in enumerate(tests):
        mine = every
        if one.parameters:
            mine = every.take(every.at(one.parameters))
        configurations.append(
            _configuration(one, mine, leave_out, scale, u, f"configuration {k + 1}")
        )
    problem = Problem(tuple(configurations), every, loss=LOSSES[u.loss])
    held = not_told_apart(problem)
    if held:
        problem = held_to(problem, [n for n in every.names if n not in held])
    if len(tests) == 1:
        done = solved(problem, Minimisation(u, seed), progress)
        solution = done.solution
        final = done.problem
        error = done.error
        unfit = not_fitted(problem, done)
    else:
        end = Minimisation(u, seed).run(problem, progress)
        solution = end.solution
        final = end.problem
        error = float("nan")
        unfit = misfits(problem, problem.evaluate(solution.y))
    start = final.evaluate(np.zeros(final.size))
    interval = laplace(final, solution.end).interval(0.9)  # of the intervals of factors
    form = FormErrors()
    stated = (final.configurations[0].target.std > 0).all()
    if len(tests) == 1 and isinstance(tests[0].model, Model) and stated:
        found = _with_form_errors(tests[0], final, solution)
        interval = found.interval(0.9)
        flags = {n: why for n, why in found.flags().items() if n not in held}
        form = FormErrors(flags, ModeBands.of(final, solution.end, found.band(0.9)))
    bounds = np.stack([every.factors(x) for x in every.bounds()], axis=1)
    interval = np.where(np.isin(every.names, list(held))[:, None], bounds, interval)
    factors = dict(zip(every.names, solution.factors.tolist(), strict=True))
    made = tuple(_at_end(one.model, every, factors, one.parameters) for one in tests)
    return UpdatedModel(
        names=every.names,
        factors=solution.factors,
        interval=interval,
        models=made,
        before=_table(final, start, tests[0].test),
        after=_table(final, solution.end, tests[0].test),
        outcome=solution.outcome,
        why=solution.why,
        basis_error=error,
        misfits=unfit,
        held=held,
        form=form,
    )


def _with_form_errors(
    one: TestedModel, problem: Problem, solution: Solution
) -> FormPosterior:
    """What errors of form leave open of the parameters of one model."""
    assert isinstance(one.model, Model)
    own = problem.configurations[0].model.parameters
    factors = own.factors(solution.x[problem.parameters.at(own.names)])
    opened = open_model(at_factors(one.model, own, factors))
    channels = modes_at(one.test).channels
    sheet = _place(one.sensors)
    end = problem.evaluate(solution.y)  # by the weights that were found
    deck = UpdatedDeck(opened, problem, end, lambda o: placed(o, channels, sheet))
    return form_posterior(problem, end, deck.effects(), deck.field())


def _configuration(
    one: TestedModel,
    parameters: ParameterSet,
    leave_out: Sequence[int],
    shape_std: Float | None,
    u: UpdateSection,
    name: str,
) -> Configuration:
    """A model and its test as the updating sees them."""
    modes = realise_modes(modes_at(one.test))
    count = len(modes)
    wrong = [i for i in leave_out if not 1 <= i <= count]
    if wrong or len(set(leave_out)) >= count:
        raise InputError(
            f"leave_out {list(leave_out)}: some of the modes 1 to {count}, not all"
        )
    relative = np.zeros(count)
    if isinstance(one.test, TestModes):
        relative = np.nan_to_num(one.test.std_frequency / modes.frequencies)
    gates = CorrelateSection().gates()
    shapes = np.asarray(modes.shapes.real, dtype=np.float64)
    if isinstance(one.model, MatrixModel):
        bridge = one.model.observe([int(c.split("+")[0]) - 1 for c in modes.channels])
    else:
        opened = open_model(one.model)
        bridge = placed(opened, modes.channels, _place(one.sensors))
    if shape_std is not None:
        if shape_std.shape != (len(modes.channels),) or not (shape_std > 0).all():
            raise InputError(
                f"shape_std {shape_std.shape}: one value > 0 for each channel"
            )
        weight = np.median(shape_std) / shape_std
        shapes = shapes * weight[:, None]
        bridge = replace(bridge, matrix=bridge.matrix.multiply(weight[:, None]).tocsr())
    target = Target(
        frequencies=modes.frequencies,
        shapes=shapes,
        std=relative,
        used=~np.isin(np.arange(1, count + 1), list(leave_out)),
        weights=Weights(u.frequency_error, u.mac_error, u.shape_weight),
        pairing=gates,
    )
    if isinstance(one.model, MatrixModel):
        seen = one.model.reduced(
            bridge, min(2 * count, one.model.size), parameters=parameters
        )
    else:
        top = highest(modes.frequencies, gates)
        seen = reduced(one.model, parameters, bridge, len(opened.modes(top).modes))
    kilograms = 1.0
    if isinstance(one.model, Model):
        kilograms = UNIT_SYSTEMS[one.model.units].kilograms
    return Configuration(seen, target, modal_terms(u, modes.norm, kilograms), name)


def _at_end(
    model: Model | MatrixModel,
    every: ParameterSet,
    factors: Mapping[str, float],
    names: Sequence[str],
) -> Model | MatrixModel:
    mine = every.take(every.at(names)) if names else every
    values = np.array([factors[n] for n in mine.names])
    if isinstance(model, MatrixModel):
        return model.at(mine, values)
    return at_factors(model, mine, values)


def _table(
    problem: Problem, at: Evaluated, test: TestModes | ModeSet
) -> CorrelationTable:
    """The first configuration at a point, paired by the gates."""
    modes = modes_at(test)
    now = at.points[0].now
    target = problem.configurations[0].target
    seen = replace(
        modes,
        frequencies=now.frequencies,
        damping=np.zeros(now.frequencies.size),
        shapes=now.shapes,
        confidence=np.ones(now.frequencies.size),
    )
    measured = replace(modes, shapes=target.shapes)
    return correlation_table(measured, seen, pair_modes(measured, seen, target.pairing))


@dataclass(frozen=True, eq=False)
class TunedSuspension(Displayed):
    """A tuned suspension.

    Attributes
    ----------
    names : tuple of str
    factors : (p,) float64
        Tuned over initial value.
    std : (p,) float64
        Relative standard deviation.
    frequencies : (mode,) float64, Hz
        Rigid-body modes of the tuned model that are paired.
    model : Model
        With the factors applied.
    ambiguity : tuple of str
        Other pairings that the test leaves open.
    """

    UNITS: ClassVar[Mapping[str, str]] = {"frequencies": "Hz"}

    names: tuple[str, ...]
    factors: Float
    std: Float
    frequencies: Float
    model: Model
    ambiguity: tuple[str, ...]


def tune_suspension(
    model: Model,
    test: TestModes | ModeSet,
    parameters: ParameterSet | Sequence[Parameter],
    *,
    sensors: SensorSheet | str | Path | None = None,
    iterations: int = 30,
    progress: Progress = quiet,
) -> TunedSuspension:
    """Tune the stiffness of a suspension to the rigid-body modes of a test.

    Every pairing of the rigid-body modes that the test leaves open is weighed.

    Parameters
    ----------
    model : Model
        On its suspension.
    test : TestModes or ModeSet
        Rigid-body modes alone.
    parameters : ParameterSet or sequence of Parameter
        Of the suspension.
    sensors : SensorSheet or path, optional
    iterations : int
        Limit of the updating.

    Raises
    ------
    DataError
        If no test mode has a partner in the model.

    Examples
    --------
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> foot = [rt.parameter("foot", "PELAS 1 K")]
    >>> true = rt.solve_modes(rt.at_factors(model, rt.ParameterSet(foot), [0.7]), count=1)
    >>> rt.tune_suspension(model, true.at(["2+X", "3+X", "4+X"]), foot).factors.round(2)
    array([0.7])
    """
    every = (
        parameters
        if isinstance(parameters, ParameterSet)
        else ParameterSet(tuple(parameters))
    )
    modes = realise_modes(modes_at(test))
    std = np.full(len(modes), 1e-4)
    if isinstance(test, TestModes):
        std = np.fmax(test.std_frequency / modes.frequencies, 1e-4)
    bridge = placed(open_model(model), modes.channels, _place(sensors))
    gates = replace(CorrelateSection().gates(), mac_gate=0.5, close=0.08, distinct=0.95)
    target = Target(
        frequencies=modes.frequencies,
        shapes=np.asarray(modes.shapes.real, dtype=np.float64),
        std=std,
        used=np.ones(len(modes), dtype=bool),
        weights=RIGID_WEIGHTS,
        pairing=gates,
    )
    # 7: modes of a suspended structure: the six rigid-body modes and the first elastic one
    small = reduced(model, every, bridge, max(7, len(modes)))
    found = tuned(small, target, iterations, progress)
    x = found.best.x
    factors = every.factors(x)
    return TunedSuspension(
        names=every.names,
        factors=factors,
        std=found.std * every.derivative(x) / factors,
        frequencies=found.best.frequencies,
        model=at_factors(model, every, factors),
        ambiguity=found.ambiguity(),
    )


@dataclass(frozen=True, eq=False)
class FittedDamping(Displayed):
    """Damping of regions, fitted to damping ratios of test modes.

    Attributes
    ----------
    regions : tuple of str
    kinds : tuple of str
        `viscous` or `structural`, of each region.
    coefficients, std : (region,) float64
        Loss factor, or factor of the dashpots, of each region.
    frequencies : (pair,) float64, Hz
        Of the paired test modes.
    test_damping, model_damping, model_std : (pair,) float64
        Fractions of critical damping; the standard deviation of the model's.
    misfit : float
        Root mean square of the normalised residuals.
    """

    UNITS: ClassVar[Mapping[str, str]] = {"frequencies": "Hz"}

    regions: tuple[str, ...]
    kinds: tuple[str, ...]
    coefficients: Float
    std: Float
    frequencies: Float
    test_damping: Float
    model_damping: Float
    model_std: Float
    misfit: float


def fit_damping(
    model: Model,
    test: TestModes | ModeSet,
    *,
    regions: Sequence[DampingRegion] = (),
    sensors: SensorSheet | str | Path | None = None,
    error: float = 0.1,
    progress: Progress = quiet,
) -> FittedDamping:
    """Damping of the regions of a model, from the damping ratios of test modes.

    Parameters
    ----------
    model : Model
        Updated: its modes are paired with those of the test.
    test : TestModes or ModeSet
        With damping ratios.
    regions : sequence of DampingRegion
        One a material and one a group of springs if not given.
    sensors : SensorSheet or path, optional
    error : float
        Relative error of a ratio that the best model keeps, added to that of the test.

    Raises
    ------
    DataError
        If no test mode with a damping ratio has a partner, or no region takes part in one.

    References
    ----------
    Adhikari (2013), Structural Dynamic Analysis with Generalized Damping Models.

    Examples
    --------
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> fe = rt.solve_modes(model)
    >>> names = ["2+X", "3+X", "4+X"]
    >>> test = rt.modes_of_test(fe.frequencies, fe.at(names).shapes, names, damping=[0.01] * 3)
    >>> bool(abs(rt.fit_damping(model, test).model_damping - 0.01).max() < 1e-3)
    True
    """
    opened = open_model(model)
    modes = modes_at(test)
    bridge = placed(opened, modes.channels, _place(sensors))
    gates: PairingSettings = CorrelateSection().gates()
    fe = opened.modes(highest(modes.frequencies, gates), progress).modes
    seen = replace(fe, shapes=bridge(fe.shapes), labels=modes.channels)
    pairing = pair_modes(modes, seen, gates)
    good = modes.damping[pairing.a] > 0
    a = pairing.a[good]
    b = pairing.b[good]
    if not a.size:
        raise DataError("no test mode with a damping ratio has a partner in the model")
    every = np.ones(a.size, dtype=bool)
    measured = MeasuredDamping(
        fe=b,
        names=tuple(f"test mode {i + 1}" for i in a.tolist()),
        hertz=modes.frequencies[a],
        ratio=modes.damping[a],
        std=test.std_damping[a] if isinstance(test, TestModes) else np.zeros(a.size),
        used=every,
        elastic=every,
    )
    deck = DampedDeck.of("", opened, fe, measured)
    wanted = tuple(regions) or default_regions(model, ParameterSet(()), {})
    found = fit_regions([deck], wanted, error)
    if found is None:
        raise DataError("no region takes part in any mode")
    return FittedDamping(
        regions=found.fit.names,
        kinds=tuple(r.kind for r in found.dampers.regions),
        coefficients=found.fit.coefficients,
        std=found.fit.std,
        frequencies=measured.hertz,
        test_damping=measured.ratio,
        model_damping=found.after,
        model_std=found.after_std,
        misfit=found.fit.misfit,
    )
