"""The public contract of a modal solver: a plug-in's test calls `check_modal_solver(solver,
model)`.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.modes import Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.model.model import Model
from ringtrue.model.ports import Analysis, ModalSolver, ModesRequest, ModesResult

KNOWN = {"modes", "derivatives", "frf", "static", "complex_modes"}
RESIDUAL = 1e-5  # an external program prints or stores single precision


def check_modal_solver(
    solver: ModalSolver,
    model: Model,
    *,
    count: int = 6,
    parameters: ParameterSet | None = None,
) -> ModesResult:
    """Check what every backend owes; returns the modes for further checks.

    Parameters
    ----------
    solver : ModalSolver
    model : Model
        Any small model with at least `count` modes.
    parameters : ParameterSet, optional
        Where the solver has derivatives, they are checked for shape and finiteness, too.

    Raises
    ------
    AssertionError
        Saying which duty is not met.
    """
    assert isinstance(solver, ModalSolver), (
        f"{type(solver).__name__} has no name or open()"
    )
    assert solver.name, "the solver has no name"
    with solver.open(model) as analysis:
        assert isinstance(analysis, Analysis), (
            f"{type(analysis).__name__} is not an Analysis"
        )
        unknown = set(analysis.capabilities) - KNOWN
        assert "modes" in analysis.capabilities, "'modes' is not among the capabilities"
        assert not unknown, f"unknown capabilities {sorted(unknown)}"
        result = analysis.modes(ModesRequest(count))
        _check_modes(analysis, result, count)
        again = analysis.modes(ModesRequest(count)).modes
        same = np.allclose(
            again.frequencies, result.modes.frequencies, rtol=1e-09, atol=1e-09
        )
        assert same, "the same request gave other frequencies"
        _check_band(analysis, result)
        if parameters is not None and "derivatives" in analysis.capabilities:
            _check_derivatives(analysis, result, parameters)
    return result


def _check_modes(analysis: Analysis, result: ModesResult, count: int) -> None:
    m = result.modes
    assert len(m) == count, f"{count} modes asked for, {len(m)} returned"
    assert m.labels is analysis.dofs or m.channels == analysis.dofs.labels(), (
        "shapes are on other DOFs"
    )
    assert not np.iscomplexobj(m.shapes), "natural modes must be real"
    assert np.isfinite(m.shapes).all(), "shapes are not finite"
    assert np.isfinite(m.frequencies).all(), "frequencies are not finite"
    assert m.norm is Norm.MASS, f"norm {m.norm}; must be mass"
    assert (np.diff(m.frequencies) >= 0).all(), "frequencies are not ascending"
    assert (m.damping == 0).all(), "an undamped mode has damping"
    assert result.residuals.shape == (count,), (
        f"residuals {result.residuals.shape}; must be ({count},)"
    )
    assert not (result.residuals > RESIDUAL).any(), (
        f"a residual of {result.residuals.max():.1e}"
    )
    assert result.proof, "no word about what was counted"
    nodes, sizes = np.unique(analysis.dofs.node, return_counts=True)
    assert np.isin(sizes, (1, 6)).all(), (
        f"node {nodes[~np.isin(sizes, (1, 6))][:1]} has not all of its six DOFs"
    )


def _check_band(analysis: Analysis, result: ModesResult) -> None:
    f = result.modes.frequencies
    elastic = f[f > 1e-3 * f[-1]]
    if elastic.size < 2 or not elastic[-2] < elastic[-1] * (1 - 1e-6):
        return
    low = elastic[0] * (1 - 1e-4)
    high = (elastic[-2] + elastic[-1]) / 2
    band = analysis.modes(ModesRequest(band=(float(low), float(high)))).modes
    want = f[(f >= low) & (f <= high)]
    assert len(band) == want.size, (
        f"{want.size} modes in the band, {len(band)} returned"
    )
    assert np.allclose(band.frequencies, want, rtol=1e-6), (
        "a band request gives other frequencies than a count"
    )


def _check_derivatives(
    analysis: Analysis, result: ModesResult, parameters: ParameterSet
) -> None:
    modes = result.modes
    d_lambda, d_phi = analysis.derivatives(modes, parameters)
    m = len(modes)
    p = len(parameters)
    assert d_lambda.shape == (m, p), f"d_lambda {d_lambda.shape}; must be {(m, p)}"
    assert d_phi.shape == (len(analysis.dofs), m, p), (
        f"d_phi {d_phi.shape}; must be {(len(analysis.dofs), m, p)}"
    )
    assert np.isfinite(d_lambda).all(), "eigenvalue derivatives are not finite"
    assert np.isfinite(d_phi).all(), "eigenvector derivatives are not finite"
