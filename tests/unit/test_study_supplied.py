"""Tests that come as FRFs or as modes, on the small frame; points of the test have numbers of their
own.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_study
from record_files import write_history

from ringtrue.cli.main import run
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.measures import complete
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.table import correlation_table
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import write_modes
from ringtrue.io.records import read_record
from ringtrue.model.ports import ModesRequest
from ringtrue.report.build import deliver
from ringtrue.shapes import auto_mac
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.messages import run_messages
from ringtrue.study.results import CompareStage, Evidence
from ringtrue.study.run import run_study
from ringtrue.virtual.measurements import write_sheet

FREQS = np.arange(0.5, 20.0, 0.02)
TOML = (
    small_study.MODEL
    + '[test]\nsheet = "sensors.csv"\n{}\n'
    + "[update]\nleft_out = 2\n"
)
Capture = pytest.CaptureFixture[str]


def renumbered() -> TestModel:
    """The test model with points 1 to 9, which are nodes elsewhere in the deck or none."""
    test = small_study.test_model()
    new = dict(zip(test.points.tolist(), range(1, 10), strict=True))
    channels = tuple(f"{new[int(c.split('+')[0])]}+{c[-1]}" for c in test.channels)
    points, at = (
        np.array([new[p] for p in x.tolist()]) for x in (test.points, test.at)
    )
    lines = np.stack([points[:-1], points[1:]], axis=1)
    return TestModel(points, test.xyz, channels, at, test.axes, lines)


def true_modes(folder: Path) -> ModeSet:
    """Of the frame as it is, at the channels of the test."""
    (folder / "truth.bdf").write_text(small_study.deck(small_study.TRUTH))
    with EmbeddedSolver().open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(9)).modes
    here = modes.rows(small_study.test_model().channels)
    return replace(here, labels=renumbered().channels, damping=np.full(9, 0.01))


def frfs(modes: ModeSet, struck: tuple[str, ...]) -> FrfSet:
    """Accelerance with a little noise, all channels."""
    at = [modes.channels.index(c) for c in struck]
    w, w0 = 2 * np.pi * FREQS[:, None], 2 * np.pi * modes.frequencies
    gain = -(w**2) / (w0**2 - w**2 + 2j * 0.01 * w0 * w)
    h = np.einsum("om,fm,im->foi", modes.shapes, gain, modes.shapes[at])
    rng = np.random.default_rng(5)
    h = h + 1e-3 * np.abs(h).mean() * (
        rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape)
    )
    out = tuple(Channel(c, "acceleration", "m/s^2") for c in modes.channels)
    into = tuple(Channel(c, "force", "N") for c in struck)
    return FrfSet(
        h, FREQS, out, into, np.full(h.shape, np.nan), np.full(len(at), np.nan)
    )


def study(folder: Path, source: str, toml: str = TOML) -> Path:
    (folder / "deck").mkdir()
    (folder / "deck" / "frame.bdf").write_text(small_study.deck())
    test = renumbered()
    write_sheet(folder / "sensors.csv", test, test.channels)
    (folder / "study.toml").write_text(toml.format(source))
    return folder / "study.toml"


def test_frfs_of_a_file_for_each_reference(tmp_path: Path) -> None:
    modes = true_modes(tmp_path)
    for i, c in enumerate(("7+X", "7+Y"), start=1):
        write_frfs(tmp_path / f"{i}.uff", frfs(modes, (c,)))
    text = TOML + small_study.candidates(small_study.TRUTH)
    done = run_study(
        study(tmp_path, 'frfs = ["1.uff", "2.uff"]\nleave_out = ["5+Y"]', text)
    )
    deliver(done)
    found = done.results["correlate"]
    assert "5+Y" not in found.reference.elastic.channels
    np.testing.assert_allclose(
        found.reference.elastic.frequencies, modes.frequencies, rtol=1e-3
    )
    best = done.results["update"].sets[done.results["update"].chosen]
    for name, factor in zip(best.parameters, best.factor, strict=True):
        assert factor == pytest.approx(
            small_study.TRUTH[int(name.split()[-1])], abs=0.02
        )
    lines = "\n".join(run_messages(done.results))
    assert "9 modes of the FRFs" in lines
    assert "pairs: 9 -> 9 of 9 test modes" in lines
    assert all(f"{n}: times" in lines for n in best.parameters)
    assert "made frequencies worse" not in lines
    end = done.results["final"]  # as if the deck had been good and the updating bad
    turned = replace(found, remodelled=end.table), replace(end, table=found.remodelled)
    assert "made frequencies worse" in "\n".join(
        run_messages(dict(zip(("correlate", "final"), turned, strict=True)))
    )


def test_modes_of_a_file_and_a_sensor_the_wrong_way_round(tmp_path: Path) -> None:
    modes = true_modes(tmp_path)
    turned = np.array(modes.shapes)
    turned[3] *= -1
    write_modes(tmp_path / "test.json", replace(modes, shapes=turned))
    done = run_study(study(tmp_path, 'modes = "test.json"'), until="correlate")
    deliver(done)
    assert len(done.results["correlate"].initial) >= 7
    lines = run_messages(done.results)
    assert f"channel {modes.channels[3]} looks reversed" in lines[-2]
    assert "row in the sensor sheet" in lines[-1]
    sheet = list(csv.reader((tmp_path / "sensors.csv").read_text().splitlines()))
    row = next(r for r in sheet if r[5] == modes.channels[3])
    row[4] = "-" + row[4][1:]  # as it was mounted; its channel keeps its name
    with (tmp_path / "sensors.csv").open("w", newline="") as file:
        csv.writer(file).writerows(sheet)
    again = run_study(tmp_path / "study.toml", until="correlate").results
    assert again["correlate"].initial.mean_mac() > 98
    assert "looks" not in "\n".join(run_messages(again))


def test_a_strain_gauge_of_the_sheet_is_not_used(tmp_path: Path) -> None:
    modes = true_modes(tmp_path)
    shapes = np.array(modes.shapes)
    shapes[3] = np.random.default_rng(0).standard_normal(len(modes))
    write_modes(tmp_path / "test.json", replace(modes, shapes=shapes))
    toml = study(tmp_path, 'modes = "test.json"')
    rows = list(csv.DictReader((tmp_path / "sensors.csv").read_text().splitlines()))
    rows[3] |= {"quantity": "strain", "unit": "ustrain"}
    with (tmp_path / "sensors.csv").open("w", newline="") as file:
        (writer := csv.DictWriter(file, list(rows[3]))).writeheader()
        writer.writerows(rows)
    found = run_study(toml, until="correlate").results
    assert found["correlate"].reference.elastic.channels == tuple(
        c for c in modes.channels if c != modes.channels[3]
    )
    assert f"channel {modes.channels[3]}: measures strain, not used" in "\n".join(
        run_messages(found)
    )


def test_damping_of_a_file_of_modes_reaches_the_regions(tmp_path: Path) -> None:
    """Without standard deviations in the file, too: a ratio of 1 % is a loss factor of 2 %."""
    write_modes(tmp_path / "test.json", true_modes(tmp_path))
    text = TOML.format('modes = "test.json"') + small_study.candidates(
        small_study.TRUTH
    )
    found = run_study(study(tmp_path, "", text)).results["damping"]
    assert not found.why
    np.testing.assert_allclose(found.modes.after, 0.01, rtol=0.1)
    np.testing.assert_allclose(found.regions.coefficients, 0.02, rtol=0.2)


def test_a_channel_that_two_tests_do_not_agree_on_is_told(tmp_path: Path) -> None:
    """Dead in the ambient record alone: the model is compared with the hammer modes, which are
    whole.
    """
    modes = true_modes(tmp_path)
    dead = np.where(np.arange(len(modes.channels)) == 3, 1e-4, 1.0)[:, None]
    one, two = replace(modes, shapes=modes.shapes * dead), modes
    table = correlation_table(one, two, pairing := pair_modes(one, two))
    stage = CompareStage(
        table, Evidence(complete(one, two, pairing), auto_mac(one.shapes))
    )
    lines = run_messages({"compare": stage})
    assert (
        f"channel {modes.channels[3]} looks dead in the ambient against the hammer test"
        in lines[0]
    )
    assert "row in the sensor sheet" in lines[-1]


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("", "a log, frfs or modes"),
        ('modes = "test.json"\nfrfs = ["1.uff"]', "give one of the two"),
        ('modes = "test.json"\nleave_out = ["5+Q"]', r"leave_out '5\+Q'"),
        ('modes = "other.json"', r"channel 99\+X is not on the sensor sheet"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, source: str, told: str) -> None:
    modes = true_modes(tmp_path)
    write_modes(tmp_path / "test.json", modes)
    write_modes(
        tmp_path / "other.json", replace(modes, labels=("99+X", *modes.channels[1:]))
    )
    with pytest.raises((ConfigError, DataError), match=told):
        run_study(study(tmp_path, source), until="identify")


def test_a_roving_hammer_gives_the_shapes_where_it_struck(tmp_path: Path) -> None:
    modes = true_modes(tmp_path)
    fixed = frfs(modes, ("7+X", "7+Y"))
    roving = replace(
        fixed, data=fixed.data.swapaxes(1, 2), coherence=fixed.coherence.swapaxes(1, 2), averages=np.full(18, np.nan),
        outputs=tuple(Channel(c.id, "acceleration", "m/s^2") for c in fixed.inputs),
        inputs=tuple(Channel(c.id, "force", "N") for c in fixed.outputs),
    )  # fmt: skip
    one, two = (identify_hammer(x, HammerModes(fmin=1.0)) for x in (fixed, roving))
    np.testing.assert_array_equal(one.modes.shapes, two.modes.shapes)
    assert two.modes.channels == modes.channels
    assert any(
        "roving hammer: 18 points struck, 2 fixed sensors" in n for n in two.notes
    )
    assert not any("roving" in n for n in one.notes)


def test_points_with_numbers_of_their_own_are_placed_by_the_sheet(
    tmp_path: Path, capsys: Capture
) -> None:
    write_modes(tmp_path / "test.json", true_modes(tmp_path))
    text = (
        small_study.MODEL
        + '[test]\nsheet = "sensors.csv"\n'
        + small_study.candidates(small_study.TRUTH)
    )
    path = str(study(tmp_path, "", text))
    deck, sheet, test = (
        str(tmp_path / f) for f in ("deck/frame.bdf", "sensors.csv", "test.json")
    )
    assert run(["update", path, test, "--json", "-"]) == 0
    factors = [p["factor"] for p in json.loads(capsys.readouterr().out)["parameters"]]
    np.testing.assert_allclose(
        factors, list(small_study.TRUTH.values()), rtol=0.01
    )  # the prior pulls
    assert run(["correlate", test, deck, "--sensors", sheet, "--json", "-"]) == 0
    pairs = json.loads(capsys.readouterr().out)["pairs"]
    assert len(pairs) == 9
    assert min(p["mac_percent"] for p in pairs) > 95
    assert run(["correlate", test, test, "--sensors", sheet]) == 2
    assert "--sensors is for a deck" in capsys.readouterr().err
    assert run(["correlate", test, deck]) == 2
    assert "give --sensors" in capsys.readouterr().err


def test_blows_recorded_as_text(tmp_path: Path) -> None:
    small_study.write_study(tmp_path, ambient=False)
    ours = run_study(tmp_path / "study.toml", until="identify").results["identify"]
    log = json.loads((tmp_path / "data" / "campaign.json").read_text())
    for r in log["tests"][0]["records"]:
        history = read_record(tmp_path / "data" / r["file"])
        r["file"] = r["file"].replace(".h5", ".csv")
        write_history(tmp_path / "data" / r["file"], history)
    (tmp_path / "data" / "campaign.json").write_text(json.dumps(log))
    text = run_study(tmp_path / "study.toml", until="identify").results["identify"]
    np.testing.assert_allclose(
        text.hammer.modes.frequencies, ours.hammer.modes.frequencies, rtol=1e-6
    )


ONE = '[[candidate]]\nname = "b"\ntargets = ["MAT1 1 E"]\n'
ALONE = small_study.MODEL + '[test]\nmodes = "test.csv"\n{}\n'


def frequencies_alone(folder: Path, toml: str, lost: int = 9) -> None:
    """The frame's frequencies without that of one mode, which the test has missed."""
    f = (
        np.delete(true_modes(folder).frequencies, lost)
        if lost < 9
        else true_modes(folder).frequencies
    )
    (folder / "test.csv").write_text(
        "mode,frequency [Hz]\n" + "".join(f"{i},{x:.5f}\n" for i, x in enumerate(f))
    )
    (folder / "deck").mkdir()
    (folder / "deck/frame.bdf").write_text(small_study.deck())
    (folder / "study.toml").write_text(ALONE.format(toml))


def test_a_study_of_frequencies_alone_finds_what_they_tell(tmp_path: Path) -> None:
    frequencies_alone(tmp_path, small_study.candidates((1, 2, 3)), lost=4)
    done = run_study(tmp_path / "study.toml")
    correlate, update, final = (
        done.results[n] for n in ("correlate", "update", "final")
    )
    assert correlate.initial.pairing.b.tolist() == [0, 1, 2, 3, 5, 6, 7, 8]
    assert correlate.reference.left_out.size == 2
    best = update.sets[update.chosen]
    found = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    assert [found[n] for n in sorted(found)] == pytest.approx(
        [*small_study.TRUTH.values()], rel=0.02
    )
    assert final.table.max_deviation() < 0.2
    assert np.isnan(final.table.mean_mac())
    assert final.evidence is None
    assert any(
        "taken for" in line or "by frequency" in line
        for line in run_messages(done.results)
    )
    page = deliver(done).read_text(encoding="utf-8")
    assert "Mean MAC" not in page
    assert "No shapes were measured" in page


def test_frequencies_alone_propose_parameters(tmp_path: Path, capsys: Capture) -> None:
    frequencies_alone(tmp_path, "")
    files = [str(tmp_path / n) for n in ("deck/frame.bdf", "test.csv")]
    assert run(["localise", *files, "--most", "3", "--pool", "14", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {p["name"] for p in found["proposed"]} == {
        "MAT1 1 E",
        "MAT1 2 E",
        "MAT1 3 E",
    }
    assert found["mean_deviation_percent"][1] < 0.3 * found["mean_deviation_percent"][0]
    assert found["mean_mac_percent"] == [None, None]
    assert "by frequency" in found["notes"][0]


def test_a_lock_decides_what_a_frequency_is_in_a_study(tmp_path: Path) -> None:
    frequencies_alone(tmp_path, '[correlate]\nlock = ["1:2"]\nforbid = ["2:3"]')
    done = run_study(tmp_path / "study.toml", until="correlate")
    pairs = done.results["correlate"].initial.pairing
    assert (pairs.a[0], pairs.b[0]) == (0, 1)
    (tmp_path / "study.toml").write_text(ALONE.format(""))
    # what decides it makes it stale
    again = run_study(tmp_path / "study.toml", until="correlate")
    assert again.results["correlate"].initial.pairing.b.tolist() == list(range(9))


@pytest.mark.parametrize(
    ("toml", "names"),
    [
        ('[test]\nmodes = "m.csv"\n', "needs a \\[model\\]"),
        ('[model]\ndeck = "a.bdf"\n[test]\nlog = "c.json"\n', "needs a `sheet`"),
        (
            ALONE.format("[correlate]\naccept_mac = 90"),
            r"\[correlate\] accept_mac asks for shapes",
        ),
        (
            ALONE.format('[update]\nresiduals = ["frequencies", "mac"]'),
            r"\[update\] residuals mac asks for shapes",
        ),
        (
            ALONE.format(ONE + '[[set]]\nname = "a"\nresiduals = ["shapes"]'),
            r"\[\[set\]\] residuals shapes asks for shapes",
        ),
        (
            ALONE.format(
                '[[configuration]]\nname = "a"\ndeck = "a.bdf"\nmodes = "b.csv"'
            ),
            r"\[\[configuration\]\] asks for shapes",
        ),
    ],
)
def test_only_frequencies_need_no_sheet(tmp_path: Path, toml: str, names: str) -> None:
    (tmp_path / "study.toml").write_text(toml)
    with pytest.raises(ConfigError, match=names):
        run_study(tmp_path / "study.toml")


def test_modes_with_shapes_need_the_sheet(tmp_path: Path) -> None:
    frequencies_alone(tmp_path, "")
    write_modes(tmp_path / "test.json", true_modes(tmp_path))
    (tmp_path / "study.toml").write_text(
        ALONE.format("").replace("test.csv", "test.json")
    )
    with pytest.raises(DataError, match="give the `sheet`"):
        run_study(tmp_path / "study.toml", until="identify")


def test_shapes_that_the_deck_lends_are_not_drawn_as_measured(tmp_path: Path) -> None:
    frequencies_alone(tmp_path, "")
    page = deliver(run_study(tmp_path / "study.toml", until="identify")).read_text(
        encoding="utf-8"
    )
    assert "Modes of file test.csv" in page
    assert '"stage":"File test.csv"' not in page
    assert "channels at" not in page


def test_a_study_without_a_pair_rests_on_what_else_was_measured(tmp_path: Path) -> None:
    """Nothing is localised then, so that no proposal is there to start from."""
    write_modes(tmp_path / "test.json", true_modes(tmp_path))
    more = (
        '[correlate]\nfrequency_gate = 0.0005\n[[residual]]\nkind = "mass"\nmass = '
        "100.0\nmass_error = 0.05\n"
    )
    text = (
        TOML.format('modes = "test.json"')
        + more
        + small_study.candidates(small_study.TRUTH)
    )
    done = run_study(study(tmp_path, "", text), until="update")
    assert done.results["localise"] is None
    best = done.results["update"].sets[done.results["update"].chosen]
    np.testing.assert_allclose(best.factor, 1.0)  # moduli have no mass
