"""What a correlation rests on, the user's limits and the exit status, on the small study of
`small_study`.
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import small_study

from ringtrue.cli.main import run as command
from ringtrue.core.dofs import DofSet
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.pairing import Pairing
from ringtrue.correlation.table import CorrelationTable
from ringtrue.model.ports import ModesRequest
from ringtrue.report.build import deliver
from ringtrue.report.parts import Items, ReportTable, Stages
from ringtrue.report.sections import summary, system
from ringtrue.shapes import paired_mac
from ringtrue.study.acceptance import Acceptance, in_both, limits, missed_words, verdict
from ringtrue.study.conclusion import Conclusion, Validation, conclude
from ringtrue.study.config_sections import StudyInfo
from ringtrue.study.evidence import (
    ModelModes,
    channel_mass,
    evidence,
    on_sheet,
    synthesised,
)
from ringtrue.study.messages import left_out_sentence, run_messages
from ringtrue.study.reference import reference_modes
from ringtrue.study.results import Evidence, RecordPreview, RecordSummary
from ringtrue.study.run import StudyRun, run_study
from ringtrue.updating.identifiability import Flag

Capture = pytest.CaptureFixture[str]
SI = UNIT_SYSTEMS["SI"]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyRun:
    run = run_study(small_study.write_study(tmp_path_factory.mktemp("evidence")))
    deliver(run)
    return run


def final(run: StudyRun) -> Evidence:
    found = run.results["final"].evidence
    assert isinstance(found, Evidence)
    return found


def test_the_right_model_passes_the_gates_of_the_trade_and_the_wrong_one_does_not(
    done: StudyRun,
) -> None:
    """Two thirds of the mass are at measured floors, so the static model with inertia keeps the
    nine modes apart.
    """
    kinds = [(c.mass, c.kind) for c in final(done).measures.checks]
    assert kinds == [
        (mass, kind) for mass in ("IRS", "SEREP") for kind in ("model", "self", "cross")
    ]
    assert all(
        c.verdict.passed
        for c in final(done).measures.checks
        if (c.mass, c.kind) != ("SEREP", "model")
    )
    before = done.results["correlate"].evidence
    least = [
        [c.verdict.least_diagonal for c in e.measures.checks if c.kind == "cross"]
        for e in (before, final(done))
    ]
    (irs_before, serep_before), (irs, serep) = least
    assert irs_before < irs
    assert (
        min(serep_before, serep) > 0.99
    )  # its mass is made of the modes that it judges: it tells little
    assert np.diag(final(done).auto_mac) == pytest.approx(1)


def test_responses_agree_after_the_updating(done: StudyRun) -> None:
    frfs = final(done).frfs
    assert frfs is not None
    for before, after in zip(
        frfs.initial.by_input(), frfs.final.by_input(), strict=True
    ):
        # the resonances lay beside those of the test
        assert after.frac > 0.95 > 0.7 > before.frac
        assert after.shape > before.shape
        assert after.deviation < 0.4 * before.deviation
    ridge = np.diag(frfs.fdac_final)
    assert np.median(ridge) > 0.98
    assert np.median(np.diag(frfs.fdac_initial)) < np.median(ridge)


def test_modes_are_followed_through_the_change(done: StudyRun) -> None:
    tracks = final(done).tracks
    assert tracks is not None
    index = tracks.index
    # one to one
    assert all(sorted(row) == list(range(index.shape[1])) for row in index.tolist())
    assert len(index) == 2  # final and initial: there was no remodelling
    assert tracks.worst.min() > 0.8


def test_a_channel_turned_round_is_named_before_the_updating(done: StudyRun) -> None:
    reference = reference_modes(done.results["identify"], done.config)
    table, fe = done.results["correlate"].initial, done.results["correlate"].fe_initial
    assert done.results["correlate"].evidence_initial.measures.suspects == ()
    i = reference.elastic.channels.index("303+X")
    shapes = (
        np.where(np.arange(len(reference.elastic.channels))[:, None] == i, -1, 1)
        * reference.elastic.shapes
    )
    turned = replace(reference, elastic=replace(reference.elastic, shapes=shapes))
    found = evidence(turned, fe, table.pairing, done.config).measures.suspects
    assert [(s.channel, s.fault) for s in found] == [("303+X", "reversed")]
    assert found[0].mac_mended > found[0].mac_now


def test_channels_that_read_the_same_are_no_error(done: StudyRun) -> None:
    opened, config = done.session.remodelled, done.config.correlate
    seen = opened.observation(done.results["identify"].test, config.tolerance)
    twice = (*seen.channels, seen.channels[0])
    assert channel_mass(opened, seen, seen.channels, config, small_study.FMAX).why == ""
    none = channel_mass(opened, seen, twice, config, small_study.FMAX)
    mass, why = none.matrix, none.why
    assert mass is None
    assert "reads what others read already" in why
    hybrid = config.model_copy(update={"tam": "hybrid"})
    m = channel_mass(opened, seen, seen.channels, hybrid, small_study.FMAX).matrix
    phi = done.results["correlate"].fe_remodelled.shapes
    np.testing.assert_allclose(phi.T @ m @ phi, np.eye(phi.shape[1]), atol=1e-6)


def test_synthesised_responses_are_those_of_the_solver(done: StudyRun) -> None:
    """The sensors sit on nodes, so that the solver can be asked directly; the residuals are exact
    at other shifts.
    """
    opened, found = done.session.initial, done.results["identify"]
    test = on_sheet(found, 1.0, 12.0)
    assert test is not None
    assert test.window_decay > 0  # the blows ring longer than the block
    test = replace(test, window_decay=0.0)
    seen = opened.observation(found.test, done.config.correlate.tolerance)
    fe = done.results["correlate"].fe_initial
    zeta = np.full(len(fe), 0.02)
    model = ModelModes(opened, fe, zeta)
    made = synthesised(model, seen, test, SI, small_study.FMAX)
    out, into = (
        DofSet.parse([c.id for c in side]) for side in (test.outputs, test.inputs)
    )
    request = ModesRequest(band=(-1.0, small_study.FMAX))
    want = opened.analysis.frf(
        out, into, test.freqs, request, damping=0.02, kind="accelerance"
    )
    assert np.abs(made.data - want).max() < 1e-3 * np.abs(want).max()
    # in t, mm, N an acceleration is 1000 times as large a number, and the mass-normalised shapes
    # are so by √1000
    tonne = synthesised(model, seen, test, UNIT_SYSTEMS["mm-t-s"], small_study.FMAX)
    np.testing.assert_allclose(1e3 * tonne.data, made.data)
    # an exponential window damps the test like σ/ω more
    window = replace(test, window_decay=0.5)
    damped = synthesised(model, seen, window, SI, small_study.FMAX)
    more_damped = replace(model, damping=zeta + 0.5 / (2 * np.pi * fe.frequencies))
    more = synthesised(more_damped, seen, test, SI, small_study.FMAX)
    np.testing.assert_allclose(damped.data, more.data)


def test_the_summary_tells_significance_and_evidence(done: StudyRun) -> None:
    found = json.loads((done.folder / "summary.json").read_text())
    assert set(found["evidence"]) == {
        "ambient_vs_hammer",
        "initial",
        "remodelled",
        "final",
    }
    assert all(c["judged"] for c in found["evidence"]["final"]["orthogonality"])
    assert [
        c["verdict"]["passed"]
        for c in found["evidence"]["final"]["orthogonality"]
        if "model" not in c["name"]
    ] == [True] * 4
    assert found["evidence"]["final"]["frfs"]["final"][0]["frac"] > 0.9
    both = found["ambient_vs_hammer"]
    assert all(p["deviation_std"] > 0 for p in both)
    # 10 % off, measured to 0.01 %
    assert not any(p["within_scatter"] for p in found["initial"])
    assert found["acceptance"] == {"limits": [], "missed": []}


# --- the user's own limits


def stated(run: StudyRun, **limit: object) -> tuple[list[bool], tuple[str, ...]]:
    section = type(run.config.correlate).model_validate(limit)
    config = run.config.model_copy(update={"correlate": section})
    return [c.held for c in limits(config, run.results)], missed_words(
        config, run.results
    )


def test_only_stated_limits_judge(done: StudyRun) -> None:
    assert limits(done.config, done.results) == ()
    assert missed_words(done.config, done.results) == ()
    names = [c.name for c in verdict(done.config, done.results)]
    assert names == [
        "updating",
        "used modes: mean |Δf|",
        "left-out modes: mean |Δf|",
    ]
    informative = [c for c in verdict(done.config, done.results) if not c.required]
    assert [c.code for c in informative] == ["change", "change"]
    assert all(
        re.fullmatch(r"fell from [\d.]+ to [\d.]+ %", c.got) for c in informative
    )
    assert not any(c.wanted for c in informative)  # no limit of the user's
    assert all(c.held for c in verdict(done.config, done.results))


def test_the_verdict_follows_from_the_required_limits(done: StudyRun) -> None:
    """No limit: not judged; limits that hold: validated; one that fails: not validated."""

    def concluded(**limit: object) -> Conclusion:
        section = type(done.config.correlate).model_validate(limit)
        config = done.config.model_copy(update={"correlate": section})
        found = conclude(
            done.results, verdict(config, done.results), Acceptance.of(section)
        )
        assert found is not None
        return found

    free = concluded()
    assert free.verdict is Validation.NOT_JUDGED
    assert not free.failed
    assert concluded(accept_mean_percent=2.0).verdict is Validation.VALIDATED
    strict = concluded(accept_mean_percent=1e-9)
    assert strict.verdict is Validation.NOT_VALIDATED
    assert [c.name for c in strict.failed] == ["final model: mean |Δf|"]
    table = done.results["final"].table
    assert free.band == pytest.approx((table.all_test_hz[0], table.all_test_hz[-1]))
    assert free.unseen is not None
    assert free.unseen.kind == "left out"
    assert free.unseen.count == int((~table.used).sum())
    assert free.unseen.mean == pytest.approx(table.mean_deviation(~table.used))
    assert free.unseen.before > free.unseen.mean
    assert [c.name for c in free.changes] == list(
        done.results["update"].best.parameters
    )
    nothing = {k: v for k, v in done.results.items() if k != "correlate"}
    assert conclude(nothing, (), Acceptance()) is None


def test_a_narrow_rule_of_acceptance_ends_the_band(done: StudyRun) -> None:
    found = conclude(done.results, (), Acceptance(percent=1e-9))
    assert found is not None
    assert found.band == (0.0, 0.0)


def test_modes_that_win_a_partner_do_not_make_those_left_out_look_worse() -> None:
    """A mode beyond the gate before the updating counts in no mean over modes paired in both; it is
    named.
    """

    def table(modes: list[int], percent: list[float]) -> CorrelationTable:
        at, n = np.array(modes), len(modes)
        hz = np.array([10.0, 20.0, 30.0, 40.0])
        pairing = Pairing(
            at,
            at,
            np.ones(n),
            np.zeros(n),
            np.zeros(n, dtype=bool),
            at[:0],
            (),
            at[:0],
            (),
        )
        fe = hz[at] * (1 + np.array(percent) / 100)
        return CorrelationTable(
            pairing, hz[at], fe, np.full(n, np.nan), at != 1, np.eye(4), hz, hz
        )

    first, last = table([0, 1], [20.0, 15.0]), table([0, 1], [1.0, -3.0])
    assert (
        left_out_sentence(first, last)
        == "modes that the updating did not see: mean |Δf| 15.00 -> 3.00 %"
    )
    won = replace(
        table([0, 1, 3], [1.0, -3.0, 38.0]), used=np.array([True, False, False])
    )
    words = left_out_sentence(first, won)
    assert words.endswith(
        "of the 1 paired before and after 15.00 -> 3.00 %; paired after only: 4 (+38.0 %)"
    )
    assert [w.tolist() for w in in_both(first, won, used=False)] == [
        [False, True],
        [False, True, False],
    ]
    stages = {
        "correlate": SimpleNamespace(initial=first, remodelling=None),
        "final": SimpleNamespace(table=won),
    }
    rows = summary.stages_table(Stages(StudyInfo(), Acceptance(), **stages)).rows  # type: ignore[arg-type]
    assert [tuple(r[:4]) for r in rows if r[1] != "used in the updating"] == [
        ("Initial", "all", "2", "17.50"),
        ("", "left out", "1", "15.00"),
        ("Final", "all", "3", "14.00"),
        ("", "left out", "1", "3.00"),
    ]
    assert [w.tolist() for w in in_both(first, won)] == [
        [True, True],
        [True, True, False],
    ]


def test_what_is_not_plausible_is_told_beside_what_is_not_proven(
    done: StudyRun,
) -> None:
    known = done.results["uncertainty"]
    first, second, *_ = known.posterior.parameters.names
    far, open_ = (
        Flag(
            first,
            "prior",
            0.08,
            f"{first}: factor 0.08 is 2.5 prior standard deviations",
        ),
        Flag(second, "form", 1.2, f"{second}: factor 1.2, but"),
    )
    assert not known.unproven.any()
    wide = np.where(
        np.array(known.posterior.parameters.names)[:, None] == second,
        [0.5, 2.0],
        known.posterior.interval,
    )
    posterior = replace(known.posterior, interval=wide)
    odd = replace(known, flags=(far, open_), posterior=posterior)
    lines = run_messages({"uncertainty": odd})
    assert far.text in lines
    assert open_.text not in lines
    assert (
        sum(
            line.startswith("not proven by the test") and line.endswith(second)
            for line in lines
        )
        == 1
    )


def test_the_interval_of_a_factor_stands_beside_its_standard_deviation(
    done: StudyRun,
) -> None:
    """Student's: with errors whose size few modes tell it is far wider than the standard deviation
    says.
    """
    known = done.results["uncertainty"]
    name, wide = known.posterior.parameters.names[0], np.array(known.posterior.interval)
    wide[0] = 0.5, 0.9
    some = {k: done.results[k] for k in ("update", "correlate")}
    (line,) = [
        x
        for x in run_messages(
            {
                **some,
                "uncertainty": replace(
                    known, posterior=replace(known.posterior, interval=wide)
                ),
            }
        )
        if x.startswith(f"{name}: times")
    ]
    assert re.search(r" ± [\d.]+ \(90 %: 0\.50* to 0\.90*\)$", line)
    assert not any("90 %:" in x for x in run_messages(some))


def test_each_limit_is_held_and_missed(done: StudyRun) -> None:
    table = done.results["final"].table
    worst = float(np.abs(table.deviation_percent).max())
    assert stated(done, accept_percent=1.01 * worst) == ([True], ())
    held, missed = stated(done, accept_percent=0.99 * worst)
    assert held == [False]
    k = int(np.abs(table.deviation_percent).argmax())
    assert len(missed) == 1
    assert missed[0].startswith(f"test mode {table.pairing.a[k] + 1} (")
    assert "MAC" in missed[0]
    assert stated(done, accept_mac=100.0)[0] == [False]
    # one of the two is enough
    assert stated(done, accept_percent=0.0, accept_hz=10.0)[0] == [True]
    for name, good, bad in (
        ("accept_pairs", len(table), len(table) + 1),
        (
            "accept_mean_percent",
            1.01 * table.mean_deviation(),
            0.99 * table.mean_deviation(),
        ),
        (
            "accept_mean_mac",
            table.mean_subspace_mac() - 1e-6,
            table.mean_subspace_mac() + 1e-6,
        ),
        ("accept_off_diagonal", 10.0, 10.0),
    ):
        assert stated(done, **{name: good})[0] == [True]
        if good != bad:
            assert stated(done, **{name: bad})[0] == [False]


def test_a_study_without_candidates_judges_its_deck(done: StudyRun) -> None:
    config = done.config.model_copy(update={"candidate": []})
    config = config.model_copy(
        update={"correlate": type(config.correlate)(accept_percent=1.0)}
    )
    results = {"correlate": done.results["correlate"]}
    (check,) = limits(config, results)
    assert not check.held
    assert check.name.startswith("model: pairs with |Δf| ≤ 1 %")
    assert (
        limits(done.config.model_copy(update={"correlate": config.correlate}), results)
        == ()
    )  # not updated yet


def test_no_pair_is_no_success(done: StudyRun) -> None:
    table = done.results["final"].table
    p = table.pairing
    none = replace(
        p,
        **{
            k: getattr(p, k)[:0]
            for k in ("a", "b", "mac", "frequency_error", "subspace", "beyond")
        },
    )
    empty = replace(table, pairing=none, test_hz=[], fe_hz=[], std_hz=[], used=[])
    results = {
        "final": replace(done.results["final"], table=empty),
        "correlate": done.results["correlate"],
    }
    config = done.config.model_copy(
        update={"correlate": type(done.config.correlate)(accept_percent=5.0)}
    )
    assert [c.held for c in limits(config, results)] == [False]
    assert (
        Acceptance.of(config.correlate).words() == "|Δf| ≤ 5 % and subspace MAC ≥ 80 %"
    )


def test_the_exit_status_follows_the_limits(tmp_path: Path, capsys: Capture) -> None:
    strict = "[correlate]\naccept_percent = 1e-6\n"
    study = small_study.write_study(tmp_path, small_study.FULL + strict, ambient=False)
    assert command(["run", str(study), "--json", "-"]) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)["acceptance"]
    assert not found["limits"][0]["held"]
    assert err.count("not accepted: test mode") == len(found["missed"]) > 5
    # limits that no stage depends on can be changed without running anything anew
    study.write_text(
        small_study.FULL + strict + "accept_hz = 1.0\naccept_mean_mac = 50.0\n"
    )
    assert command(["run", str(study)]) == 0
    out, err = capsys.readouterr()
    assert "up to date" in out
    assert not re.search(r": \d+\.\d s\n", out)
    assert re.search(r"yes +final model: mean subspace MAC", out)
    assert "not accepted" not in err


# --- what the report shows of a roving test


def record(name: str, setup: str, drawn: bool) -> RecordSummary:
    t, y = np.arange(4.0), np.ones((1, 4))
    if drawn:
        preview = RecordPreview(("1+X",), "N", t, y, t, y)
        what = (name, "hammer", "hammer", name)
        return RecordSummary(*what, 9, 512.0, 60.0, ("8 hits",), setup, preview)
    return RecordSummary(
        name, "hammer", "hammer", name, 7, 512.0, 90.0, ("9 hits",), setup
    )


def test_every_setup_of_a_roving_test_is_listed(done: StudyRun) -> None:
    records = tuple(
        record(f"h-{s}-{k}", s, s == "1") for s in ("1", "2", "3") for k in range(2)
    )
    found = replace(done.results["identify"], records=records)
    data = Stages(StudyInfo(), Acceptance(), identify=found)
    section = system.survey(data)
    assert section is not None
    table = next(
        b
        for b in section.blocks
        if isinstance(b, ReportTable) and "Record" in b.heads[1]
    )
    assert [row[1] for row in table.rows] == [f"setup {s}, 2 records" for s in "123"]
    assert [row[5] for row in table.rows] == ["2.0", "3.0", "3.0"]
    notes = next(b for b in section.blocks if isinstance(b, Items))
    assert (
        notes.items[1] == "setup 2, 2 records; setup 3, 2 records: 9 hits (2 records)"
    )
    signals = system.signal_section(data)
    assert signals is not None
    text, *plots = signals.blocks
    assert "Setup 1 of 1, 2 and 3" in text.text  # type: ignore[union-attr]
    assert len(plots) == 2


@pytest.mark.parametrize("method", ["hybrid", "serep"])
def test_test_shapes_are_expanded_as_asked_for(
    done: StudyRun, tmp_path: Path, method: str
) -> None:
    """The truth is another deck, but its shapes at the nodes between the sensors are close to those
    of this one.
    """
    asked = f'[correlate]\nexpand = "{method}"\ntam = "craig-bampton"\n'
    shutil.copytree(done.folder, tmp_path / "s")
    study = tmp_path / "s/study.toml"
    study.write_text(study.read_text() + asked)
    run = run_study(study, until="localise")
    deliver(run)
    found = run.results["correlate"].expanded
    assert found.misfit.max() < 0.1
    fe, table = run.results["model"].modes, run.results["correlate"].initial.pairing
    like = paired_mac(found.modes.shapes[:, table.a], fe.shapes[:, table.b])
    assert like[:3].min() > 0.95
    told = json.loads((run.folder / "summary.json").read_text())
    assert told["expansion"]["method"] == method
    named = [k["name"] for k in told["evidence"]["remodelled"]["orthogonality"]]
    assert "cross-orthogonality, Craig-Bampton mass" in named
    own = next(
        c
        for c in run.results["correlate"].evidence.measures.checks
        if c.kind == "model"
    )
    assert own.verdict.passed
    assert run.results["localise"].indicators.expansion == method
    assert (
        run.results["localise"].indicators.misfit.size
        == run.results["localise"].indicators.modes.size
    )


def test_the_conclusion_says_where_frfs_or_damping_are_worse(done: StudyRun) -> None:
    evidence = final(done)
    frfs = evidence.frfs
    assert frfs is not None
    assert frfs.worse == ()
    exchanged = replace(frfs, initial=frfs.final, final=frfs.initial)
    stages = dict(done.results)
    stages["final"] = replace(
        stages["final"], evidence=replace(evidence, frfs=exchanged)
    )
    stages["damping"] = replace(stages["damping"], why="FRFs are worse")
    found = conclude(stages, (), Acceptance())
    assert found is not None
    questions = {q.code: q.values for q in found.questions}
    assert questions["FRFs worse"]["count"] == len(frfs.final.inputs)
    assert "damping refused" in questions
    before = conclude(done.results, (), Acceptance())
    assert before is not None
    assert not {"FRFs worse", "damping refused"} & {q.code for q in before.questions}
