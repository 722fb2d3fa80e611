"""The virtual campaign: raw records of three tests, a sensor sheet and the crew's log, and nothing
of the truth.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol
from zlib import crc32

import numpy as np
from scipy import fft

from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModalModel
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.io.records import write_record
from ringtrue.signal.band_correlations import map_in_threads
from ringtrue.virtual.excitation import (
    Ambient,
    Pulses,
    ambient_forces,
    dropped_weight,
    event_times,
    jumping,
    sledge,
)
from ringtrue.virtual.joints import SofteningJoints
from ringtrue.virtual.measurements import (
    AmbientTest,
    Background,
    HammerPlan,
    ambient_record,
    clean_energy,
    hammer_record,
    record_channels,
    scale_site,
    scaled_to_snr,
    strike,
    write_lines,
    write_log,
    write_sheet,
)
from ringtrue.virtual.sensors import (
    ACCELEROMETER,
    FORCE_CELL,
    GEOPHONE,
    ICP,
    Chain,
    at_outputs,
    in_band,
    ratio_db,
    resonance_power,
)

DATE = "2024-05-13"
EXCITATIONS = ("ambient", "jumping", "drop", "sledge")
AGAIN = "foundation-again"


class TwinView(Protocol):
    """What the campaign may know of the structure."""

    @property
    # outputs: channels of `test`; inputs: force points and `ground…` columns
    def modal(self) -> ModalModel: ...
    @property
    def test(self) -> TestModel: ...
    @property
    def drop_points(self) -> tuple[str, ...]: ...
    @property
    def jump_points(self) -> tuple[str, ...]: ...
    @property
    def sledge_points(self) -> tuple[str, ...]: ...
    @property
    def machine_points(self) -> tuple[str, ...]: ...
    @property
    def joints(self) -> SofteningJoints | None: ...


@dataclass(frozen=True, slots=True)
class Day:
    """When a test is made.

    Attributes
    ----------
    date : str
    temperature : float, optional
        Of the air and of the structure, °C; None: not noted down.
    """

    date: str = DATE
    temperature: float | None = None


@dataclass(frozen=True, slots=True)
class ChannelFaults:
    """What is wrong with channels, and written down nowhere.

    Attributes
    ----------
    reversed : str
        A channel that reads with the opposite sign in all tests.
    swapped : tuple of str
        Two channels, each of which reads the motion of the other in all tests.
    scaled : str
        A channel that reads `gain` times what it should in one `setup` of the hammer test, counted
        from 0.
    """

    reversed: str = ""
    swapped: tuple[str, ...] = ()
    scaled: str = ""
    setup: int = -1
    gain: float = 1.0

    def reads(self, channel: str) -> str:
        """The channel whose motion one reads."""
        if channel in self.swapped:
            return self.swapped[1 - self.swapped.index(channel)]
        return channel

    def factor(self, channel: str, setup: int) -> float:
        """What a channel reads of that motion; `setup` is -1 in the ambient tests."""
        sign = -1.0 if channel == self.reversed else 1.0
        here = channel == self.scaled and setup == self.setup
        return sign * (self.gain if here else 1.0)


@dataclass(frozen=True, slots=True)
class Circumstances:
    """The structure on the days of the tests, and what goes wrong.

    Attributes
    ----------
    twins : mapping of str to TwinView
        The structure by date.
    days : mapping of str to Day
        When tests are made, by name; all on one day where none is named.
    repeated : tuple of str
        Kinds of excitation that test (a) is repeated with, as the test `foundation-again`.
    faults : ChannelFaults
    """

    twins: Mapping[str, TwinView]
    days: Mapping[str, Day] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()
    faults: ChannelFaults = ChannelFaults()

    def day(self, name: str) -> Day:
        """When a test is made."""
        return self.days.get(name, Day())

    def at(self, name: str) -> TwinView:
        """The structure on the day of a test."""
        return self.twins[self.day(name).date]

    def ambient_tests(self) -> dict[str, tuple[str, ...]]:
        """Names of the ambient tests, with the kinds of excitation of their records."""
        again = {AGAIN: self.repeated} if self.repeated else {}
        return {"foundation": EXCITATIONS, "frame": EXCITATIONS} | again

    def seen(self, name: str, channels: Sequence[str], setup: int = -1) -> ModalModel:
        """The structure as channels read it, faults and all; `setup` is that of a hammer test."""
        faults = self.faults
        model = at_outputs(self.at(name).modal, [faults.reads(c) for c in channels])
        factor = np.array([[faults.factor(c, setup)] for c in channels])
        return replace(
            model,
            shapes=model.shapes * factor,
            lower=model.lower * factor,
            upper=model.upper * factor,
            outputs=tuple(
                replace(read, id=c)
                for read, c in zip(model.outputs, channels, strict=True)
            ),
        )


log = logging.getLogger(__name__)
# m/s rms, bounds of the site's ground motion
QUIET = 0.3e-6
LOUD = 3e-6
# Hz, between them the modes that the ratio is taken over
FMAX = 95.0
GEOPHONE_FMIN = 2.5


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """Where and how long the crew measures.

    Attributes
    ----------
    foundation, frame : tuple of str
        Channels of test (a), and of test (b), foundation and frame.
    setups : tuple of tuple of str
        Response channels of each setup of the hammer test (c).
    references : tuple of str
        Excitation points of (c), inputs of the modal model.
    rate_a, rate_b, rate_c : float, Hz
    duration_a, duration_b : float, s
        Of each record.
    spacing : tuple of float, s
        Pauses between events, used in turn.
    hammer : HammerPlan
    snr_db : float
        Median ratio at resonance that the day for the ambient tests is chosen for, as far as a
        ground motion of 0.3 to 3 µm/s allows.
    """

    foundation: tuple[str, ...]
    frame: tuple[str, ...]
    setups: tuple[tuple[str, ...], ...]
    references: tuple[str, ...]
    rate_a: float = 128.0
    rate_b: float = 256.0
    rate_c: float = 512.0
    duration_a: float = 1800.0
    duration_b: float = 1200.0
    spacing: tuple[float, ...] = (32.0, 45.0, 60.0, 38.0)
    hammer: HammerPlan = field(default_factory=HammerPlan)
    snr_db: float = 20.0

    def __post_init__(self) -> None:
        if (
            not self.foundation
            or not self.frame
            or not self.setups
            or not self.references
        ):
            raise InputError(
                "campaign plan: foundation, frame, setups and references must each name something"
            )
        if not self.spacing or min(self.spacing) < 20 or max(self.spacing) > 80:
            raise InputError(
                f"campaign plan: spacing {self.spacing} s, 20 to 80 s are allowed"
            )

    def shortened(self) -> CampaignPlan:
        """The same places with short records."""
        return replace(
            self,
            duration_a=min(600.0, self.duration_a),
            duration_b=min(600.0, self.duration_b),
            hammer=replace(self.hammer, hits=min(3, self.hammer.hits)),
        )


@dataclass(frozen=True, slots=True)
class CampaignSummary:
    """What was written, and what only the maker of the signals knows.

    Attributes
    ----------
    records : tuple of Path
    sheet, log : Path
    snr_db : dict
        By test: median over channels and modes of the signal's over the noise's spectral density in
        the half-power bands; for (a) and (b) of the record without events, for the hammer test of
        single blocks.
    snr_record_db : dict
        The same by record.
    ground_rms : dict
        By ambient test, m/s.
    """

    records: tuple[Path, ...]
    sheet: Path
    log: Path
    snr_db: dict[str, float]
    snr_record_db: dict[str, float]
    ground_rms: dict[str, float]


def run_campaign(
    twin: TwinView | Circumstances,
    plan: CampaignPlan,
    out_dir: str | Path,
    seed: int,
    *,
    fast: bool = False,
    progress: Progress = quiet,
) -> CampaignSummary:
    """Measure the twin and write `*.h5`, `sensors*.csv`, `lines.csv` and `campaign.json` to a
    folder.

    Parameters
    ----------
    twin : TwinView or Circumstances
        The structure, measured on one day without faults, or more than that.
    plan : CampaignPlan
    out_dir : path
    seed : int
        The same seed gives the same samples; each record draws from a stream of its own.
    fast : bool
        Short records.
    progress : callable (fraction, text)
    """
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    here = twin if isinstance(twin, Circumstances) else Circumstances({DATE: twin})
    crew = _Crew(here, plan.shortened() if fast else plan, folder, seed)
    kinds = here.ambient_tests()
    tests = {name: crew.prepare(name) for name in kinds}
    made = {
        f"{name}-{kind}": partial(crew.ambient_record, tests[name], name, kind)
        for name in tests
        for kind in kinds[name]
    }
    ambient = list(made)
    made |= {
        hammer_name(setup, reference): partial(crew.hammer_record, setup, reference)
        for setup in range(len(plan.setups))
        for reference in plan.references
    }
    by_record: dict[str, float] = {}
    ratios = map_in_threads(lambda make: make(), made.values())
    for name, ratio in zip(made, ratios, strict=True):
        by_record[name] = ratio
        progress(len(by_record) / len(made), f"record {name}")
    hammer = [ratio for name, ratio in by_record.items() if name not in ambient]
    by_test = {name: by_record[f"{name}-ambient"] for name in tests}
    by_test["hammer"] = float(np.median(hammer))
    _paperwork(here, crew.plan, folder)
    log.info(
        "signal-to-noise ratio at resonance, dB: %s",
        {k: round(v, 1) for k, v in by_test.items()},
    )
    progress(1.0, "campaign written")
    return CampaignSummary(
        records=tuple(folder / f"{name}.h5" for name in by_record),
        sheet=folder / "sensors.csv",
        log=folder / "campaign.json",
        snr_db=by_test,
        snr_record_db=by_record,
        ground_rms={name: t.site.ground_rms for name, t in tests.items()},
    )


@dataclass(frozen=True, slots=True)
class _Crew:
    """Who measures: the structure, the plan, the folder for the records, and the seed."""

    here: Circumstances
    plan: CampaignPlan
    folder: Path
    seed: int

    def rng(self, name: str) -> np.random.Generator:
        """A stream of the seed and the name alone, so that records do not shift each other."""
        key = (crc32(name.encode()),)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def prepare(self, name: str) -> AmbientTest:
        """Put the sensors up and pick the day."""
        channels = self.plan.foundation
        sensor = ACCELEROMETER
        rate = self.plan.rate_a
        fmin = 0.0
        if name == "frame":
            channels = self.plan.frame
            sensor = GEOPHONE
            rate = self.plan.rate_b
            fmin = GEOPHONE_FMIN
        model = self.here.seen(name, channels)
        twin = self.here.at(name)
        test = AmbientTest(
            model=model,
            chain=Chain.draw((sensor,) * len(channels), self.rng(f"{name} sensors")),
            site=Ambient(
                points=self.pushed(), machine=next(iter(twin.machine_points), None)
            ),
            rate=rate,
            poles=in_band(model.poles, fmin, min(FMAX, 0.4 * rate)),
            joints=twin.joints,
        )
        return scaled_to_snr(test, self.plan.snr_db, (QUIET, LOUD))

    def pushed(self) -> tuple[str, ...]:
        """Where air and machines push: up to 16 of the force points, evenly chosen."""
        twin = self.here.at("hammer")
        points = [*twin.machine_points, *twin.drop_points, *twin.sledge_points]
        points = list(dict.fromkeys([*points, *self.plan.references]))
        chosen = np.unique(np.linspace(0, len(points) - 1, 16).round().astype(int))
        return tuple(points[i] for i in chosen)

    def ambient_record(self, test: AmbientTest, name: str, kind: str) -> float:
        """Write one record; returns its ratio at resonance, dB."""
        rng = self.rng(f"{name}-{kind}")
        plan = self.plan
        samples = _even(
            plan.duration_b if name == "frame" else plan.duration_a, test.rate
        )
        events = _events(
            kind, self.here.at(name), plan.spacing, samples / test.rate, rng
        )
        volts, snr = ambient_record(test, events, samples, rng)
        ids = [c.id for c in test.model.outputs]
        date = self.here.day(name).date
        table = record_channels(self.here.at(name).test, ids, test.chain.sensors, date)
        path = self.folder / f"{name}-{kind}.h5"
        write_record(path, volts, test.rate, table, source=f"{name}, {kind}, {date}")
        return snr

    def hammer_record(self, setup: int, reference: str) -> float:
        """Write the record of a setup with impacts at a reference; returns its ratio, dB."""
        name = hammer_name(setup, reference)
        hammer = self.plan.hammer
        rate = self.plan.rate_c
        channels = self.plan.setups[setup]
        rng = self.rng(name)
        model = self.here.seen("hammer", channels, setup)
        inputs = [c.id for c in model.inputs]
        sensors = (FORCE_CELL, *(ICP,) * len(channels))
        chain = Chain.draw(sensors, self.rng(f"hammer setup {setup}"))
        limit = FORCE_CELL.range / FORCE_CELL.sensitivity
        blows = strike(hammer, inputs.index(reference), limit, rate, rng)
        samples = _even(float(blows.times[-1]) + hammer.block + hammer.rest, rate)
        quiet = scale_site(Ambient(points=self.pushed()), QUIET)
        forces = ambient_forces(inputs, quiet, samples, rate, rng)
        background = Background(forces, self.here.at("hammer").joints)
        volts, signal, noise = hammer_record(
            model, blows, chain, background=background, samples=samples, rng=rng
        )
        date = self.here.day("hammer").date
        table = record_channels(
            self.here.at("hammer").test, [reference, *channels], chain.sensors, date
        )
        table[0] = replace(table[0], id=f"F:{reference}")
        source = f"hammer at {reference}, {date}"
        write_record(self.folder / f"{name}.h5", volts, rate, table, source=source)
        poles = in_band(model.poles, GEOPHONE_FMIN, FMAX)
        in_one_block = samples / (hammer.block * rate) * clean_energy(blows)
        power = resonance_power(signal, poles, samples, rate) * in_one_block
        return float(
            np.median(ratio_db(power, resonance_power(noise, poles, samples, rate)))
        )


def _events(
    kind: str,
    twin: TwinView,
    spacing: tuple[float, ...],
    duration: float,
    rng: np.random.Generator,
) -> list[Pulses]:
    """The events of one record; positions in the inputs of the modal model."""
    if kind == "ambient":
        return []
    here = {c.id: i for i, c in enumerate(twin.modal.inputs)}
    times = event_times(spacing, duration, rng)
    if kind == "jumping":
        return [jumping(times, [here[p] for p in twin.jump_points], rng)]
    points = twin.drop_points if kind == "drop" else twin.sledge_points
    at = np.resize([here[p] for p in points], times.size)
    return [
        dropped_weight(times, at, rng) if kind == "drop" else sledge(times, at, rng)
    ]


def _even(duration: float, rate: float) -> int:
    """An even number of samples with small prime factors, at most one percent over the duration."""
    return 2 * int(fft.next_fast_len(int(np.ceil(duration * rate / 2)), real=True))


def hammer_name(setup: int, reference: str) -> str:
    """File stem of a setup (from 0) with impacts at a reference: `hammer-1-101pZ`."""
    return f"hammer-{setup + 1}-{reference.replace('+', 'p').replace('-', 'm')}"


def _paperwork(here: Circumstances, plan: CampaignPlan, folder: Path) -> None:
    """Sheets, lines and log."""
    test = here.at("hammer").test
    hammer = list(dict.fromkeys(c for s in plan.setups for c in s))
    every = list(
        dict.fromkeys([*plan.foundation, *plan.frame, *plan.references, *hammer])
    )
    write_sheet(folder / "sensors.csv", test, every)
    for name, channels, sensor in (
        ("foundation", plan.foundation, ACCELEROMETER),
        ("frame", plan.frame, GEOPHONE),
        ("hammer", hammer, ICP),
    ):
        write_sheet(
            folder / f"sensors-{name}.csv", test, channels, [sensor] * len(channels)
        )
    write_lines(folder / "lines.csv", test)
    ambient = [
        _ambient_log(name, kinds, plan, here.day(name))
        for name, kinds in here.ambient_tests().items()
    ]
    write_log(
        folder / "campaign.json",
        [*ambient, _hammer_log(plan, here.day("hammer"))],
        [ACCELEROMETER, GEOPHONE, ICP, FORCE_CELL],
    )


def _dated(name: str, kind: str, day: Day) -> dict[str, object]:
    """What the log says of a test and of its day."""
    out: dict[str, object] = {"name": name, "kind": kind, "date": day.date}
    if day.temperature is not None:
        out["temperature_c"] = day.temperature
    return out


def _ambient_log(
    name: str, kinds: Sequence[str], plan: CampaignPlan, day: Day
) -> dict[str, object]:
    records = [{"file": f"{name}-{kind}.h5", "excitation": kind} for kind in kinds]
    head = {
        **_dated(name, "ambient", day),
        "rate_hz": plan.rate_b if name == "frame" else plan.rate_a,
        "sheet": "sensors-frame.csv" if name == "frame" else "sensors-foundation.csv",
    }
    return {**head, "event_spacing_s": list(plan.spacing), "records": records}


def _hammer_log(plan: CampaignPlan, day: Day) -> dict[str, object]:
    records = [
        {
            "file": f"{hammer_name(i, r)}.h5",
            "excitation": "hammer",
            "setup": i + 1,
            "reference": r,
            "force_channel": f"F:{r}",
        }
        for i in range(len(plan.setups))
        for r in plan.references
    ]
    head = {**_dated("hammer", "hammer", day), "rate_hz": plan.rate_c}
    blocks = {
        "block_samples": round(plan.hammer.block * plan.rate_c),
        "pretrigger_samples": round(plan.hammer.pretrigger * plan.rate_c),
        "hits": plan.hammer.hits,
    }
    return {**head, "sheet": "sensors-hammer.csv", **blocks, "records": records}
