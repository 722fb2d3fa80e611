"""The report: built from any subset of stages, and drawn without complaint by a browser that is
offline.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import chromium
import fake_study
import numpy as np
import plotly.graph_objects as go
import pytest
from fake_study import study

from ringtrue.core.modes import OtherCandidates
from ringtrue.core.notes import Note
from ringtrue.demos.lsf.demo import checks
from ringtrue.errors import ConfigError, InputError
from ringtrue.plots.correlation import labels
from ringtrue.plots.diagram import auto_mac
from ringtrue.plots.style import joined
from ringtrue.report.build import Acceptance, Photo, assemble, figure_json
from ringtrue.report.parts import fixed, number, signs
from ringtrue.study.config_sections import InstrumentSection, StudyInfo
from ringtrue.study.results import IdentifyStage

PIXEL = (
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01\x00\x00\x00\x01\x08\x06\x00\x00\x00\x1f\x15\xc4\x89\x00\x00\x00\r"
    b"IDATx\x9cc`\xf8\xcf\xf0\x1f\x00\x05\x00\x01\xff\x89\x99=\x1d\x00\x00\x00\x00IEND\xaeB`\x82"
)
needs_browser = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the drawing of the report is NOT tested",
)


@pytest.fixture(scope="module")
def stages() -> dict[str, object]:
    return study()


def ids(page: Path) -> list[str]:
    return re.findall(r'<section id="(\w+)">', page.read_text())


@pytest.fixture(scope="module")
def full(stages: dict[str, object], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    (folder / "bay.png").write_bytes(PIXEL)
    photos = [Photo(folder / "bay.png", "The bay.")]
    text = "A test bay.\n\nIts model is to predict."
    return assemble(
        stages,
        info=StudyInfo(title="Spinning <bay>", system=text),
        photos=photos,
        checks=checks(stages),
    ).write(folder / "report.html")


def test_has_every_section_and_stays_small(
    full: Path, stages: dict[str, object]
) -> None:
    want = (
        "conclusion summary survey model plan signals frfs identification diagrams tests initial "
        "remodelled localisation sensitivities"
    )
    rest = "updating suspension final shapes uncertainty response damping prediction provenance"
    assert ids(full) == [*want.split(), *rest.split()]
    assert full.stat().st_size < 15e6
    text = full.read_text()
    assert "Spinning &lt;bay&gt;" in text
    assert "data:image/png;base64," in text
    for check in checks(stages):
        assert f"<b>{check.got}</b>" in text
    assert [p.name for p in full.parent.iterdir() if p.name.endswith(".part")] == []


@pytest.mark.parametrize(
    ("names", "present", "absent"),
    [
        (
            ("model",),
            {"summary", "survey", "model", "shapes"},
            {"signals", "initial", "final", "plan"},
        ),
        (
            ("identify", "provenance"),
            {"signals", "frfs", "identification", "shapes"},
            {"model", "initial"},
        ),
        (
            ("model", "identify", "correlate"),
            {"initial", "remodelled"},
            {"final", "updating", "tests"},
        ),
        ((), set(), {"summary"}),
    ],
)
def test_leaves_out_what_was_not_run(
    stages: dict[str, object],
    tmp_path: Path,
    names: tuple[str, ...],
    present: set[str],
    absent: set[str],
) -> None:
    there = set(
        ids(
            assemble({n: stages[n] for n in names}, info=StudyInfo(title="part")).write(
                tmp_path / "r.html"
            )
        )
    )
    assert present <= there
    assert not absent & there


def test_a_test_without_a_model_starts_with_its_modes_of_all_classes(
    stages: dict[str, object], tmp_path: Path
) -> None:
    identify = stages["identify"]
    assert isinstance(identify, IdentifyStage)
    ambient = identify.ambient
    one = ambient.modes.take([0])
    note = Note(
        "candidate orders", "information", "0.52 Hz", {"orders": 3, "tried": 10}
    )
    std = ambient.uncertainty.take([0])
    others = OtherCandidates(one, std, ("doubtful",), (note,))
    first = identify.records[0]
    many = tuple(replace(first, name=f"h{k:02}") for k in range(62))
    stage = replace(identify, ambient=replace(ambient, others=others), records=many)
    page = assemble({"identify": stage}, info=StudyInfo(title="mast")).write(
        tmp_path / "r.html"
    )
    order = ids(page)
    assert order[:4] == ["summary", "identification", "shapes", "diagrams"]
    assert order[-1] == "signals"
    text = page.read_text()
    assert "Modal test report" in text
    assert "▽ doubtful" in text
    assert "3 of 10 model orders show it" in text
    assert text.count("time preview and power spectral density") == 4
    assert "Not drawn: h04" in text


def test_natural_modes_have_the_same_numbers_in_matrix_and_table(
    stages: dict[str, object],
) -> None:
    identify = stages["identify"]
    assert isinstance(identify, IdentifyStage)
    ambient = identify.ambient
    note = Note(
        "candidate orders", "information", "0.52 Hz", {"orders": 3, "tried": 10}
    )
    others = OtherCandidates(
        ambient.modes.take([0]), ambient.uncertainty.take([0]), ("doubtful",), (note,)
    )
    shown = replace(ambient, others=others).diagram
    names = auto_mac(shown).data[0].y
    natural = [
        name
        for name, kind in zip(names, shown.classes, strict=True)
        if kind == "natural"
    ]
    assert natural == labels(ambient.modes.frequencies)
    assert len(set(names)) == len(natural) + 1


def test_a_test_without_scatter_is_not_called_exact(
    stages: dict[str, object], tmp_path: Path
) -> None:
    """A file of frequencies states no standard deviations: the quotient with them has no meaning."""
    s = stages["uncertainty"]
    parts = s.bands.parts.copy()
    parts[:, 1] = 0.0
    silent = {"uncertainty": replace(s, bands=replace(s.bands, parts=parts))}
    page = (
        assemble(silent, info=StudyInfo(title="silent"))
        .write(tmp_path / "r.html")
        .read_text()
    )
    assert "is the discrepancy of the model" in page
    assert "times more exact" not in page


def test_settings_in_notes_are_quoted() -> None:
    assert signs("with `refine = 1`: -3 %") == "with “refine = 1”: −3 %"


def test_names_of_modes_stand_in_tables_and_views_and_instruments_are_listed(
    stages: dict[str, object], tmp_path: Path
) -> None:
    hammer = InstrumentSection(name="Hammer 5.5 kg", serial="123", channels=["F:1+Z"])
    sensor = InstrumentSection(name="Accelerometer", calibrated="2026-03-02, K 17")
    info = StudyInfo(
        title="named", names={"2": "first bending"}, instrument=[hammer, sensor]
    )
    page = assemble(stages, info=info).write(tmp_path / "r.html").read_text()
    tables = re.findall(r"<table>.*?</table>", page, re.DOTALL)
    assert sum("first bending" in t for t in tables) >= 3  # hammer test, initial, final
    assert "Hz \u00b7 first bending" in page or "Hz \\u00b7 first bending" in page
    listed = next(t for t in tables if "Hammer 5.5 kg" in t)
    assert "2026-03-02, K 17" in listed
    assert listed.count("not stated") == 1
    with pytest.raises(ConfigError, match=r"names: no test mode 99; there are \d+"):
        assemble(stages, info=StudyInfo(names={"99": "lost"})).write(
            tmp_path / "r.html"
        )
    with pytest.raises(ValueError, match="no number of a test mode"):
        StudyInfo(names={"first": "bending"})


def test_refuses_what_it_does_not_know(
    stages: dict[str, object], tmp_path: Path
) -> None:
    out = tmp_path / "r.html"
    with pytest.raises(InputError, match="no such file"):
        assemble(
            {"model": stages["model"]},
            info=StudyInfo(title=""),
            photos=[Photo(tmp_path / "lost.png", "")],
        ).write(out)
    with pytest.raises(ConfigError, match=r"allowed are .*\.png"):
        assemble(
            {"model": stages["model"]},
            info=StudyInfo(title=""),
            photos=[Photo(tmp_path / "deck.bdf", "")],
        ).write(out)
    assert not list(tmp_path.iterdir())


def test_acceptance_takes_percent_or_hertz_and_mac() -> None:
    rule = Acceptance(percent=2.0, hz=0.1, mac=80.0)
    assert rule.holds(1.9, 5.0, 90.0)
    assert rule.holds(-9.0, -0.05, 90.0)
    assert not rule.holds(3.0, 0.2, 99.0)
    assert not rule.holds(0.0, 0.0, 79.0)
    assert rule.words() == "|Δf| ≤ 2 % or |Δf| ≤ 0.1 Hz and subspace MAC ≥ 80 %"


def test_a_rounded_zero_has_no_sign() -> None:
    assert [fixed(x, 2, sign=True) for x in (-0.004, 0.004, -0.006, 0.006)] == [
        "0.00",
        "0.00",
        "−0.01",
        "+0.01",
    ]


def test_packs_overlaid_curves_within_a_line_width() -> None:
    t = np.linspace(0, 1, 300)
    y = np.sin(np.outer(np.arange(1, 40), t))
    fig = go.Figure(
        go.Scatter(
            **dict(zip("xy", joined(t, y), strict=True)), meta={"overlay": y.shape[0]}
        )
    )
    text = figure_json(fig)
    assert len(text) < 0.3 * len(str(fig.to_json()))
    meta = json.loads(text)["data"][0]["meta"]
    back = (
        np.frombuffer(base64.b64decode(meta["q"]), "<i2").reshape(y.shape)
        * meta["peak"]
        / 32767
    )
    np.testing.assert_allclose(
        back, y, atol=2e-5
    )  # half a step of 16 bits; a line is 1/300 of the height
    np.testing.assert_allclose(
        np.frombuffer(base64.b64decode(meta["x"]), "<f4"), t, atol=1e-6
    )


@pytest.fixture(scope="module")
def page(
    full: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[chromium.Page]:
    with chromium.page(tmp_path_factory.mktemp("profile")) as opened:
        opened.call("Page.navigate", url=full.as_uri())
        yield opened


EXPECTED = "document.querySelectorAll('[data-plot], [data-view]').length"
PRINT = "dispatchEvent(new Event('beforeprint'))"
DRAWN = f"window.ringtrueDrawn === {EXPECTED}"
EMPTY = """[...document.querySelectorAll('[data-plot], [data-view]')].filter(d => {
    const drawing = d.querySelector(d.dataset.plot ? 'svg.main-svg' : 'canvas');
    const box = drawing && drawing.getBoundingClientRect();
    return !box || box.width < 50 || box.height < 50; }).length"""
# Every 3D view shows more than its background.
COLORS = """[...document.querySelectorAll('.view > .stage > canvas')].map(c => {
    const p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, seen = new Set();
    for (let k = 0; k < p.length; k += 64) seen.add(p[k] << 16 | p[k + 1] << 8 | p[k + 2]);
    return seen.size; })"""


@needs_browser
def test_draws_a_figure_as_it_comes_near_and_every_one_to_print(
    full: Path, page: chromium.Page
) -> None:
    assert page.until("window.ringtrueDrawn === 0")
    assert page.evaluate("window.Plotly === undefined")
    page.evaluate("document.querySelector('#updating [data-plot]').scrollIntoView()")
    assert page.until("document.querySelector('#updating svg.main-svg') !== null")
    assert page.evaluate(f"window.ringtrueDrawn < {EXPECTED}")
    page.evaluate("document.querySelector('#shapes details').open = false")
    page.evaluate(PRINT)
    assert page.evaluate(EXPECTED) > 20
    assert page.evaluate(DRAWN)  # at once: the browser does not wait
    assert page.evaluate(EMPTY) == 0
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert not page.evaluate("document.querySelector('#shapes details').open")
    page.evaluate("document.querySelector('nav a[href=\"#shapes\"]').click()")
    assert page.until("document.querySelector('#shapes details').open")
    assert page.complaints() == []
    outside = [
        u
        for u in page.requests()
        if not u.startswith(("data:", "blob:", full.as_uri()))
    ]
    assert outside == []


HOSTILE = (
    "<!--",
    "</script>",
    "<script>",
    "--><b>",
    "a\u2028b",
    "&lt;",
    "'\"",
    "]]>",
    "<!DOCTYPE",
    "${x}",
)


@needs_browser
def test_any_name_of_a_region_leaves_every_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`<!--` before `<script>` made the rest of the page a comment; JSON has no escape for `!`."""
    monkeypatch.setattr(fake_study, "REGIONS", HOSTILE)
    monkeypatch.setattr(
        fake_study, "CANDIDATES", (*HOSTILE, *fake_study.CANDIDATES[len(HOSTILE) :])
    )
    path = assemble(fake_study.study(), info=StudyInfo(title="<!--<script>")).write(
        tmp_path / "r.html"
    )
    with chromium.page(tmp_path / "profile") as opened:
        opened.call("Page.navigate", url=path.as_uri())
        assert opened.until("window.ringtrueDrawn === 0")
        opened.evaluate(PRINT)
        assert opened.evaluate(EXPECTED) > 20
        assert opened.evaluate(DRAWN)
        assert opened.evaluate(EMPTY) == 0
        assert opened.complaints() == []
        legend = opened.evaluate(
            "[...document.querySelectorAll('.legend span')].map(e => e.textContent).join(' ')"
        )
        assert all(name in legend for name in HOSTILE)


@needs_browser
def test_shows_and_moves_the_mode_shapes(page: chromium.Page) -> None:
    page.evaluate(PRINT)
    colors = page.evaluate(COLORS)
    assert len(colors) == 5
    assert min(colors) > 20
    page.evaluate(
        "document.getElementById('shapes').scrollIntoView({behavior: 'instant'})"
    )
    image = "document.querySelector('#shapes canvas').toDataURL().slice(-4000)"
    first = page.evaluate(image)
    assert page.until(f"({image}) !== {first!r}")
    page.evaluate(
        "(() => { const s = document.querySelectorAll('#shapes select')[1]; s.selectedIndex = 3; "
        "s.onchange(); })()"
    )
    assert "FE" in page.evaluate("document.querySelector('#shapes .info').textContent")
    assert page.complaints() == []


@needs_browser
def test_a_figure_is_saved_as_picture_data_and_video(page: chromium.Page) -> None:
    page.evaluate(PRINT)
    page.evaluate(
        "window.saved = {}; HTMLAnchorElement.prototype.click = async function () "
        "{ saved[this.download.split('.').pop()] = await (await fetch(this.href)).text(); }; 0"
    )
    page.evaluate(
        "document.querySelectorAll('#summary .modebar-group:last-child a, "
        "#summary .modebar-group:last-child button').forEach(b => b.click())"
    )
    assert page.until("'png' in saved && 'svg' in saved && 'csv' in saved")
    assert page.evaluate("saved.svg").startswith("<svg")
    heads, first, *_ = page.evaluate("saved.csv").split("\r\n")
    assert '"Test mode, Hz (initial)","Δf, % of the test (initial)"' in heads
    assert re.match(r'"?1: \d+\.\d\d"?,-?\d+(\.\d+)?,', first)
    page.evaluate("document.getElementById('shapes').scrollIntoView()")
    page.evaluate(
        "[...document.querySelectorAll('#shapes button')].find(b => b.textContent === 'WebM')"
        ".click()"
    )
    assert page.until("'webm' in saved")
    assert page.complaints() == []


@needs_browser
def test_the_short_report_leaves_out_what_is_folded(full: Path, tmp_path: Path) -> None:
    seen = (
        "[...document.querySelectorAll('main > section')].filter(s => s.getClientRects().length)"
        ".map(s => s.id)"
    )
    with chromium.page(tmp_path / "profile") as opened:
        opened.call("Page.navigate", url=f"{full.as_uri()}#short")
        assert opened.until("window.ringtrueDrawn === 0")
        short = ["conclusion", "summary", "final", "uncertainty", "prediction"]
        assert opened.evaluate(seen) == short
        opened.evaluate(PRINT)
        assert opened.evaluate(f"window.ringtrueDrawn < {EXPECTED} / 2")
        assert not opened.evaluate(
            "[...document.querySelectorAll('details:not(.whole)')].some(d => d.checkVisibility())"
        )
        opened.evaluate("document.getElementById('short').click()")
        assert opened.evaluate(seen) == ids(full)
        assert opened.complaints() == []


@needs_browser
def test_fits_the_paper(page: chromium.Page) -> None:
    pdf = page.call(
        "Page.printToPDF",
        preferCSSPageSize=True,
        printBackground=True,
        transferMode="ReturnAsStream",
    )
    assert pdf["stream"]
    page.call("IO.close", handle=pdf["stream"])
    assert page.complaints() == []
    wide = (
        "[...document.querySelectorAll('section')].filter(s => s.scrollWidth > s.clientWidth "
        "+ 2).map(s => s.id)"
    )
    assert page.evaluate(wide) == []


def test_the_modes_of_the_deck_are_listed_as_far_as_they_were_correlated(
    stages: dict[str, object], tmp_path: Path
) -> None:
    """Without an fmax the first modes end before anything is known of the test."""
    model, correlated = stages["model"], stages["correlate"]
    early = replace(
        model, modes=model.modes.take([0, 1]), residuals=model.residuals[:2]
    )
    page = (
        assemble(
            {"model": early, "correlate": correlated}, info=StudyInfo(title="Short")
        )
        .write(tmp_path / "r.html")
        .read_text()
    )
    f = correlated.fe_initial.frequencies
    assert len(f) > 2
    assert f">{f.size}, {number(f[0], 3)} to {number(f[-1], 4)}<" in page


@pytest.mark.parametrize("apart", [True, False])
def test_orthogonality_is_judged_only_where_the_mass_keeps_the_modes_of_the_model_apart(
    apart: bool, stages: dict[str, object], tmp_path: Path
) -> None:
    """Too few channels: a verdict on the test would be one on the channels."""
    final = stages["final"]
    measures = final.evidence.measures
    kinds = [
        replace(c, verdict=replace(c.verdict, passed=apart)) for c in measures.checks
    ]
    evidence = replace(final.evidence, measures=replace(measures, checks=tuple(kinds)))
    page = (
        assemble(
            {"final": replace(final, evidence=evidence)},
            info=StudyInfo(title="Few channels"),
        )
        .write(tmp_path / "r.html")
        .read_text()
    )
    assert ("no verdict" in page) != apart
    assert bool(re.search(r"pairs ≥ \d+ %", page)) == apart
