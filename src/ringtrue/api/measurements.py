"""Tests: records, FRFs and modes from files, modal identification, files of modes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, ClassVar, cast, get_args

import numpy as np

from ringtrue.api.models import FeModes
from ringtrue.core.arrays import Any_, Float
from ringtrue.core.choice import Choice
from ringtrue.core.display import Displayed, plot
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note, sentence
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.decks.nastran.results.modes import is_solver_result, read_nastran_modes
from ringtrue.errors import ConfigError, DataError, InputError, did_you_mean
from ringtrue.identification.ambient.decay_band_fit import DecaySettings
from ringtrue.identification.ambient.free_decays import (
    DecayResult,
    free_decay_note,
    identify_decay,
)
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    AmbientSettings,
    identify_stretches,
)
from ringtrue.identification.ambient.record_bands import too_short
from ringtrue.identification.ambient.setups import (
    MergeMethod,
    SetupsResult,
    identify_setups,
)
from ringtrue.identification.common.diagram import (
    IdentificationDiagram,
    SpectrumAccount,
    identification_diagram,
)
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.identification.frf.local_fits import with_local_fits
from ringtrue.identification.frf.pipeline import (
    HammerModes,
    HammerResult,
    identify_hammer,
)
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.identification.methods import SecondOpinion, identify_ambient_by
from ringtrue.io import frfs as frf_files
from ringtrue.io import modes as mode_files
from ringtrue.io import records
from ringtrue.io.campaign_tables import WiredFile, read_setup_table
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.io.uff.points import write_mode_sets
from ringtrue.model.model import Model
from ringtrue.signal.channel_checks import explain_clipping, find_spikes, remove_overlap
from ringtrue.signal.frf_sets import SetupGain, join_frfs, of_one_kind, with_equal_gains
from ringtrue.signal.impacts import HammerSettings, ImpactReport
from ringtrue.signal.spectra import check_band
from ringtrue.study.hammer_records import (
    Forced,
    ForceRecordFormat,
    accepted_hits,
    forced_frfs,
    read_force_records,
    rejected_hits,
)
from ringtrue.study.run import load_study
from ringtrue.study.store import is_store

TRANSLATIONS_ONLY = (".uff", ".unv", ".55")
AMBIENT = "ssi"  # the method with a stabilisation diagram that is judged


@dataclass(frozen=True, eq=False)
class TestModes(Displayed):
    """Modes of a test with their uncertainty.

    Attributes
    ----------
    frequencies : (mode,) float64, Hz
    std_frequency : (mode,) float64, Hz
        Standard deviation; NaN where unknown.
    damping, std_damping : (mode,) float64
        Fraction of critical damping.
    confidence : (mode,) float64, 0..1
    reasons : tuple of str
        Evidence for and against each mode.
    notes : tuple of str
        What is to be known of the data.
    modes : ModeSet
        With the channels.
    uncertainty : Uncertainty
    diagrams : tuple of StableDiagram
        The stabilisation diagrams, one a band.
    result : object, optional
        What the method of identification returned.
    """

    __test__ = False  # not a test of pytest
    UNITS: ClassVar[Mapping[str, str]] = {
        "frequencies": "Hz",
        "std_frequency": "Hz",
        "damping": "-",
        "std_damping": "-",
        "confidence": "0..1",
    }

    modes: ModeSet
    uncertainty: Uncertainty
    reasons: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    diagrams: tuple[StableDiagram, ...] = ()
    result: (
        AmbientResult | SetupsResult | DecayResult | HammerResult | SecondOpinion | None
    ) = None
    frequencies: Float = field(init=False)
    std_frequency: Float = field(init=False)
    damping: Float = field(init=False)
    std_damping: Float = field(init=False)
    confidence: Float = field(init=False)

    def __post_init__(self) -> None:
        columns = {
            "frequencies": self.modes.frequencies,
            "std_frequency": self.uncertainty.frequency,
            "damping": self.modes.damping,
            "std_damping": self.uncertainty.damping,
            "confidence": self.modes.confidence,
        }
        for name, values in columns.items():
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.modes)

    @property
    def shapes(self) -> Any_:
        """Mode shapes (channel, mode)."""
        return self.modes.shapes

    @property
    def channels(self) -> tuple[str, ...]:
        """The rows of the shapes."""
        return self.modes.channels

    @property
    def others(self) -> OtherCandidates:
        """Doubtful modes and harmonics, which are not among the modes."""
        if isinstance(
            self.result, AmbientResult | SetupsResult | DecayResult | HammerResult
        ):
            return self.result.others
        return OtherCandidates.none(self.channels)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is particular of each mode, in six words; empty for one beyond doubt."""
        if isinstance(self.result, AmbientResult | SetupsResult):
            return self.result.remarks
        return ("",) * len(self)

    @property
    def diagram(self) -> IdentificationDiagram:
        """Poles, spectrum, and the modes of each class in one view of the whole band."""
        account = SpectrumAccount()
        if isinstance(self.result, AmbientResult):
            account = self.result.account
        natural = (self.modes, self.uncertainty, self.remarks)
        return identification_diagram(self.diagrams, natural, self.others, account)

    def plot(self, sensors: SensorSheet | None = None) -> Any:
        """The diagram of the whole band, else the shapes as lines.

        With `sensors`, which have the places: the mode shapes in motion, a 3D view.
        """
        if sensors is None:
            return plot(self.diagram if self.diagrams else self.modes)
        # plotly loads when something is drawn
        from ringtrue.plots.scene import test_modes

        return test_modes(sensors.model, self.modes)


def modes_of_test(
    frequencies: Float | Sequence[float],
    shapes: Any_,
    channels: Sequence[str],
    *,
    damping: Float | Sequence[float] | None = None,
    std_frequency: Float | Sequence[float] | None = None,
) -> TestModes:
    """Test modes from arrays.

    Parameters
    ----------
    frequencies : (mode,), Hz
    shapes : (channel, mode), real or complex, any scale
    channels : sequence of str
        Such as `101+Z`; `3` is row 3 of a `MatrixModel`, from 1.
    damping : (mode,), optional
        Fraction of critical damping.
    std_frequency : (mode,), Hz, optional
        Standard deviations of the frequencies.

    Examples
    --------
    >>> import ringtrue as rt
    >>> test = rt.modes_of_test([2.2, 6.3], [[0.6, 1.0], [1.0, -0.5]], ["3+X", "4+X"])
    >>> test.frequencies
    array([2.2, 6.3])
    """
    f = np.asarray(frequencies, dtype=np.float64)
    unknown = np.full(f.size, np.nan)
    zeta = unknown if damping is None else np.asarray(damping, dtype=np.float64)
    modes = ModeSet(f, zeta, np.asarray(shapes), tuple(map(str, channels)))
    std = (
        unknown
        if std_frequency is None
        else np.asarray(std_frequency, dtype=np.float64)
    )
    return TestModes(
        modes,
        Uncertainty.independent(std, unknown, np.full(modes.shapes.shape, np.nan)),
    )


def modes_at(modes: ModeSet | FeModes | TestModes) -> ModeSet:
    """The mode set of a result."""
    return modes if isinstance(modes, ModeSet) else modes.modes


def read_modes(path: str | Path, *, deck: Model | None = None) -> TestModes:
    """Read modes with their standard deviations.

    Parameters
    ----------
    path : str or Path
        JSON, HDF5, a universal file, a table of text or Excel; results of Nastran or MYSTRAN (OP2,
        F06, punch, HDF5); or the `study.h5` of a study: its modes merged over all records.
    deck : Model, optional
        The deck of a run of Nastran, to turn displacement frames to the basic frame.

    Raises
    ------
    DataError
        If the file is missing, unreadable or holds no modes.

    Examples
    --------
    >>> import tempfile
    >>> import ringtrue as rt
    >>> test = rt.modes_of_test([2.2], [[0.6], [1.0]], ["3+X", "4+X"], damping=[0.01])
    >>> path = tempfile.mkdtemp() + "/modes.json"
    >>> _ = rt.write_modes(path, test)
    >>> rt.read_modes(path).channels
    ('3+X', '4+X')
    """
    path = Path(path)
    if is_solver_result(path):
        modes = read_nastran_modes(path, deck)
        unknown = np.full(len(modes), np.nan)
        std = unknown, unknown
    elif deck is not None:
        raise InputError(f"deck: {path} is no results file of a solver")
    elif is_store(path):
        return merged_modes(path)
    else:
        modes = mode_files.read_modes(path)
        std = mode_files.read_std(path)
    of_shapes = np.full(modes.shapes.shape, np.nan)
    return TestModes(modes, Uncertainty.independent(*std, of_shapes))


def merged_modes(path: Path) -> TestModes:
    """The test modes that a study has identified: of its FRFs, or of its ambient records.

    Raises
    ------
    DataError
        If the study has not identified modes.
    """
    found = load_study(path).results.get("identify")
    if found is None:
        raise DataError(
            f"{path}: the study has no test modes; run it to its stage `identify`"
        )
    best = found.ambient if found.hammer is None else found.hammer
    notes = found.merge_notes if found.hammer is None else found.frf_notes
    return TestModes(
        best.modes, best.uncertainty, best.reasons, notes=notes, diagrams=best.diagrams
    )


def write_modes(
    path: str | Path,
    modes: ModeSet | FeModes | TestModes,
    *,
    sensors: SensorSheet | None = None,
) -> ModeSet:
    """Write modes as `.json`, `.h5`, `.uff` (translations of points only) or `.csv`.

    Parameters
    ----------
    path : str or Path
    modes : ModeSet, FeModes or TestModes
    sensors : SensorSheet, optional
        Its points and lines are written with the modes; of `.uff` only.

    Returns
    -------
    ModeSet
        What was written.

    Raises
    ------
    DataError
        If there is no such format.
    """
    path = Path(path)
    found = modes_at(modes)
    kept = found
    if path.suffix.lower() in TRANSLATIONS_ONLY:
        labels = (
            found.labels
            if isinstance(found.labels, DofSet)
            else DofSet.parse(found.labels)
        )
        translations = (np.abs(labels.direction) >= 1) & (np.abs(labels.direction) <= 3)
        kept = found.rows(
            [found.channels[i] for i in np.flatnonzero(translations).tolist()]
        )
    spread = None
    reasons: tuple[str, ...] = ()
    others: OtherCandidates | None = None
    if isinstance(modes, TestModes):
        reasons = modes.reasons
        others = modes.others
        known = np.isfinite(modes.uncertainty.frequency) | np.isfinite(
            modes.uncertainty.damping
        )
        spread = modes.uncertainty if known.any() else None
    if sensors is not None:
        if path.suffix.lower() not in TRANSLATIONS_ONLY:
            raise ConfigError(f"sensors: {path} takes no geometry; a .uff file does")
        write_mode_sets(path, kept, sensors.model)
    else:
        mode_files.write_modes(path, kept, spread, reasons, others)
    return kept


def read_sensors(path: str | Path) -> SensorSheet:
    """Read a sensor sheet: point, x, y, z (m), direction, unit, sensitivity of each channel.

    Parameters
    ----------
    path : str or Path
        Text or Excel, columns as in docs/formats.md; or a universal file with nodes, whose trace
        lines and elements become the lines between the points.

    Raises
    ------
    DataError
        If a row is wrong; the message has the file and the row.
    """
    return read_sensor_sheet(path)


def read_record(
    path: str | Path,
    *,
    rate: float | None = None,
    group: str = "",
    sensors: SensorSheet | None = None,
    leave_out: Sequence[str] = (),
) -> TimeHistory:
    """Read a time record: `.h5`, `.npy`, `.csv`, `.mat`, `.uff`, `.tdms`, `.lvm` or `.wav`.

    Parameters
    ----------
    path : str or Path
    rate : float, Hz, optional
        Sample rate, where the file has none.
    group : str
        Group of a `.tdms` or HDF5 file, where its rates differ.
    sensors : SensorSheet, optional
        Units and sensitivities where the record states none.
    leave_out : sequence of str
        Channels that are not used.

    Returns
    -------
    TimeHistory
        (channel, sample), SI; missing samples are NaN.

    Raises
    ------
    DataError
        If the file is unreadable, or a channel is constant or not finite.
    """
    return record_with_notes(Path(path), rate, group, sensors, leave_out)[0]


def record_with_notes(
    path: Path,
    rate: float | None,
    group: str,
    sensors: SensorSheet | None,
    leave_out: Sequence[str],
) -> tuple[TimeHistory, tuple[str, ...]]:
    """A record as `read_record` gives it, and the notes of its sheet."""
    history = records.read_record(
        path, rate, check=not leave_out, group=group, gaps=True
    )
    history, notes = sensors.scaled(history) if sensors else (history, ())
    if leave_out:
        history = history.pick(kept_channels(path, history.channels, leave_out))
        records.refuse_bad_samples(history, path, gaps=True)
    return history, notes


def kept_channels(
    path: Path, channels: Sequence[Channel], leave_out: Sequence[str]
) -> list[str]:
    """Ids of the channels but for those left out, each of which must be there."""
    ids = [c.id for c in channels]
    for name in leave_out:
        if name not in ids:
            raise ConfigError(
                f"leave out {name}: {path} has no such channel{did_you_mean(name, ids)}"
            )
    keep = [c for c in ids if c not in set(leave_out)]
    if not keep:
        raise DataError(f"{path}: all channels are left out")
    return keep


def read_frfs(
    path: str | Path,
    *,
    leave_out: Sequence[str] = (),
    window_decay: float | None = None,
) -> FrfSet:
    """Read measured FRFs: `.uff` (data set 58), `.h5`, `.npz`, `.csv` or `.mat`.

    Parameters
    ----------
    path : str or Path
    leave_out : sequence of str
        Channels that are not used.
    window_decay : float, 1/s, optional
        Decay rate of an exponential window in the FRFs; identification takes it out of the damping.

    Returns
    -------
    FrfSet
        (line, response, force) complex128, SI.

    Raises
    ------
    DataError
        If the file is unreadable or holds no FRFs.
    """
    return _windowed(frf_files.read_frfs(path, leave_out), window_decay)


def _windowed(frfs: FrfSet, decay: float | None) -> FrfSet:
    if decay is None:
        return frfs
    if not 0 <= decay < float("inf"):
        raise ConfigError(f"window_decay {decay}: must be 0 or more, 1/s")
    return replace(frfs, window_decay=decay)


@dataclass(frozen=True, eq=False)
class MeasuredFrfs(Displayed):
    """FRFs of a test with the impacts behind them.

    Attributes
    ----------
    frfs : FrfSet
    hits : tuple of ImpactReport
        The impacts; empty for a shaker or given FRFs.
    notes : tuple of str
    clipped : tuple of str
        Clipped channels.
    setups : tuple of FrfSet
        The parts of several sensor arrangements; empty for one.
    """

    frfs: FrfSet
    hits: tuple[ImpactReport, ...] = ()
    notes: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()
    setups: tuple[FrfSet, ...] = ()

    def plot(self) -> Any:
        """The FRFs of the first force, a plotly figure."""
        return plot(self.frfs)


def estimate_frfs(
    files: Sequence[str | Path] | str | Path,
    *,
    reading: ForceRecordFormat | None = None,
    settings: HammerSettings | None = None,
    line_spacing: float | None = None,
    window_decay: float | None = None,
    progress: Progress = quiet,
) -> MeasuredFrfs:
    """FRFs of the time records of a hammer or shaker test; files of FRFs are joined.

    Several files are one test: a roving hammer, moved sensors or more impacts. Double hits and
    overloads are left out.

    Parameters
    ----------
    files : path or sequence of paths
    reading : ForceRecordFormat, optional
        Force channel, excitation points, units: how the records are read.
    settings : HammerSettings, optional
        Blocks, windows and the estimator.
    line_spacing : float, Hz, optional
        Of a shaker; its records decide if not given.
    window_decay : float, 1/s, optional
        As in `read_frfs`.

    Raises
    ------
    DataError
        If a record has no force channel, or no impact is usable.
    ConfigError
        If time records and FRFs are mixed.

    References
    ----------
    Ewins (2000), Modal Testing, ch. 3; ISO 7626-5.
    """
    paths = [Path(files)] if isinstance(files, str | Path) else [Path(f) for f in files]
    how = reading or ForceRecordFormat()
    given = [frf_files.holds_frfs(f) for f in paths]
    if any(given) and not all(given):
        raise ConfigError(
            f"{paths[given.index(False)]} is a time record, {paths[given.index(True)]} holds FRFs: "
            "one of the two"
        )
    if all(given):
        return _given_frfs(paths, how, window_decay)
    histories, ranges, notes = read_force_records(paths, how)
    forced = forced_frfs(
        histories,
        settings or HammerSettings(force=""),
        line_spacing,
        full_scale=ranges,
        progress=part(progress, 0.0, 0.05),
    )
    columns, setups, gains = with_equal_gains(forced.columns)
    joined = join_frfs(columns)
    said = (
        _frf_notes(joined, forced) if forced.hits else (*forced.notes, *forced.clipped)
    )
    return MeasuredFrfs(
        _windowed(joined, window_decay),
        forced.hits,
        (*notes, *said, *_of_setups(gains, setups)),
        forced.clipped,
        tuple(_windowed(s, window_decay) for s in setups),
    )


def _of_setups(gains: Sequence[SetupGain], setups: Sequence[FrfSet]) -> list[str]:
    return [sentence(g.note(setups[g.setup].source or str(g.setup + 1))) for g in gains]


def _given_frfs(
    paths: Sequence[Path], how: ForceRecordFormat, decay: float | None
) -> MeasuredFrfs:
    if how.channels:
        raise ConfigError(
            f"channels: they name the channels of time records; {paths[0]} holds FRFs, which have "
            "names"
        )
    if how.leave_out:
        known = dict.fromkeys(c for f in paths for c in frf_files.frf_ids(f))
        kept_channels(
            paths[0], [Channel(c, "unknown", "") for c in known], how.leave_out
        )
    found = of_one_kind(
        [read_frfs(f, leave_out=how.leave_out, window_decay=decay) for f in paths]
    )
    if len(found) == 1:
        return MeasuredFrfs(found[0])
    columns, setups, gains = with_equal_gains(found)
    notes = tuple(_of_setups(gains, setups))
    return MeasuredFrfs(join_frfs(columns), notes=notes, setups=tuple(columns))


def _frf_notes(frfs: FrfSet, forced: Forced) -> tuple[str, ...]:
    """Impacts kept and left out, windows, coherence, driving points."""
    known = frfs.coherence[np.isfinite(frfs.coherence)]
    notes = [accepted_hits(forced.hits), *rejected_hits(forced.hits), *forced.notes]
    if frfs.window_decay > 0:
        notes.append(
            f"exponential window of {frfs.window_decay:.3g} 1/s, taken out of the damping"
        )
    if known.size:
        notes.append(f"coherence {np.median(known):.3f} at the typical line")
    else:
        notes.append("one impact a point: no coherence")
    if not driving_pairs(frfs):
        ids = " ".join(dict.fromkeys(c.id for c in frfs.inputs))
        notes.append(
            f"excited at {ids}, where no response is: shapes are not scaled to unit modal mass"
        )
    return tuple(notes)


def identify_frfs(
    frfs: FrfSet | MeasuredFrfs,
    *,
    fmin: float | None = None,
    fmax: float | None = None,
    choice: Choice | None = None,
    progress: Progress = quiet,
) -> TestModes:
    """Modes from FRFs: poly-reference LSCF, residues and standard deviations.

    Parameters
    ----------
    frfs : FrfSet or MeasuredFrfs
    fmin, fmax : float, Hz, optional
        The band of interest; that of the data if not given.
    choice : Choice, optional
        Modes chosen by hand.

    Raises
    ------
    ConfigError
        If the band is empty.

    References
    ----------
    Peeters, Van der Auweraer, Guillaume and Leuridan (2004), The PolyMAX frequency-domain method.

    Examples
    --------
    >>> import numpy as np
    >>> import ringtrue as rt
    >>> lines = np.arange(0.5, 15, 0.02)
    >>> h = rt.frf(rt.example_deck(), lines, forces=["4+X"], responses=["2+X", "4+X"], damping=0.01)
    >>> rt.identify_frfs(h).frequencies.round(2)
    array([2.24, 6.28, 9.07])
    """
    check_band(fmin, fmax)
    measured = frfs if isinstance(frfs, MeasuredFrfs) else MeasuredFrfs(frfs)
    data = measured.frfs
    setups = measured.setups or (measured.frfs,)
    band = HammerModes(fmin=fmin, fmax=fmax)
    with explain_clipping(measured.clipped):
        found = identify_hammer(data, band, choice=choice, progress=progress)
    if choice is None:
        found = with_local_fits(found, setups, band, progress=progress)
    return _of_result(found, (*measured.notes, *map(sentence, found.channel_notes)))


def _of_result(
    found: AmbientResult | HammerResult | SecondOpinion, notes: tuple[str, ...] = ()
) -> TestModes:
    """What a method of identification returned, with further notes."""
    return TestModes(
        modes=found.modes,
        uncertainty=found.uncertainty,
        reasons=found.reasons,
        notes=(*notes, *found.notes),
        diagrams=() if isinstance(found, SecondOpinion) else found.diagrams,
        result=found,
    )


def refuse_choice(method: str, first: str, choice: Choice | None) -> None:
    """Refuse a choice by hand for a method without a judged stabilisation diagram."""
    if choice is not None:
        raise ConfigError(
            f"a choice goes with the method {first}, got {method}; the others have no diagram of "
            "judged poles"
        )


def identify_ambient(
    record: TimeHistory | Iterable[TimeHistory],
    *,
    fmin: float | None = None,
    fmax: float | None = None,
    method: str = AMBIENT,
    near: Sequence[float] = (),
    decay: bool | None = None,
    choice: Choice | None = None,
    progress: Progress = quiet,
) -> TestModes:
    """Modes from an ambient record: automatic covariance-driven SSI with standard deviations.

    Parameters
    ----------
    record : TimeHistory or several of one setup
        Several are one record with pauses.
    fmin, fmax : float, Hz, optional
        The band of interest.
    method : str
        `ssi`, or another method of docs/theory/oma_methods.md for a second opinion on one record.
    near : sequence of float, Hz
        Peaks that an FDD method starts from.
    decay : bool, optional
        Whether the record holds free decays (step relaxation, ring-down, impacts without measured
        force); not given, the record decides. `result` then has the backbones and the multiples.
    choice : Choice, optional
        Modes chosen by hand.

    Returns
    -------
    TestModes
        Shapes are not scaled: the excitation was not measured.

    Raises
    ------
    ConfigError
        If the band is empty, or an option does not fit the method.
    DataError
        If the record is too short or has no usable channel.

    References
    ----------
    Peeters and De Roeck (1999), Reference-based stochastic subspace identification; standard
    deviations: Döhler and Mevel (2013).

    Examples
    --------
    >>> import numpy as np
    >>> import ringtrue as rt
    >>> rng = np.random.default_rng(0)
    >>> x = np.zeros((2, 20000))
    >>> for k in range(2, 20000):  # a mode of 1.6 Hz at 1 %, sampled at 20 Hz
    ...     x[:, k] = 1.7434 * x[:, k - 1] - 0.9900 * x[:, k - 2] + rng.standard_normal()
    >>> x = x * [[1.0], [-0.5]] + 0.1 * rng.standard_normal(x.shape)
    >>> names = [rt.Channel(name, "acceleration", "m/s^2") for name in ("1+Z", "2+Z")]
    >>> test = rt.identify_ambient(rt.TimeHistory(x, 20.0, tuple(names)))
    >>> bool(abs(test.frequencies[0] - 1.6) < 0.02)
    True
    """
    check_band(fmin, fmax)
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    parts = [record] if isinstance(record, TimeHistory) else record
    if decay and (method != AMBIENT or choice is not None):
        raise ConfigError(
            f"decay goes with the method {AMBIENT} and without a choice by hand"
        )
    if decay is not False and method == AMBIENT and choice is None:
        coming = iter(parts)
        first = list(islice(coming, 2))
        found_decay = _of_decays(
            first, decay, DecaySettings(fmin=fmin, fmax=fmax), progress
        )
        if found_decay is not None:
            return found_decay
        parts = chain(first, coming)
    if method != AMBIENT:
        refuse_choice(method, AMBIENT, choice)
        one = next(iter(parts))
        return _of_result(
            identify_ambient_by(method, one, settings, near=near, progress=progress)
        )
    return _of_result(
        identify_stretches(iter(parts), settings, choice=choice, progress=progress)
    )


def identify_ambient_setups(
    setups: str | Path | Iterable[TimeHistory],
    *,
    references: Sequence[str] = (),
    rate: float | None = None,
    fmin: float | None = None,
    fmax: float | None = None,
    merge: MergeMethod = "poser",
    choice: Choice | None = None,
) -> TestModes:
    """Modes from ambient records of several setups: some sensors stay, the others move.

    Poles are those of all setups together; each shape is read from every record and scaled by the
    references, so that none has holes. `result` has the frequency and damping of each setup.

    Parameters
    ----------
    setups : path or iterable of TimeHistory
        A wiring table (`file, channel, point, direction, reference`), or a record a setup, in which
        channels of one id measure the same.
    references : sequence of str
        Channels that scale the setups to one another; without, those of the table, or all that
        they have in common.
    rate : float, Hz, optional
        Sample rate, where the files of a table have none.
    fmin, fmax : float, Hz, optional
        The band of interest.
    merge : {"poser", "preger"}
        Poles of each setup, merged; or of the references of all setups as one record.
    choice : Choice, optional
        Modes chosen by hand, by their frequencies in all setups.

    Raises
    ------
    ConfigError
        If the band is empty or there is no such way to merge.
    DataError
        If there are fewer than two setups, one shares no channel with the others, or a file or the
        table is wrong.

    References
    ----------
    Döhler, Andersen and Mevel (2010), Data merging for multi-setup operational modal analysis.

    Examples
    --------
    >>> import numpy as np
    >>> import ringtrue as rt
    >>> rng = np.random.default_rng(0)
    >>> setups = []
    >>> for moved, level in (("2+Z", -0.5), ("3+Z", 0.8)):
    ...     x = np.zeros((1, 20000))
    ...     for k in range(2, 20000):  # a mode of 1.6 Hz at 1 %, sampled at 20 Hz
    ...         x[:, k] = 1.7434 * x[:, k - 1] - 0.9900 * x[:, k - 2] + rng.standard_normal()
    ...     x = x * [[1.0], [level]] + 0.1 * rng.standard_normal((2, 20000))
    ...     names = [rt.Channel(name, "acceleration", "m/s^2") for name in ("1+Z", moved)]
    ...     setups.append(rt.TimeHistory(x, 20.0, tuple(names), moved))
    >>> test = rt.identify_ambient_setups(setups)
    >>> test.channels
    ('1+Z', '2+Z', '3+Z')
    >>> test.shapes[:, 0].real.round(1)
    array([ 1. , -0.5,  0.8])
    """
    check_band(fmin, fmax)
    merge = merge_method(merge)
    settings = AmbientSettings(fmin=fmin, fmax=fmax)
    histories: Iterable[TimeHistory]
    if isinstance(setups, str | Path):
        files = read_setup_table(setups)
        references = tuple(references) or references_of(files)
        histories = (file.wired(read_record(file.path, rate=rate)) for file in files)
    else:
        histories = setups
    return modes_of_setups(histories, settings, references, merge, choice=choice)


def modes_of_setups(
    histories: Iterable[TimeHistory],
    settings: AmbientSettings,
    references: Sequence[str],
    merge: MergeMethod,
    *,
    choice: Choice | None = None,
    progress: Progress = quiet,
) -> TestModes:
    """Modes of records of several setups, as `identify_ambient_setups` returns them."""
    found = identify_setups(
        histories,
        settings,
        references=references,
        merge=merge,
        choice=choice,
        progress=progress,
    )
    return TestModes(
        modes=found.modes,
        uncertainty=found.uncertainty,
        reasons=found.reasons,
        notes=found.notes,
        diagrams=found.diagrams,
        result=found,
    )


def merge_method(name: str) -> MergeMethod:
    """The way to merge setups of this name."""
    known = get_args(MergeMethod)
    if name not in known:
        raise ConfigError(f"merge {name!r}{did_you_mean(name, known)}")
    return cast("MergeMethod", name)


def references_of(files: Sequence[WiredFile]) -> tuple[str, ...]:
    """The channels that a wiring table marks as references."""
    return tuple(dict.fromkeys(name for file in files for name in file.references))


def _of_decays(
    parts: Sequence[TimeHistory],
    asked: bool | None,
    settings: DecaySettings,
    progress: Progress,
) -> TestModes | None:
    """Modes of the free decays of one record; None where it holds none and none were asked for."""
    if len(parts) != 1:
        if asked:
            raise ConfigError(f"decay: one record, got {len(parts)} or more")
        return None
    notes: tuple[Note, ...] = ()
    if asked is None:
        seen = free_decay_note(parts[0], settings)
        if seen is None:
            return None
        notes = (seen,)
    found = identify_decay(parts[0], settings, progress=progress)
    return TestModes(
        modes=found.modes,
        uncertainty=found.uncertainty,
        reasons=found.reasons,
        notes=tuple(map(sentence, (*notes, *found.notes))),
        diagrams=found.diagrams,
        result=found,
    )


def ambient_parts(
    paths: Sequence[Path], histories: Iterable[TimeHistory], notes: list[str]
) -> Iterator[TimeHistory]:
    """Records that follow each other, without overlap.

    What is to be said of each record is added to `notes` when it is read.
    """
    first = 0.0
    before: TimeHistory | None = None
    for path, whole in zip(paths, histories, strict=True):
        kept, overlap = remove_overlap(before, whole)
        before = whole
        if overlap:
            notes.append(f"{path.name}: {overlap}")
        if not kept.data.size:
            continue
        first = first or kept.duration
        where = "" if len(paths) == 1 else f"{path.name}: "
        notes += [where + sentence(note) for note in find_spikes(kept)]
        if too_short(kept.duration, first):
            notes.append(f"{where}shorter than half of the first record: left out")
        yield kept
