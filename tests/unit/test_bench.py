"""Benchmarks: every script states what is right, and a wrong answer makes it fail; the page is what
they stated.
"""

from __future__ import annotations

import ast
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import ablations
import ambient_families
import calculix_input
import concrete_frame
import confidence
import correlation
import deck_reading
import derivatives
import durability
import elements
import facility
import form_coverage
import form_patterns
import global_optimum
import hard_facility
import identification_ambient
import identification_hammer
import identification_peers
import identification_setups
import identification_system as system
import kernels
import localisation
import modes
import nastran_corpus
import numpy as np
import outcome
import past_one_machine
import published
import pytest
import records
import results_files
import studio
import studio_clicks
import uncertainty
import updating
import viewer
import write_docs
from outcome import (
    Check,
    Peer,
    Report,
    at_least,
    at_most,
    rms_over_stated,
    share_at_least,
    share_at_most,
    share_within,
    within,
)

from ringtrue.core.modes import ModeSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.identification.ambient import record_bands, ssi_cov
from ringtrue.signal import transients

BENCH = Path(__file__).parents[2] / "bench"
SHARED = {
    "outcome.py",
    "write_docs.py",
    "identification_system.py",
    "concrete_frame.py",
    "calculix_input.py",
}
SCRIPTS = sorted(p for p in BENCH.glob("*.py") if p.name not in SHARED)


FASTER = ModeSet(1.01 * np.arange(1.0, 9.0), np.zeros(8), np.zeros((1, 8)), ("1+Z",))
ON_RANKS = past_one_machine.Run(
    modes=ModeSet(np.arange(1.0, 9.0), np.zeros(8), np.zeros((1, 8)), ("1+Z",)),
    d_lambda=np.ones((8, 2)),
    d_seen=np.ones((3, 8, 2)),
    seconds={},
    memory={},
)
RECORD = ambient_families.Outcome(
    found=5,
    of=5,
    extra=0,
    doubtful=0,
    first=True,
    frequency=np.array([1.0, -1.0]),
    damping=np.array([-1.0, 1.0]),
    speed=1e-5,
    seconds=1.0,
    mac=np.ones(5),
    missing=0,
)
CLICKED = studio_clicks.Clicked(actions=30, edits=3, outside=2, reloads=2, kills=1)
STATED = np.linspace(0.0, 1.0, 500)
PICTURE = viewer.Drawn(20.0, 0.5, 300.0, np.arange(40), np.arange(40), 12)
FOUND = records.Counted.of(
    np.array([1.0, 2.0]), np.array([1.001, 2.01, 5.0]), np.zeros(0)
)


def right(checks: Check | Sequence[Check]) -> bool:
    return all(c.right for c in ([checks] if isinstance(checks, Check) else checks))


# The framework


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_a_number_is_wrong(value: float) -> None:
    assert not at_most("x", value, 1.0).right
    assert not at_least("x", value, 1.0).right
    assert not within("x", value, 0.0, 1.0).right


def test_a_share_is_wrong_on_both_sides() -> None:
    assert share_within("x", 950, 1000, 0.93, 0.97).right
    assert not share_within("x", 880, 1000, 0.93, 0.97).right
    assert not share_within("x", 999, 1000, 0.93, 0.97).right
    assert share_within("x", 20, 20, 0.93, 0.97).right
    assert not share_within("x", 0, 0, 0.93, 0.97).right


def test_limits_are_included() -> None:
    assert at_most("x", 1.0, 1.0).right
    assert not at_most("x", 1.0 + 1e-12, 1.0).right
    assert at_least("x", 1.0, 1.0).right
    assert not at_least("x", 1.0 - 1e-12, 1.0).right
    assert not within("x", -0.1, 0.0, 1.0).right


def test_shares_of_few_cases_have_wider_limits_but_some() -> None:
    few, many = share_at_least("x", 18, 20, 0.9), share_at_least("x", 900, 1000, 0.9)
    assert few.low is not None
    assert many.low is not None
    assert few.low < many.low < 90.0
    assert not share_at_least("x", 0, 0, 0.9).right
    assert not share_at_least("x", 0, 1, 0.5).right
    assert not share_at_most("x", 2, 2, 0.1).right
    assert not share_at_most("x", 0, 0, 0.1).right


def test_errors_over_stated_deviations_are_near_one() -> None:
    errors = np.random.default_rng(0).standard_normal(400)
    assert rms_over_stated("x", errors).right
    assert not rms_over_stated("x", 1.5 * errors).right
    assert not rms_over_stated("x", errors / 2).right
    assert not rms_over_stated("x", [np.nan]).right


def test_a_row_needs_a_check() -> None:
    with pytest.raises(ValueError, match="check"):
        outcome.Row("x", {"s": 1.0}, ())


@pytest.mark.parametrize(("value", "status"), [(0.5, 0), (2.0, 1), (np.nan, 1)])
def test_a_wrong_answer_is_the_status_and_stands_in_the_file(
    value: float, status: int, tmp_path: Path
) -> None:
    options = outcome.arguments("").parse_args(["--json", str(tmp_path / "x.json")])
    report = Report(options)
    report.row("a", {"s": 1.0}, [at_most("x", 0.0, 1.0)])
    report.row(
        "|b|",
        {"s": 2.0, "GB": 1.0},
        [at_most("x", value, 1.0)],
        [Peer("p", {"s": 6.0})],
    )
    report.not_run("q", "not installed")
    with pytest.raises(SystemExit) as end:
        report.end()
    assert end.value.code == status
    stated = json.loads((tmp_path / "x.json").read_text())
    assert stated["right"] == (status == 0)
    assert stated["not_run"] == {"q": "not installed"}
    assert {"command", "date", "commit", "processor"} <= stated.keys()
    assert [r.what for r in outcome.read_rows(stated)] == ["a", "|b|"]
    lines = write_docs.row_lines(stated)
    assert lines[1][2:4] == ("p: 6 s", "3")
    assert ("**wrong**" in lines[1][4]) == (status == 1)
    assert "| \\|b\\| | 2 s, 1 GB | p: 6 s | 3 |" in write_docs.table(
        write_docs.HEAD, lines
    )


def test_no_answer_is_a_wrong_one() -> None:
    with pytest.raises(SystemExit) as end:
        Report(outcome.arguments("").parse_args([])).end()
    assert end.value.code == 1


# The scripts


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.name)
def test_every_script_states_what_is_right_and_needs_nothing_beside_the_clone(
    path: Path,
) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    called = {ast.unparse(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)}
    assert "report.end" in called
    assert "shared/" not in text
    assert any(
        command.split()[0] == f"bench/{path.name}"
        for command in write_docs.RUNS.values()
    )


def test_the_published_frame_is_not_needed() -> None:
    text = (BENCH / "updating.py").read_text(encoding="utf-8")
    assert "if PUBLISHED.exists()" in text
    matrices, rows = concrete_frame.own_frame()
    assert rows.size == 43
    assert len(matrices.stiffness) == 12


def test_the_page_is_what_the_scripts_stated() -> None:
    named = [
        n
        for place in write_docs.PLACE.findall(
            write_docs.TEMPLATE.read_text(encoding="utf-8")
        )
        for n in place.split()
    ]
    assert sorted(named) == sorted([*write_docs.RUNS, "runs"])
    assert {p.stem for p in write_docs.RESULTS.glob("*.json")} <= set(write_docs.RUNS)
    assert write_docs.page(write_docs.stored) == write_docs.PAGE.read_text(
        encoding="utf-8"
    )


def score(
    off: float = 0.0, missing: int = 0, extra: int = 0, mac: float = 1.0
) -> system.Score:
    """Of 15 modes, all off by so many per cent."""
    f = np.full(15, 1.0) * off
    f[:missing] = np.nan
    return system.Score(f, 10 * f, np.where(np.isfinite(f), mac, np.nan), extra)


def record(**what: Any) -> identification_ambient.Record:
    """Errors of 0.05 % of frequency and 0.5 % of damping are those of the floor."""
    return identification_ambient.Record(
        1.0, score(**what), np.full(15, 0.05), np.full(15, 0.5)
    )


def errors(
    count: int, scale: float = 1.0, extra: int = 0
) -> list[identification_ambient.Errors]:
    """Of records whose stated deviations are 0.01."""
    out = []
    for seed in range(count):
        found = np.random.default_rng(seed).standard_normal((3, 10)) * 0.01 * scale
        stated = np.full((2, 10), 0.01)
        out.append(
            identification_ambient.Errors(found[:2], stated, found[2] / 0.01, extra)
        )
    return out


def peer_run(
    frequencies: np.ndarray, std: float = 0.003
) -> identification_peers.Measured:
    return identification_peers.Measured(
        1.0, 1.0, frequencies, std * np.sqrt(frequencies)
    )


def square(joined: int = 0, moved: float = 0.0) -> deck_reading.Square:
    read = deck_reading.made(100)
    other = read.joined.copy()
    other[0, 0] += joined
    return replace(read, joined=other, xyz=read.xyz + moved)


def drawn(scale: float = 1.0, found: int = 4) -> list[dict[str, np.ndarray]]:
    """Errors over deviations of 40 sets of four modes."""
    rng = np.random.default_rng(3)
    return [
        {
            k: scale * rng.standard_normal(found)
            for k in ("frequency", "damping", "shapes")
        }
        for _ in range(40)
    ]


GAPS = np.random.default_rng(0).standard_normal(200)
TRUE = system.truth(system.SIXTEEN).frequencies
FREE = np.r_[np.zeros(6), np.linspace(10.0, 40.0, 24)]
SEED = facility.Seed(
    first_pairs=18,
    first_mean=19.0,
    pairs=20,
    mean=0.8,
    largest=2.5,
    mac=96.0,
    kept=True,
    bands=(4, 4),
    damping=(0.5, -1.0, 0.8),
    wrong={"slab": True},
    seconds=300.0,
)
HARD = hard_facility.HardSeed(
    first_pairs=19,
    first_mean=4.0,
    pairs=21,
    mean=1.2,
    largest=4.0,
    mac=88.0,
    apart=0.2,
    macs=(60.0, 100.0),
    planted={"1+Z reversed": True, "no other channel": True},
    seconds=300.0,
)
SUMMARY: dict[str, Any] = {
    "initial": [],
    "final": [
        {
            "frequency_test_hz": 5.0,
            "frequency_fe_hz": 5.1,
            "mac_percent": 97.0,
            "used": True,
        }
    ],
    "ambient_vs_hammer": [],
    "parameters": [{"name": "slab", "updated": 2.2e10, "std": 1e9}],
}
SCORE = localisation.Score(3, 4, 1.0, 1.0, 0.2, {}, 1.0)
CONFUSION = {
    c: Counter({c: 20}) for c in (*form_patterns.CAUSES, *form_patterns.OTHERS)
}
COVERAGE = Counter(
    {"parameters": 100, "held": 90, "left out": 100, "left out held": 90}
)
REACHED = global_optimum.Case(1.0, 1.0, 9.0, unfit=False, seconds=1.0)
RUN = updating.Run(1.0, 0.5, 1e-12, 1e-6, True)
COUNTS = {f"{w}{h}": 50 for w in uncertainty.STATED for h in ("", " held")}
PAIRED = correlation.Paired(np.full(100, 0.8), np.full(100, 0.7))
SLOPES = np.random.default_rng(2).standard_normal((30, 4))

ALIKE = durability.Faults(100, 100, 100, 100)
FLIPS = durability.Flips(named=8, refused=1, anew=20, alike=20)

# script: what judges its answers, answers that are right, and wrong ones
DECK = nastran_corpus.Case("", "deck.bdf", "deck.op2", 1.0)


def recorded_modes(found: Any) -> Check:
    """Free modes of a deck against those that are recorded."""
    return nastran_corpus.near(DECK, nastran_corpus.modes_off(found, FREE))


def recorded_moves(factor: float) -> Check:
    """Two load cases against what is recorded, one of them off by a factor."""
    moved = [np.eye(3), 2.0 * np.eye(3)]
    off = nastran_corpus.displacements_off([moved[0], factor * moved[1]], moved)
    return nastran_corpus.near(DECK, off)


JUDGED: list[
    tuple[
        str,
        Callable[..., Check | Sequence[Check]],
        tuple[Any, ...],
        list[tuple[Any, ...]],
    ]
] = [
    (
        "modes",
        modes.solved,
        (FREE, 1e-8),
        [(FREE + 1, 1e-8), (FREE, 1e-2), (FREE, np.nan)],
    ),
    (
        "modes",
        modes.same,
        (FREE, FREE),
        [(FREE * 1.001, FREE), (FREE[:-1], FREE), (np.delete(FREE, 7), FREE)],
    ),
    (
        "modes",
        modes.near,
        (FREE, 1.01 * FREE, "solid"),
        [(FREE, 1.05 * FREE, "solid"), (FREE, 1.01 * FREE, "tetra")],
    ),
    (
        "derivatives",
        derivatives.by_differences,
        (SLOPES, SLOPES),
        [(1.01 * SLOPES, SLOPES), (np.nan * SLOPES, SLOPES)],
    ),
    (
        "derivatives",
        derivatives.by_products,
        (SLOPES, SLOPES),
        [(1.01 * SLOPES, SLOPES)],
    ),
    (
        "past_one_machine",
        past_one_machine.same,
        (ON_RANKS, ON_RANKS),
        [
            (replace(ON_RANKS, modes=FASTER), ON_RANKS),
            (replace(ON_RANKS, d_lambda=1.01 * ON_RANKS.d_lambda), ON_RANKS),
            (replace(ON_RANKS, d_seen=1.01 * ON_RANKS.d_seen), ON_RANKS),
        ],
    ),
    (
        "elements",
        elements.solid,
        ("CHEXA20", 0.98, 0.93, 0.1, 0.1),
        [("CHEXA20", 0.9, 0.93, 0.1, 0.1)],
    ),
    (
        "elements",
        elements.solid,
        ("CTETRA4", 0.01, 0.02, 35.0, 400.0),
        [("CTETRA4", 1.2, 0.02, 35.0, 400.0)],
    ),
    (
        "elements",
        elements.converges,
        ([40.0, 5.0], 10.0),
        [([40.0, 40.0], 10.0), ([40.0, -5.0], 10.0)],
    ),
    (
        "deck_reading",
        deck_reading.checks,
        (square(), square()),
        [
            (square(joined=1), square()),
            (square(moved=0.01), square()),
            (deck_reading.made(81), square()),
        ],
    ),
    (
        "nastran_corpus",
        recorded_modes,
        (FREE,),
        [(FREE * 1.02,), (FREE[:-1],), (FREE * np.nan,)],
    ),
    ("nastran_corpus", recorded_moves, (1.0,), [(1.02,), (0.0,), (np.nan,)]),
    (
        "identification_ambient",
        identification_ambient.accurate,
        ([record(off=0.05)] * 2,),
        [
            ([record(off=0.5)] * 2,),
            ([record(off=0.05), record(off=0.05, missing=1)],),
            ([record(off=0.05, extra=1)],),
        ],
    ),
    (
        "identification_ambient",
        identification_ambient.near_floor,
        (errors(9), np.full((2, 10), 0.01)),
        [
            (errors(9, 3.0), np.full((2, 10), 0.01)),
            (errors(9, extra=1), np.full((2, 10), 0.01)),
        ],
    ),
    (
        "identification_ambient",
        identification_ambient.honest,
        (errors(9),),
        [(errors(9, 2.0),)],
    ),
    (
        "identification_ambient",
        identification_ambient.told,
        (
            identification_ambient.Pairs(
                8, 8, 0, GAPS[:16].tolist(), GAPS[16:32].tolist()
            ),
        ),
        [
            (
                identification_ambient.Pairs(
                    8, 3, 0, GAPS[:16].tolist(), GAPS[16:32].tolist()
                ),
            ),
            (
                identification_ambient.Pairs(
                    8, 8, 1, GAPS[:16].tolist(), GAPS[16:32].tolist()
                ),
            ),
            (identification_ambient.Pairs(8, 8, 0, [], []),),
        ],
    ),
    (
        "identification_ambient",
        identification_ambient.right_stream,
        (score(0.05), np.full((2, 15), 5e-4) * [[1], [10]]),
        [
            (score(0.5), np.full((2, 15), 5e-4)),
            (score(0.05, missing=1), np.full((2, 15), 5e-4)),
        ],
    ),
    (
        "identification_peers",
        identification_peers.checks,
        (peer_run(TRUE), 0.0, 60),
        [
            (peer_run(TRUE[1:]), 0.0, 60),
            (peer_run(1.008 * TRUE), 0.0, 60),
            (peer_run(np.zeros(0)), 0.0, 60),
        ],
    ),
    (
        "identification_setups",
        identification_setups.checks,
        (drawn(),),
        [(drawn(scale=5.0),), (drawn(found=2),)],
    ),
    (
        "identification_hammer",
        identification_hammer.checks,
        ([identification_hammer.Found(1.0, score(0.001))], (0, 1, 2)),
        [
            ([identification_hammer.Found(1.0, score(0.1))], (0, 1, 2)),
            ([identification_hammer.Found(1.0, score(0.001, missing=1))], (0, 1, 2)),
            ([identification_hammer.Found(1.0, score(0.001, mac=0.9))], (0, 1, 2)),
        ],
    ),
    (
        "identification_hammer",
        identification_hammer.honest,
        (20, 20, GAPS, GAPS),
        [(20, 20, 3 * GAPS, GAPS)],
    ),
    (
        "identification_hammer",
        identification_hammer.honest,
        (20, 20, GAPS, GAPS),
        [(9, 20, GAPS, GAPS)],
    ),
    ("correlation", correlation.same_mac, (SLOPES, SLOPES), [(SLOPES + 1e-6, SLOPES)]),
    (
        "correlation",
        correlation.right_pairs,
        (np.arange(99), np.arange(99)),
        [(np.arange(99)[::-1], np.arange(99))],
    ),
    (
        "correlation",
        correlation.plausible_comac,
        (np.full(9, 0.96),),
        [(np.full(9, 0.5),)],
    ),
    ("correlation", correlation.few_alarms, (0, 400), [(40, 400)]),
    (
        "correlation",
        correlation.named,
        ("reversed", 1.0, 0, 100),
        [("reversed", 0.5, 0, 100), ("dead", 1.0, 30, 100)],
    ),
    (
        "correlation",
        correlation.few_wrong,
        (PAIRED,),
        [(replace(PAIRED, shared=np.full(100, 0.3)),)],
    ),
    (
        "localisation",
        localisation.checks,
        ([SCORE] * 3,),
        [
            ([replace(SCORE, share=0.3)] * 3,),
            ([replace(SCORE, members=8)] * 3,),
            ([replace(SCORE, random=0.9)] * 3,),
        ],
    ),
    (
        "form_patterns",
        form_patterns.checks,
        (CONFUSION,),
        [
            ({**CONFUSION, "shear": Counter(property=20)},),
            ({**CONFUSION, "none": Counter(shear=20)},),
        ],
    ),
    (
        "form_coverage",
        form_coverage.checks,
        (COVERAGE, COVERAGE),
        [
            (COVERAGE | Counter(held=99), COVERAGE),
            (COVERAGE - Counter(held=20), COVERAGE),
            (COVERAGE - Counter({"left out held": 20}), COVERAGE),
            (COVERAGE, COVERAGE + Counter(flagged=60)),
        ],
    ),
    (
        "updating",
        updating.recovered,
        ([RUN],),
        [
            ([replace(RUN, at_truth=100.0)],),
            ([replace(RUN, error=1.1)],),
            ([RUN, replace(RUN, converged=False)],),
        ],
    ),
    (
        "updating",
        updating.same_modes,
        (FREE[6:], FREE[6:]),
        [(1.01 * FREE[6:], FREE[6:])],
    ),
    (
        "published",
        published.recovered,
        ([1e-3, 2e-3],),
        [([1e-3, 0.05],), ([1e-3, np.nan],)],
    ),
    (
        "global_optimum",
        global_optimum.judged,
        ([REACHED, REACHED],),
        [
            ([replace(REACHED, found=99.0), REACHED],),
            ([replace(REACHED, found=np.nan)],),
        ],
    ),
    (
        "updating",
        updating.verified,
        ([1e-5], [1e-3]),
        [([1e-2], [1e-3]), ([1e-5], [1.1])],
    ),
    (
        "uncertainty",
        uncertainty.checks,
        (COUNTS, False),
        [({**COUNTS, "left out held": 20}, False)],
    ),
    (
        "uncertainty",
        uncertainty.checks,
        (COUNTS, True),
        [({**COUNTS, "parameters held": 20}, True)],
    ),
    (
        "facility",
        facility.bars,
        (SEED,),
        [
            (replace(SEED, pairs=10),),
            (replace(SEED, mean=4.0),),
            (replace(SEED, mac=80.0),),
            (replace(SEED, kept=False),),
        ],
    ),
    (
        "facility",
        facility.over_all,
        ([SEED] * 4,),
        [
            ([replace(SEED, bands=(0, 4))] * 4,),
            ([replace(SEED, damping=(9.0, 9.0, 9.0))] * 4,),
            ([replace(SEED, wrong={"slab": False})] * 4,),
        ],
    ),
    ("facility", facility.orthogonal, (10.0,), [(40.0,)]),
    (
        "hard_facility",
        hard_facility.bars,
        (HARD,),
        [
            (replace(HARD, pairs=10),),
            (replace(HARD, mean=2.1),),
            (replace(HARD, largest=6.2),),
            (replace(HARD, apart=0.01),),
            (replace(HARD, apart=0.8),),
        ],
    ),
    (
        "hard_facility",
        hard_facility.all_named,
        ([HARD] * 4,),
        [([*[HARD] * 4, replace(HARD, planted={"1+Z reversed": False})],)],
    ),
    (
        "results_files",
        results_files.same_modes,
        ((FREE, FREE), (SLOPES, SLOPES)),
        [
            ((1.01 * FREE, FREE), (SLOPES, SLOPES)),
            ((FREE, FREE), (SLOPES[:-1], SLOPES)),
        ],
    ),
    (
        "results_files",
        results_files.same_deck,
        ({7: "CBAR"}, {7: "CBAR"}, 0.0),
        [({7: "CBAR"}, {8: "CBAR"}, 0.0), ({7: "CBAR"}, {7: "CBAR"}, 0.1)],
    ),
    (
        "records",
        records.checks,
        (FOUND, (2, 0)),
        [(replace(FOUND, found=1), (2, 0)), (replace(FOUND, extra=1), (2, 0))],
    ),
    (
        "ambient_families",
        ambient_families.checks,
        ("machine", [RECORD] * 40),
        [
            ("machine", [replace(RECORD, found=4)] * 40),
            ("machine", [replace(RECORD, extra=1)] * 40),
            ("machine", [replace(RECORD, speed=0.01)] * 40),
            ("machine", [replace(RECORD, frequency=3 * RECORD.frequency)] * 40),
            ("machine", [replace(RECORD, damping=3 * RECORD.damping)] * 40),
            ("short", [replace(RECORD, first=False)] * 40),
            ("setups", [replace(RECORD, mac=np.full(5, 0.99))] * 40),
            ("setups", [replace(RECORD, missing=1)] * 40),
        ],
    ),
    (
        "ablations",
        ablations.checks,
        (60, 0, 0),
        [(500, 0, 0), (60, 500, 0), (60, 0, 1)],
    ),
    (
        "confidence",
        confidence.checks,
        (STATED, STATED, STATED, STATED > 0.6),
        [
            (STATED, STATED, STATED, STATED > 0.97),
            (STATED, STATED, STATED, STATED > 0.3),
            (STATED, STATED, STATED, STATED < 0.6),
            (STATED, STATED, 1 - STATED, STATED > 0.6),
        ],
    ),
    (
        "kernels",
        kernels.compared,
        (SUMMARY, SUMMARY),
        [
            (SUMMARY, {**SUMMARY, "final": []}),
            (SUMMARY, {**SUMMARY, "final": [{**SUMMARY["final"][0], "used": False}]}),
            (
                SUMMARY,
                {**SUMMARY, "final": [{**SUMMARY["final"][0], "frequency_fe_hz": 5.2}]},
            ),
            (
                SUMMARY,
                {
                    **SUMMARY,
                    "parameters": [{**SUMMARY["parameters"][0], "updated": 2.3e10}],
                },
            ),
        ],
    ),
    (
        "durability",
        durability.survived,
        (ALIKE,),
        [(replace(ALIKE, **{n: 99}),) for n in ("met", "whole", "alike")],
    ),
    (
        "viewer",
        viewer.checks,
        (PICTURE, 12),
        [
            (replace(PICTURE, picked=PICTURE.picked + 1), 12),
            (PICTURE, 24),
            (replace(PICTURE, frames=0.0), 12),
        ],
    ),
    (
        "durability",
        durability.unread,
        (FLIPS,),
        [
            (replace(FLIPS, **{n: v}),)
            for n, v in (("wrong", 1), ("ended", 1), ("alike", 19), ("named", -9))
        ],
    ),
    (
        "studio",
        studio.states_itself,
        (1e-5, 8e-6, 1e-3),
        [(1e-4, 8e-6, 1e-3), (1e-5, 8e-6, 0.1), (np.nan, 8e-6, 1e-3)],
    ),
    (
        "studio_clicks",
        studio_clicks.nothing_lost,
        (CLICKED,),
        [
            (replace(CLICKED, **{n: v}),)
            for n, v in (
                ("faults", 1),
                ("errors", 1),
                ("lost", 1),
                ("broken", 1),
                ("edits", 0),
            )
        ],
    ),
]


@pytest.mark.parametrize(
    ("script", "judge", "good", "bad"),
    JUDGED,
    ids=lambda x: getattr(x, "__name__", None),
)
def test_a_wrong_answer_is_found(
    script: str,
    judge: Callable[..., Check | Sequence[Check]],
    good: tuple[Any, ...],
    bad: list[tuple[Any, ...]],
) -> None:
    assert right(judge(*good))
    for wrong in bad:
        assert not right(judge(*wrong))


def test_a_deck_as_input_of_calculix(tmp_path: Path) -> None:
    """Nodes between the ends of a wedge stand behind those of the far end; what CalculiX would take
    otherwise is not translated.
    """
    nodes = "".join(f"GRID,{i},,{i % 3}.,{i % 5}.,{i % 7}.\n" for i in range(1, 16))
    wedge = "CPENTA,1,1,1,2,3,4,5,6\n,7,8,9,10,11,12,13,14\n,15\n"
    materials = "PSOLID,1,1\nMAT1,1,2.+11,,.3,7800.\nSPC1,1,13,2\n"
    path = tmp_path / "d.bdf"
    path.write_text(f"BEGIN BULK\n{nodes}{wedge}{materials}")
    text = calculix_input.written(read_deck(path))
    assert (
        "*ELEMENT,TYPE=C3D15,ELSET=CPENTA01\n1,1,2,3,4,5,6,7,8,9,13,14,15,10,11,\n12\n"
        in text
    )
    assert "*BOUNDARY\n2,1\n*BOUNDARY\n2,3\n" in text
    path.write_text(f"BEGIN BULK\n{nodes}{wedge}{materials}CELAS2,2,1.,1,1\n")
    with pytest.raises(calculix_input.OtherDeck, match="CELAS2"):
        calculix_input.written(read_deck(path))


def test_a_changed_setting_takes_effect_wherever_it_is_held() -> None:
    """In a process of its own: of a class, of instances that modules hold, of names imported."""
    settings = {x.label: x for x in ablations.all_settings()}
    event = settings["signal.transients: EventSettings.loud"]
    references = settings["identification.ambient.ssi_cov: MAX_REFERENCES"]

    def held() -> tuple[float, float, int, int]:
        for one in (event, references):
            one.change(2.0)
        modules = ssi_cov.MAX_REFERENCES, record_bands.MAX_REFERENCES
        return transients.EventSettings().loud, transients.EVENT.loud, *modules

    before = transients.EVENT.loud, ssi_cov.MAX_REFERENCES
    doubled = ablations.in_own_process(held)
    assert doubled == (2 * before[0], 2 * before[0], 2 * before[1], 2 * before[1])
    assert (transients.EVENT.loud, ssi_cov.MAX_REFERENCES) == before


def test_every_script_has_been_fed_a_wrong_answer() -> None:
    assert {script for script, *_ in JUDGED} == {p.stem for p in SCRIPTS}
