"""What the diagram of an identification holds: modes of each class, poles, three singular values."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.modes import ModeSet, OtherCandidates, Uncertainty
from ringtrue.core.notes import Note
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.spectral_bins import SpectrumPeak
from ringtrue.identification.common.diagram import (
    IdentificationDiagram,
    SpectrumAccount,
    identification_diagram,
)
from ringtrue.identification.common.merging import join_candidates
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.io import hdf5
from ringtrue.plots.diagram import SHAPE_BYTES, identification_figure, picker_page
from ringtrue.signal.machines import Machine
from ringtrue.signal.tonal_lines import Harmonic
from ringtrue.study.results import IdentifiedModes


def mode_set(
    f: list[float], shapes: list[list[float]], channels: str = "abc"
) -> ModeSet:
    size = len(f)
    return ModeSet(
        np.array(f), np.full(size, 0.01), np.array(shapes).T, tuple(channels)
    )


def deviations(modes: ModeSet) -> Uncertainty:
    f = modes.frequencies
    return Uncertainty.independent(
        1e-3 * f, 0.1 * modes.damping, np.zeros(modes.shapes.shape)
    )


def candidates(
    f: float, shape: list[float], confidence: float = 0.4
) -> OtherCandidates:
    modes = mode_set([f], [shape])
    modes = ModeSet(
        modes.frequencies,
        modes.damping,
        modes.shapes,
        modes.labels,
        confidence=[confidence],
    )
    note = Note("candidate line", "information", f"{f} Hz", {"why": "mains hum"})
    return OtherCandidates(modes, deviations(modes), ("harmonic",), (note,))


def shown(poles: int = 0) -> IdentificationDiagram:
    rng = np.random.default_rng(0)
    f = rng.uniform(1, 100, poles)
    set_of = PoleSet(
        order=rng.integers(1, 80, poles),
        pole=2 * np.pi * f * (-0.01 + 1j),
        shape=np.ones((3, poles), complex),
        std_frequency=1e-3 * f,
        std_damping=np.full(poles, np.nan),
    )
    cluster = np.where(rng.random(poles) < 0.2, 0, -1)
    level = np.array([[0.0], [-10.0], [-20.0]]) + np.zeros(200)
    lines = np.linspace(1, 100, 200)
    diagram = StableDiagram(set_of, rng.random(poles) < 0.5, cluster, lines, level)
    natural = mode_set([20.0, 5.0], [[1, 0, 0], [1, 1, 0]])
    others = candidates(10.0, [1, 0, 0.1])
    remarks = ("scatters along the record", "")
    return identification_diagram(
        [diagram], (natural, deviations(natural), remarks), others
    )


def page_data(page: str) -> dict[str, object]:
    found = re.search('<script type="application/json" id="data">(.*?)</script>', page)
    assert found is not None
    return dict(json.loads(found[1]))


def test_modes_of_all_classes_stand_in_one_list_by_frequency() -> None:
    found = shown()
    assert found.modes.frequencies.tolist() == [5.0, 10.0, 20.0]
    assert found.classes == ("natural", "harmonic", "natural")
    assert found.remarks == ("", "line of a machine", "scatters along the record")
    assert found.auto_mac[1, 2] == pytest.approx(1 / 1.01)
    assert found.auto_mac[0, 2] == pytest.approx(0.5)
    assert found.uncertainty.frequency == pytest.approx([5e-3, 1e-2, 2e-2])


def test_a_shape_that_is_not_known_has_no_mac() -> None:
    natural = mode_set([5.0], [[1, 1, 0]])
    others = candidates(10.0, [np.nan] * 3)
    found = identification_diagram([], (natural, deviations(natural), ("",)), others)
    assert np.isnan(found.mpc).tolist() == [False, True]
    assert np.isnan(found.auto_mac).tolist() == [[False, True], [True, True]]
    page_data(picker_page("multiples", found))  # JSON has no NaN


def test_candidates_alone_make_a_diagram() -> None:
    nothing = ModeSet(np.empty(0), np.empty(0), np.empty((0, 0)), ())
    natural = (nothing, deviations(nothing), ())
    assert identification_diagram([], natural, candidates(9.0, [1, 0, 0])).classes == (
        "harmonic",
    )


def test_the_figure_has_three_singular_values_and_every_class() -> None:
    fig = identification_figure(shown(400))
    names = [t.name for t in fig.data]
    assert names[:3] == ["singular value 3", "singular value 2", "singular values"]
    assert [float(t.y[0]) for t in fig.data[:3]] == [-20, -10, 0]
    above = {t.name: t for t in fig.data if t.yaxis != "y3"}
    assert above["natural mode"].x.tolist() == [5.0, 20.0]
    assert set(above["harmonic mode"].marker.symbol) == {"diamond-open"}
    assert "line of a machine" in above["harmonic mode"].text[0]
    below = {t.name: t for t in fig.data if t.yaxis == "y3"}
    assert below["natural mode"].error_y.array == pytest.approx([0.1, 0.1])


def test_poles_above_the_panel_of_damping_are_marked_on_its_edge() -> None:
    of = shown(400)
    (diagram,) = of.diagrams
    unstable, taken = (
        np.flatnonzero((diagram.cluster >= 0) == t)[0] for t in (False, True)
    )
    pole = diagram.poles.pole.copy()
    pole[unstable] = pole[unstable].imag * (-0.5 + 1j)
    pole[taken] = pole[taken].imag * (-0.2 + 1j)
    poles = replace(diagram.poles, pole=pole)
    fig = identification_figure(replace(of, diagrams=(replace(diagram, poles=poles),)))
    (edge,) = (t for t in fig.data if t.name == "pole above the axis")
    assert 20 < fig.layout.yaxis3.range[1] < 25  # a pole of a candidate mode is inside
    assert edge.text == (f"{100 * poles.damping[unstable]:.3g}",)
    assert edge.y[0] < fig.layout.yaxis3.range[1]


def test_a_page_holds_every_pole_of_a_large_record_in_a_megabyte() -> None:
    """Twenty bytes a pole and two a channel of its shape, besides the script library."""
    data = page_data(picker_page("large", shown(30_000)))
    assert len(json.dumps(data)) < 1.5e6
    poles = data["poles"]
    assert isinstance(poles, dict)
    kind = np.frombuffer(base64.b64decode(poles["kind"]), "u1")
    assert kind.size == 30_000
    # those with shapes in any case come first
    assert (np.diff(kind.astype(int)) <= 0).all()
    assert len(base64.b64decode(poles["shape"])) == 2 * 3 * 30_000 < SHAPE_BYTES
    assert [m["class"] for m in data["modes"]] == ["natural", "harmonic", "natural"]


def test_a_candidate_of_several_records_counts_once() -> None:
    merged = mode_set([20.0], [[1, 0, 0]])
    of_records = [
        candidates(10.0, [1, 1, 0], 0.2),
        candidates(10.01, [1, 0.9, 0], 0.4),
        candidates(20.05, [1, 0, 0.1]),  # a mode that another record shows
        candidates(20.05, [0, 1, 0]),  # near it, of another shape
    ]
    found = join_candidates(of_records, merged)
    assert found.modes.frequencies.tolist() == [10.01, 20.05]
    assert found.modes.shapes[:, 1].tolist() == [0, 1, 0]
    assert join_candidates(of_records[:1], merged) is of_records[0]


def test_an_ambient_result_draws_the_whole_band() -> None:
    rng = np.random.default_rng(1)
    rate = 64.0
    time = np.arange(int(600 * rate)) / rate
    shapes = np.array([[1.0, 0.8, 0.3, 0.6], [0.5, -1.0, 0.7, 0.2]])
    data = 0.05 * rng.standard_normal((4, time.size))
    for f, shape in zip((2.0, 9.0), shapes, strict=True):
        pole = np.exp((-0.01 * 2 * np.pi * f + 2j * np.pi * f) / rate)
        lags = pole ** np.arange(4096)
        force = rng.standard_normal(time.size)
        response = np.fft.irfft(
            np.fft.rfft(force, 2 * time.size) * np.fft.rfft(lags.imag, 2 * time.size)
        )[: time.size]
        data += shape[:, None] * response / response.std()
    channels = tuple(Channel(c, "acceleration", "m/s^2") for c in "abcd")
    found = rt.identify_ambient(TimeHistory(data, rate, channels))
    assert all(d.level.shape[0] == 3 for d in found.diagrams)
    assert found.diagram.classes.count("natural") == len(found) == 2
    low, high = found.diagram.span
    assert low < 2.0 < 9.0 < high
    fig = found.plot()
    first = next(t for t in fig.data if t.name == "singular values")
    peak = float(first.x[np.argmax(first.y)])
    assert min(abs(peak / f - 1) for f in found.frequencies) < 0.02


def test_singular_values_of_two_bands_join_without_a_step() -> None:
    """Both have the spectrum -10 dB a decade, with references of their own."""

    def band(low: float, high: float, reference: float) -> StableDiagram:
        nothing = PoleSet(
            np.empty(0, int), np.empty(0), np.empty((3, 0)), np.empty(0), np.empty(0)
        )
        lines = np.geomspace(low, high, 300)
        level = reference - 10 * np.log10(lines) - np.array([[0.0], [6.0], [12.0]])
        return StableDiagram(nothing, np.empty(0, bool), np.empty(0, int), lines, level)

    natural = mode_set([2.0, 80.0], [[1, 0, 0], [1, 1, 0]])
    parts = [band(8, 90, 0.0), band(1, 20, 35.0)]
    found = identification_diagram(
        parts, (natural, deviations(natural), ("", "")), OtherCandidates.none("abc")
    )
    lines, level = found.singular_value(1)
    assert (np.diff(lines) > 0).all()
    assert level == pytest.approx(-10 * np.log10(lines) - 6, abs=0.01)
    assert lines[0] < 2.1
    assert lines[-1] > 79


def test_a_stored_study_has_all_classes_machines_and_unexplained_peaks(
    tmp_path: Path,
) -> None:
    natural = mode_set([5.0], [[1, 1, 0]])
    machine = Machine(
        np.arange(4.0), 6 * np.arange(4.0), np.array([1, 2, 5]), 3, 9, 0.1
    )
    peak = SpectrumPeak(3.8, 0.05, 2, 12.0)
    account = SpectrumAccount((Harmonic(50.0, "mains hum"),), (machine,), (peak,))
    std = deviations(natural)
    found = IdentifiedModes(
        natural,
        std,
        remarks=("few",),
        others=candidates(10.0, [1, 0, 0]),
        account=account,
    )
    with h5py.File(tmp_path / "s.h5", "w") as f:
        hdf5.save(f.create_group("stage"), found)
        again = hdf5.load(f["stage"])
    assert again.diagram.classes == ("natural", "harmonic")
    assert again.diagram.remarks == ("few", "line of a machine")
    assert again.account.lines.tolist() == [6.0, 12.0, 30.0, 50.0]
    assert again.account.unexplained == (peak,)
