"""The public interface: its names, its imports, and results that show and draw themselves."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import ringtrue as rt

FRAME = (
    Path(__file__).parents[3]
    / "shared/data/updating/concrete_frame/ConcreteBuildingFrame.mat"
)
FUNCTIONS = """
    at_factors check_deck correlate estimate_frfs example_deck fit_damping frf identify_ambient
    identify_ambient_setups identify_frfs inspect_file localise modes_of_test open_study parameter
    place_sensors plan_test predict read_deck read_deflections read_frfs read_modes
    read_record read_sensors reduce_model region_parameters run_study solve_modes
    static trial_model trial_plan     tune_suspension update write_deck write_modes
"""
TYPES = """
    Channel CorrelateSettings FrfSet InputError MatrixModel NumericalError ParameterSet PlanSettings
    PredictSettings ReductionSettings RingtrueError SolverError TestedModel TimeHistory
    UnsupportedError UpdateSettings
"""


def test_the_public_names_are_these() -> None:
    assert sorted(rt.__all__) == sorted(FUNCTIONS.split() + TYPES.split())
    for name in rt.__all__:
        assert getattr(rt, name).__doc__, name
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = rt.no_such_name


def test_an_import_takes_no_heavy_part() -> None:
    code = "import sys, ringtrue; print([m for m in ('numpy', 'scipy') if m in sys.modules])"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip() == "[]"


@pytest.mark.parametrize("name", FUNCTIONS.split())
def test_options_have_names(name: str) -> None:
    parameters = inspect.signature(getattr(rt, name)).parameters.values()
    positional = [p for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert len(positional) <= 3


def test_results_show_themselves_with_units() -> None:
    fe = rt.solve_modes(rt.read_deck(rt.example_deck()), band=(0, 100))
    html = fe._repr_html_()
    assert "frequencies [Hz]" in html
    assert "2.2399" in html
    assert fe.proof in html
    assert f"proof: {fe.proof}" in str(fe).splitlines()
    pairs = rt.correlate(fe.at(["2+X", "4+X"]), fe).table
    head, first = str(pairs).splitlines()[1:3]
    assert head.split()[:5] == ["#", "test", "fe", "test", "[Hz]"]
    assert first.split()[:4] == ["1", "1", "1", "2.2399"]
    assert "deviation [%]" in head
    assert (
        "rate [Hz]"
        in rt.TimeHistory(np.zeros((1, 9)), 8.0, (rt.Channel("1+Z"),))._repr_html_()
    )


def test_results_draw_themselves() -> None:
    model = rt.read_deck(rt.example_deck())
    fe = rt.solve_modes(model, band=(0, 100))
    names = ["2+X", "3+X", "4+X"]
    record = rt.TimeHistory(
        np.random.default_rng(0).standard_normal((1, 99)), 8.0, (rt.Channel("1+Z"),)
    )
    h = rt.frf(model, np.linspace(1, 12, 50), forces="4+X", damping=0.01)
    for result in (rt.correlate(fe.at(names), fe), record, h, rt.identify_frfs(h)):
        assert len(result.plot().data) > 0
    assert len(fe.plot().payload["modes"]) == len(fe.frequencies)
    pull = rt.static(model, forces={"4+X": 100.0})
    with pytest.raises(rt.UnsupportedError, match="no drawing"):
        pull.plot()


def test_a_deck_is_written_with_its_factors(tmp_path: Path) -> None:
    model = rt.read_deck(rt.example_deck())
    foot = rt.ParameterSet((rt.parameter("foot", "PELAS 1 K"),))
    (written,) = rt.write_deck(
        rt.at_factors(model, foot, np.array([0.7])), tmp_path / "new"
    )
    before, after = (
        rt.example_deck().read_text().splitlines(),
        written.read_text().splitlines(),
    )
    assert [b for a, b in zip(before, after, strict=True) if a != b] == [
        "PELAS,1,700.0"
    ]


def test_two_configurations_share_a_parameter() -> None:
    model = rt.read_deck(rt.example_deck())
    names = ("foot", "head")
    every = rt.ParameterSet(
        tuple(
            rt.parameter(n, f"PELAS {i} K") for n, i in zip(names, (1, 3), strict=True)
        )
    )
    truth = np.array([0.7, 1.3])
    heavier = model.with_values("CONM2", "M", np.array([24]), np.array([1.5]))
    tests = [
        rt.TestedModel(
            m, rt.solve_modes(rt.at_factors(m, every, truth)).at(["2+X", "4+X"])
        )
        for m in (model, heavier)
    ]
    result = rt.update(tests, None, every)
    np.testing.assert_allclose(result.factors, truth, rtol=1e-3)
    assert len(result.models) == 2
    assert (result.low < truth).all()
    assert (result.high > truth).all()


def test_a_published_frame_of_bare_matrices_is_updated_in_twelve_lines() -> None:
    """The concrete frame of Georgia Tech: 2302 DOFs, 43 of them measured, 12 stiffness groups."""
    if not FRAME.is_file():
        pytest.skip(f"{FRAME} is not here: the published frame is not updated")
    given = loadmat(FRAME)
    parts = [given[f"E_{i}"] for i in range(1, 13)]
    frame = rt.MatrixModel(given["K0"], given["M0"], stiffness=parts)
    rows = given["measDOFs"].ravel().astype(int)
    parameters = frame.parameters(lower=0.5, upper=1.7, std=0.3)
    truth = np.linspace(0.8, 1.25, 12)
    modes = rt.solve_modes(frame.at(parameters, truth), count=6)
    test = rt.modes_of_test(
        modes.frequencies,
        modes.shapes[rows - 1],
        rows,
        std_frequency=1e-4 * modes.frequencies,
    )
    settings = rt.UpdateSettings(
        discrepancy="assumed", frequency_error=1e-4, mac_error=1e-4
    )
    result = rt.update(
        frame, test, parameters, shape_std=np.full(rows.size, 0.01), settings=settings
    )
    assert result.outcome.ok
    np.testing.assert_allclose(result.factors, truth, rtol=0.02)


def test_private_modules_say_so() -> None:
    assert "private to the project" in (
        importlib.import_module("ringtrue").__doc__ or ""
    )


def test_the_modules_of_the_names_are_those_that_the_types_are_checked_with() -> None:
    text = Path(rt.__file__ or "").read_text(encoding="utf-8")
    checked = text[text.index("if TYPE_CHECKING") : text.index("_PLACES")]
    for module, _ in rt._WHERE.values():
        assert f"from ringtrue.{module} import" in checked, module


def test_a_path_is_no_model() -> None:
    with pytest.raises(rt.InputError, match=r"rt\.read_deck"):
        rt.solve_modes(rt.example_deck())  # type: ignore[arg-type]
