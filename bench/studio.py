"""The studio: a slider to all frequencies and MAC, the first picture, a click to its shape, memory.

    python bench/studio.py [--quick]

The deck of the worked example (39,000 degrees of freedom; quick: the frame of three storeys), whose
test is its own modes at other factors, is run to its correlation. Factors drawn within the bounds
are tried on the reduced model, as a slider of the studio does on the server; it is right if
frequencies and MAC are those of full solutions to within what the basis states of itself. The
page is opened in headless Chromium, up to its first matrix with pairs; pairs are clicked, up to the
moment at which the view has the shapes, at rest and in motion (frames are drawn by the processor
here and wait for each other). Memory is that of the server at its largest. Not covered: the
network, and graphics cards.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from outcome import ROOT, Check, Report, arguments, at_most

import ringtrue as rt
from ringtrue.api.trial import Trial
from ringtrue.demos import frame
from ringtrue.demos.lsf import facility
from ringtrue.demos.lsf.facility import Builder
from ringtrue.demos.lsf.spec import Spec
from ringtrue.demos.lsf.study import access, candidates, write_facility

sys.path.insert(0, str(ROOT / "tests" / "browser"))
import chromium

TRIALS = 40  # of factors, timed
FULL = 2  # of them, solved fully
# the estimate takes the flexibility of the deck for that at the factors, which may be twice as soft
OVER_ESTIMATE = 3.0
MAC_MOST = 0.03  # of pairs whose shapes are off by a per mille
POINTS = 60  # of the sensor sheet
CLICKS = 10
# Clicks a row of the pairs; milliseconds until the view has its shapes.
VIEW = "[...document.querySelectorAll('*')].map((e) => e.ringtrueView).find(Boolean)"
CLICK = f"""((row) => new Promise((done) => {{
  const view = {VIEW}, show = view.show, begin = performance.now();
  view.show = (state) => {{
    show.call(view, state);
    if (!state.mode) return;
    view.show = show;
    done(performance.now() - begin);
  }};
  document.querySelectorAll('tbody tr')[row].firstElementChild.click();
}}))"""


def states_itself(error: float, estimate: float, mac: float) -> tuple[Check, Check]:
    """A trial against its full solution: largest relative frequency error over what the basis
    states, and largest difference of subspace MAC.
    """
    return (
        at_most(
            "frequency off, over the stated error", error / estimate, OVER_ESTIMATE
        ),
        at_most("MAC off a full solution", mac, MAC_MOST),
    )


def _mac_off(trial: Trial, full: Trial) -> float:
    """Largest difference of the subspace MAC of the pairs that both have; close modes turn within
    their subspace at the smallest change.
    """
    one, other = (
        dict(zip(t.pairs.pairing.a, t.pairs.pairing.mac, strict=True))
        for t in (trial, full)
    )
    both = one.keys() & other.keys()
    assert len(both) >= 0.9 * len(other), "pairs are lost"
    return max(abs(float(one[k] - other[k])) for k in both)


def facility_study(folder: Path) -> Path:
    """The deck of the worked example; its test are its modes at drawn factors."""
    built = facility.build(Spec())
    main = write_facility(built, folder / "deck", "Large spinning facility")
    channels = _write_sheet(folder / "sensors.csv", built)
    regions = candidates()
    parameters = rt.ParameterSet(
        tuple(rt.parameter(name, *targets) for name, targets in regions)
    )
    truth = np.exp(np.random.default_rng(1).normal(0, 0.2, len(regions)))
    model = rt.at_factors(rt.read_deck(main), parameters, truth)
    modes = rt.solve_modes(model, band=(0, 40)).at(channels)
    rt.write_modes(folder / "modes.json", modes)
    lines = [
        f'[model]\ndeck = "deck/{main.name}"\nfmax = 54.0',
        '[test]\nsheet = "sensors.csv"\nmodes = "modes.json"',
    ]
    for name, targets in regions:
        lines.append(f'[[candidate]]\nname = "{name}"\ntargets = {json.dumps(targets)}')
    (folder / "study.toml").write_text("\n".join(lines) + "\n")
    return folder / "study.toml"


def _write_sheet(path: Path, built: Builder) -> list[str]:
    """Triaxial points spread over the nodes that a crew can reach."""
    nodes = [n for some in access(built).values() for n in some]
    place = dict(zip(built.ids, built.xyz, strict=True))
    chosen = nodes[:: max(1, len(nodes) // POINTS)]
    rows = ["point,x,y,z,direction"]
    for n in chosen:
        x, y, z = place[n]
        rows += [f"{n},{x},{y},{z},+{axis}" for axis in "XYZ"]
    path.write_text("\n".join(rows) + "\n")
    return [f"{n}+{axis}" for n in chosen for axis in "XYZ"]


def pictured(study: Path) -> tuple[dict[str, float], int]:
    """Seconds from the address to the first matrix with its pairs, in an open browser that was
    never there and once more; milliseconds from a click to its shape, in motion and at rest; the
    server's memory, GB; and complaints of the browser.
    """
    command = [sys.executable, "-m", "ringtrue", "studio", str(study), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().split()[-1]
            time.sleep(5)  # it reads what is stored
            cost, complaints = _visited(address)
            status = Path(f"/proc/{server.pid}/status")
            if status.exists():
                rows = dict(
                    r.split(":", 1) for r in status.read_text().splitlines() if ":" in r
                )
                cost["GB"] = float(rows["VmHWM"].split()[0]) / 1e6
        finally:
            server.terminate()
    return cost, complaints


def _visited(address: str) -> tuple[dict[str, float], int]:
    screen = urlsplit(address)._replace(path="/correlation").geturl()
    drawn = "!!document.querySelector('.js-plotly-plot .hm') && !!document.querySelector('td')"
    cost: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        chromium.page(Path(profile)) as page,
    ):
        time.sleep(3)  # the browser's own start is no part of the page's
        for visit in ("s", "s again"):
            # a page in motion takes time to leave
            page.call("Page.navigate", url="about:blank")
            page.until(
                "location.href === 'about:blank' && document.readyState === 'complete'"
            )
            begin = time.perf_counter()
            page.call("Page.navigate", url=screen)
            assert page.until(drawn, 120, every=0.02), "no picture"
            cost[visit] = time.perf_counter() - begin
        cost["ms, click to shape in motion"] = _clicked(page)
        page.evaluate(f"{VIEW}.pause()")
        cost["ms, click to shape at rest"] = _clicked(page)
        return cost, len(page.complaints())


def _clicked(page: chromium.Page) -> float:
    """Median of the milliseconds from a click on a pair to its shapes."""
    pairs = int(page.evaluate("document.querySelectorAll('tbody tr').length"))
    spent = []
    for click in range(1 + CLICKS):
        time.sleep(0.5)  # what the click before it draws
        spent.append(float(page.evaluate(f"{CLICK}({click % pairs})")))
    return float(np.median(spent[1:]))  # nothing is selected before the first


def main() -> None:
    """Prepare, try, open."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.quick:
            study = frame.write_study(folder, frame.DEMO, ambient=False)
        else:
            study = facility_study(folder)
        rt.run_study(study, until="correlate")
        begin = time.process_time()
        model = rt.trial_model(study)
        made = time.process_time() - begin
        low, high = model.parameters.bounds()
        rng = np.random.default_rng(0)
        model.shape({}, 0)  # what follows from the deck alone is made once
        model.objective({})
        spent = []
        followed = []
        points = []
        for _ in range(TRIALS):
            # as far as an updating goes: half of the way to the bounds
            x = 0.5 * rng.uniform(low, high)
            factors = model.parameters.factors(x)
            points.append(
                dict(zip(model.parameters.names, factors.tolist(), strict=True))
            )
            begin = time.process_time()
            model.at(points[-1])
            spent.append(time.process_time() - begin)
            model.objective(points[-1])
            model.shape(points[-1], 0)
            followed.append(time.process_time() - begin)
        for k, point in enumerate(points[:FULL]):
            trial, full = model.at(point), model.full(point)
            off = np.abs(trial.modes.frequencies / full.modes.frequencies - 1)
            checks = states_itself(
                float(off.max()), model.error(point), _mac_off(trial, full)
            )
            times = {"ms": spent, "ms with J and a shape": followed}
            cost = {what: 1e3 * float(np.median(t)) for what, t in times.items()}
            cost = cost | {"s to prepare": made} if not k else {}
            report.row(
                f"slider to {off.size} frequencies and MAC, factors {k + 1}",
                cost,
                checks,
            )
        if chromium.find() is None:
            report.not_run("Chromium", "not installed: no picture")
        else:
            cost, complaints = pictured(study)
            report.row(
                "first picture",
                cost,
                [at_most("complaints of the browser", complaints, 0)],
            )
    report.end()


if __name__ == "__main__":
    for thread in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(thread, "1")
    main()
