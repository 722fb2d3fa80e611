"""The virtual campaign: raw records of three tests, a sensor sheet and the crew's log, and nothing
of the truth.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol
from zlib import crc32

import numpy as np
from scipy import fft

from ringtrue.core.arrays import Any_
from ringtrue.core.modal import ModalModel
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.io.records import write_record
from ringtrue.virtual.excitation import (
    Ambient,
    Pulses,
    ambient_forces,
    dropped_weight,
    event_times,
    jumping,
    sledge,
)
from ringtrue.virtual.logbook import record_channels, write_lines, write_log, write_sheet
from ringtrue.virtual.measurements import (
    AmbientTest,
    HammerPlan,
    ambient_blocks,
    ambient_record,
    clean_energy,
    expected_snr,
    hammer_record,
    scale_site,
    scaled_to_snr,
    strike,
)
from ringtrue.virtual.response import at_outputs
from ringtrue.virtual.sensors import (
    ACCELEROMETER,
    FORCE_CELL,
    GEOPHONE,
    ICP,
    Chain,
    in_band,
    ratio_db,
    resonance_power,
)

log = logging.getLogger(__name__)
Progress = Callable[[float, str], None]

EXCITATIONS = ("ambient", "jumping", "drop", "sledge")
QUIET, LOUD = 0.3e-6, 3e-6  # m/s rms, bounds of the site's ground motion
FULL_HOURS, SEGMENT_S, FADE_S = 11.4, 1800.0, 60.0
FAST_S, FAST_HITS = 600.0, 3
FMAX, GEOPHONE_FMIN = 95.0, 2.5  # Hz, between them the modes that the ratio is taken over


class TwinView(Protocol):
    """What the campaign may know of the structure."""

    @property
    def modal(
        self,
    ) -> ModalModel: ...  # outputs: channels of `test`; inputs: force points and `ground…` columns
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
        Points struck in (c), inputs of the modal model.
    rate_a, rate_b, rate_c : float, Hz
    duration_a, duration_b : float, s
        Of each record.
    spacing : tuple of float, s
        Pauses between events, used in turn.
    hammer : HammerPlan
    snr_db : float
        Median ratio at resonance that the day for the ambient tests is chosen for, as far as a
        ground motion of 0.3 to 3 µm/s allows.
    date : str
        ISO.
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
    date: str = "2024-05-13"

    def __post_init__(self) -> None:
        if not self.foundation or not self.frame or not self.setups or not self.references:
            raise InputError(
                "campaign plan: foundation, frame, setups and references must each name something"
            )
        if not self.spacing or min(self.spacing) < 20 or max(self.spacing) > 80:
            raise InputError(
                f"campaign plan: spacing {self.spacing} s, events must be 20 to 80 s apart"
            )

    def shortened(self) -> CampaignPlan:
        """The same places with short records."""
        return replace(
            self,
            duration_a=min(FAST_S, self.duration_a),
            duration_b=min(FAST_S, self.duration_b),
            hammer=replace(self.hammer, hits=min(FAST_HITS, self.hammer.hits)),
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
    twin: TwinView,
    plan: CampaignPlan,
    out_dir: str | Path,
    seed: int,
    *,
    fast: bool = False,
    full: bool = False,
    progress: Progress | None = None,
) -> CampaignSummary:
    """Measure the twin and write `*.h5`, `sensors*.csv`, `lines.csv` and `campaign.json` to a
    folder.

    Parameters
    ----------
    twin : TwinView
    plan : CampaignPlan
    out_dir : path
    seed : int
        The same seed gives the same samples; each record draws from a stream of its own.
    fast : bool
        Short records.
    full : bool
        The ambient record of test (a) lasts 11.4 hours.
    progress : callable, optional
        Told (fraction, text).
    """
    plan = plan.shortened() if fast else plan
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    tell = progress or (lambda fraction, text: None)
    snr: dict[str, float] = {}
    tests = {
        "foundation": _prepare(twin, plan, "foundation", seed),
        "frame": _prepare(twin, plan, "frame", seed),
    }
    jobs = [(name, e) for name in tests for e in EXCITATIONS]
    for i, (name, kind) in enumerate(jobs):
        tell(0.6 * i / len(jobs), f"record {name}-{kind}")
        long = full and (name, kind) == jobs[0]
        make = _long_record if long else _ambient_record
        snr[f"{name}-{kind}"] = make(tests[name], name, kind, twin, plan, folder, seed)
    hammer = _hammer_test(twin, plan, folder, seed, lambda f, text: tell(0.6 + 0.4 * f, text))
    by_test = {name: snr[f"{name}-ambient"] for name in tests} | {
        "hammer": float(np.median(list(hammer.values())))
    }
    _paperwork(twin, plan, folder)
    log.info(
        "signal-to-noise ratio at resonance, dB: %s", {k: round(v, 1) for k, v in by_test.items()}
    )
    tell(1.0, "campaign written")
    snr |= hammer
    return CampaignSummary(
        records=tuple(folder / f"{name}.h5" for name in snr),
        sheet=folder / "sensors.csv",
        log=folder / "campaign.json",
        snr_db=by_test,
        snr_record_db=snr,
        ground_rms={name: t.site.ground_rms for name, t in tests.items()},
    )


def _rng(seed: int, name: str) -> np.random.Generator:
    """A stream that depends on the seed and the name alone, so that records do not shift each
    other.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()),)))


def _prepare(twin: TwinView, plan: CampaignPlan, name: str, seed: int) -> AmbientTest:
    """Puts the sensors up and picks the day."""
    channels, sensor, rate, fmin = {
        "foundation": (plan.foundation, ACCELEROMETER, plan.rate_a, 0.0),
        "frame": (plan.frame, GEOPHONE, plan.rate_b, GEOPHONE_FMIN),
    }[name]
    model = at_outputs(twin.modal, channels)
    chain = Chain.draw((sensor,) * len(channels), _rng(seed, f"{name} sensors"))
    poles = in_band(model.poles, fmin, min(FMAX, 0.4 * rate))
    test = AmbientTest(
        model=model,
        chain=chain,
        site=Ambient(),
        points=_pushed(twin, plan),
        machine=next(iter(twin.machine_points), None),
        rate=rate,
        poles=poles,
    )
    return scaled_to_snr(test, plan.snr_db, (QUIET, LOUD))


def _pushed(twin: TwinView, plan: CampaignPlan) -> tuple[str, ...]:
    """Where air and machines push: up to 16 of the force points, evenly chosen."""
    points = [*twin.machine_points, *twin.drop_points, *twin.sledge_points, *plan.references]
    points = list(dict.fromkeys(points))
    return tuple(
        points[i] for i in np.unique(np.linspace(0, len(points) - 1, 16).round().astype(int))
    )


def _events(
    kind: str, twin: TwinView, spacing: tuple[float, ...], duration: float, rng: np.random.Generator
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
    return [dropped_weight(times, at, rng) if kind == "drop" else sledge(times, at, rng)]


def _even(duration: float, rate: float) -> int:
    """An even number of samples with small prime factors, at most one percent over the duration."""
    return 2 * int(fft.next_fast_len(int(np.ceil(duration * rate / 2)), real=True))


def _ambient_record(
    test: AmbientTest,
    name: str,
    kind: str,
    twin: TwinView,
    plan: CampaignPlan,
    folder: Path,
    seed: int,
) -> float:
    rng = _rng(seed, f"{name}-{kind}")
    samples = _even(plan.duration_a if name == "foundation" else plan.duration_b, test.rate)
    events = _events(kind, twin, plan.spacing, samples / test.rate, rng)
    volts, snr = ambient_record(test, events, samples, rng)
    _write(test, name, kind=kind, twin=twin, plan=plan, folder=folder, volts=volts)
    return snr


def _long_record(
    test: AmbientTest,
    name: str,
    kind: str,
    twin: TwinView,
    plan: CampaignPlan,
    folder: Path,
    seed: int,
) -> float:
    hop, fade = _even(SEGMENT_S, test.rate), 2 * int(0.5 * FADE_S * test.rate)
    segments = int(np.ceil(FULL_HOURS * 3600 * test.rate / hop))
    _write(
        test,
        name,
        kind=kind,
        twin=twin,
        plan=plan,
        folder=folder,
        volts=ambient_blocks(test, segments, hop, fade, _rng(seed, f"{name}-{kind}")),
    )
    return expected_snr(test)


def _write(
    test: AmbientTest,
    name: str,
    kind: str,
    twin: TwinView,
    plan: CampaignPlan,
    folder: Path,
    volts: Any_ | Iterator[Any_],
) -> None:
    ids = [c.id for c in test.model.outputs]
    table = record_channels(twin.test, ids, test.chain.sensors, plan.date)
    write_record(
        folder / f"{name}-{kind}.h5", volts, test.rate, table, source=f"{name}, {kind}, {plan.date}"
    )


def _hammer_test(
    twin: TwinView, plan: CampaignPlan, folder: Path, seed: int, tell: Progress
) -> dict[str, float]:
    """Every setup struck at every reference; ratio by record, dB."""
    jobs = [(i, r) for i in range(len(plan.setups)) for r in plan.references]
    snr = {}
    for k, (i, reference) in enumerate(jobs):
        name = hammer_name(i, reference)
        tell(k / len(jobs), f"record {name}")
        snr[name] = _hammer_record(
            name,
            plan.setups[i],
            setup=i,
            reference=reference,
            twin=twin,
            plan=plan,
            folder=folder,
            seed=seed,
        )
    return snr


def hammer_name(setup: int, reference: str) -> str:
    """File stem of a setup (from 0) struck at a reference: `hammer-1-101pZ`."""
    return f"hammer-{setup + 1}-{reference.replace('+', 'p').replace('-', 'm')}"


def _hammer_record(
    name: str,
    channels: tuple[str, ...],
    setup: int,
    reference: str,
    twin: TwinView,
    plan: CampaignPlan,
    folder: Path,
    seed: int,
) -> float:
    rng, rate = _rng(seed, name), plan.rate_c
    model = at_outputs(twin.modal, channels)
    here = {c.id: i for i, c in enumerate(model.inputs)}
    chain = Chain.draw((FORCE_CELL, *(ICP,) * len(channels)), _rng(seed, f"hammer setup {setup}"))
    limit = FORCE_CELL.range / FORCE_CELL.sensitivity
    blows = strike(plan.hammer, here[reference], limit, rate, rng)
    samples = _even(float(blows.times[-1]) + plan.hammer.block + plan.hammer.rest, rate)
    forces = ambient_forces(
        list(here),
        _pushed(twin, plan),
        machine=None,
        ambient=scale_site(Ambient(), QUIET),
        samples=samples,
        rate=rate,
        rng=rng,
    )
    volts, signal, noise = hammer_record(
        model,
        blows,
        plan=plan.hammer,
        chain=chain,
        background=forces,
        samples=samples,
        rate=rate,
        rng=rng,
    )
    table = [
        replace(c, id=f"F:{c.id}") if i == 0 else c
        for i, c in enumerate(
            record_channels(twin.test, [reference, *channels], chain.sensors, plan.date)
        )
    ]
    write_record(
        folder / f"{name}.h5", volts, rate, table, source=f"hammer at {reference}, {plan.date}"
    )
    poles = in_band(model.poles, GEOPHONE_FMIN, FMAX)
    share = (
        samples / (plan.hammer.block * rate) * clean_energy(blows)
    )  # one clean blow in its own block
    power = resonance_power(signal, poles, samples, rate) * share
    return float(np.median(ratio_db(power, resonance_power(noise, poles, samples, rate))))


def _paperwork(twin: TwinView, plan: CampaignPlan, folder: Path) -> None:
    """Sheets, lines and log."""
    hammer = list(dict.fromkeys(c for s in plan.setups for c in s))
    every = list(dict.fromkeys([*plan.foundation, *plan.frame, *plan.references, *hammer]))
    write_sheet(folder / "sensors.csv", twin.test, every)
    for name, channels, sensor in (
        ("foundation", plan.foundation, ACCELEROMETER),
        ("frame", plan.frame, GEOPHONE),
        ("hammer", hammer, ICP),
    ):
        write_sheet(folder / f"sensors-{name}.csv", twin.test, channels, [sensor] * len(channels))
    write_lines(folder / "lines.csv", twin.test)
    ambient = [
        _ambient_log(name, rate, plan)
        for name, rate in (("foundation", plan.rate_a), ("frame", plan.rate_b))
    ]
    write_log(
        folder / "campaign.json",
        [*ambient, _hammer_log(plan)],
        [ACCELEROMETER, GEOPHONE, ICP, FORCE_CELL],
    )


def _ambient_log(name: str, rate: float, plan: CampaignPlan) -> dict[str, object]:
    records = [{"file": f"{name}-{kind}.h5", "excitation": kind} for kind in EXCITATIONS]
    head = {
        "name": name,
        "kind": "ambient",
        "date": plan.date,
        "rate_hz": rate,
        "sheet": f"sensors-{name}.csv",
    }
    return {**head, "event_spacing_s": list(plan.spacing), "records": records}


def _hammer_log(plan: CampaignPlan) -> dict[str, object]:
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
    head = {"name": "hammer", "kind": "hammer", "date": plan.date, "rate_hz": plan.rate_c}
    blocks = {
        "block_samples": round(plan.hammer.block * plan.rate_c),
        "pretrigger_samples": round(plan.hammer.pretrigger * plan.rate_c),
        "hits": plan.hammer.hits,
    }
    return {**head, "sheet": "sensors-hammer.csv", **blocks, "records": records}
