"""What errors of form leave open of updated parameters and of frequencies that were not fitted.

The frequencies keep errors of form: z_test − z_model = G dx + h a + δ + e.
Here e are the stated errors of the test; δ is a random field, independent errors of stiffness and
mass everywhere, whose covariance over modes is τ²(SᵀS + TᵀT) with the shares S of strain energy
of the elements and T of kinetic energy of the nodes (Kennedy and O'Hagan 2001; Simoen, De Roeck
and Lombaert 2015); h is what one physical cause would do (a finer mesh, shear flexibility, mass
that is spread), computed with the deck. None and each cause, of each τ, are weighed by their
evidence (Hoeting et al. 1999), and intervals are those of the mixture. A residual cannot show the
part of a form error that parameters imitate; the cause that explains the rest of it can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.updating.problem import Evaluated, Problem
from ringtrue.updating.residuals.modal import Quantity


@dataclass(frozen=True, slots=True)
class FormErrorSettings:
    """How errors of form are weighed.

    Attributes
    ----------
    none : float
        Probability, before the test, that no cause acts.
    scatter : tuple of float
        Standard deviations τ of ln λ that are tried.
    named : float
        Probability of all causes together from which on they are taken to act.
    """

    none: float = 0.5
    scatter: tuple[float, ...] = (
        *(2e-5, 1e-3, 2e-3, 4e-3, 6e-3, 1e-2),
        *(1.4e-2, 2e-2, 3e-2, 4e-2, 6e-2, 0.1),
    )
    named: float = 0.5


FORM_ERRORS = FormErrorSettings()


@dataclass(frozen=True, slots=True, eq=False)
class CauseEffect(FrozenArrays):
    """What one physical cause would do to the model.

    Attributes
    ----------
    cause : str
        In words.
    residual : (r,) float64
        Change of the weighted model data, rows as in `Evaluated.value`.
    modes : (m,) float64
        Change of ln λ of the partner of each test mode; 0 without one.
    std : float
        Standard deviation of its amount before the test.
    """

    cause: str
    residual: Float
    modes: Float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class FormPosterior(FrozenArrays):
    """A mixture over causes and scatters, none first.

    Attributes
    ----------
    parameters : ParameterSet
    x : (p,) float64
        Where the updating has ended.
    causes : tuple of str
        Of each component; "" for none.
    weight : (c,) float64
    shift, std : (c, p) float64
        Of x, by each cause.
    mode_shift, mode_std : (c, m) float64
        Of ln λ of the partner of each test mode against what was or will be measured; NaN without
        one.
    """

    parameters: ParameterSet
    x: Float
    causes: tuple[str, ...]
    weight: Float
    shift: Float
    std: Float
    mode_shift: Float
    mode_std: Float

    def interval(self, level: float = 0.9) -> Float:
        """Central intervals of the factors, (p, 2), cut at the bounds."""
        low, high = self.parameters.bounds()
        ends = self.x[:, None] + self._quantiles(self.shift, self.std, level)
        return np.stack(
            [self.parameters.factors(np.clip(e, low, high)) for e in ends.T], axis=1
        )

    def band(self, level: float = 0.9) -> Float:
        """Central intervals of f_test / f_model, (m, 2)."""
        return np.exp(self._quantiles(self.mode_shift, self.mode_std, level) / 2)

    def _quantiles(self, mean: Float, std: Float, level: float) -> Float:
        """Of the normal mixtures (c, n): (n, 2)."""
        tails = ((1 - level) / 2, (1 + level) / 2)
        columns = zip(mean.T, std.T, strict=True)
        return np.array(
            [[quantile(self.weight, m, s, t) for t in tails] for m, s in columns]
        )

    def flags(self, level: float = 0.9) -> dict[str, str]:
        """Parameters that have taken up an error of form: the updated factor is outside of its own
        interval; with what it would be.
        """
        interval = self.interval(level)
        factors = self.parameters.factors(self.x)
        acting = np.array([bool(c) for c in self.causes], dtype=np.bool_)
        cause = "errors of form"
        if float(self.weight[acting].sum()) > FORM_ERRORS.named:
            cause = self.causes[int(np.where(acting, self.weight, -1.0).argmax())]
        out = {}
        for i, name in enumerate(self.parameters.names):
            low, high = interval[i].tolist()
            if not low <= factors[i] <= high:
                out[name] = f"with {cause} it would be {low:.3g} to {high:.3g}"
        return out


def quantile(weight: Float, mean: Float, std: Float, probability: float) -> float:
    """Of a mixture of normal distributions, (c,) each; NaN where one is."""
    if not np.isfinite(mean).all() or not np.isfinite(std).all():
        return float("nan")
    reach = (
        std * abs(float(ndtri(min(probability, 1 - probability) / weight.size))) + 1e-12
    )
    ends = float((mean - reach).min()), float((mean + reach).max())
    return float(
        brentq(
            lambda t: float(weight @ ndtr((t - mean) / std)) - probability,
            *ends,
            xtol=1e-9,
        )
    )


def form_posterior(
    problem: Problem, at: Evaluated, effects: Sequence[CauseEffect], field: Float
) -> FormPosterior:
    """The parameters of one configuration with errors of form.

    Parameters
    ----------
    problem : Problem
        As it was solved, of one configuration.
    at : Evaluated
        Its end.
    effects : sequence of CauseEffect
    field : (m, m) float64
        Covariance of δ of the partners of all test modes for τ = 1; the mean of its diagonal is 1.
    """
    made = _InLogs.of(problem, at, field)
    likely = (1 - FORM_ERRORS.none) / max(len(effects), 1)
    every = [(None, FORM_ERRORS.none), *((e, likely) for e in effects)]
    both = [(e, p, t) for e, p in every for t in FORM_ERRORS.scatter]
    fits = [made.fit(e, t) for e, _, t in both]
    rest = np.array([f.deviance for f in fits])
    weight = np.array([p for _, p, _ in both]) * np.exp((rest.min() - rest) / 2)
    link = problem.link
    return FormPosterior(
        parameters=problem.parameters,
        x=at.x,
        causes=tuple("" if e is None else e.cause for e, _, _ in both),
        weight=weight / weight.sum(),
        shift=np.stack([link @ f.step for f in fits]),
        std=np.stack(
            [np.sqrt(np.einsum("pq,qr,pr->p", link, f.covariance, link)) for f in fits]
        ),
        mode_shift=np.stack([f.mode_shift for f in fits]),
        mode_std=np.stack([f.mode_std for f in fits]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Component:
    """−2 ln of the evidence, step and covariance of the unknowns, amount of the cause, and what
    modes expect.
    """

    deviance: float
    step: Float
    amount: float
    covariance: Float
    mode_shift: Float
    mode_std: Float


@dataclass(frozen=True, slots=True, eq=False)
class _InLogs:
    """The linearised problem; frequencies in ln λ, other rows as they are weighed.

    Attributes
    ----------
    value, slope : (r,), (r, q) float64
        Rows of frequencies are those of ln λ.
    hertz : (r,) bool
        Which rows are frequencies.
    scale : (r,) float64
        ln λ over the weighted residual; 1 in other rows.
    test : (k,) int64
        Test mode of each row of frequencies.
    std : (m,) float64
        Of ln λ of the test.
    modes : (m, q) float64
        ∂ln λ/∂y of the partner of each test mode; NaN without one.
    """

    problem: Problem
    at: Evaluated
    field: Float
    value: Float
    slope: Float
    hertz: Bool
    scale: Float
    test: Int
    std: Float
    modes: Float

    @classmethod
    def of(cls, problem: Problem, at: Evaluated, field: Float) -> _InLogs:
        only = problem.configurations[0]
        value, slope = problem.weighted(at)
        quantity = [t.quantity for t in only.terms]
        hertz = np.array(
            [quantity[k] is Quantity.FREQUENCY for k in at.kind], dtype=np.bool_
        )
        aim = only.target
        test = at.mode[hertz]
        scale = np.ones(value.size)
        scale[hertz] = 2 * np.hypot(aim.weights.frequency, aim.std[test])
        here = at.points[0]
        modes = np.full((aim.frequencies.size, problem.size), np.nan)
        t, f = here.every.T
        lam = (2 * np.pi * here.now.frequencies[f]) ** 2
        modes[t] = here.now.d_lambda[f] / lam[:, None] @ problem.link
        return cls(
            problem=problem,
            at=at,
            field=field,
            value=value * scale,
            slope=slope * scale[:, None],
            hertz=hertz,
            scale=scale,
            test=test,
            std=2 * aim.std,
            modes=modes,
        )

    def fit(self, effect: CauseEffect | None, tau: float) -> _Component:
        """With one cause or none, and one scatter τ.

        What a cause does depends on the parameters, too. The product of what both change in ln λ of
        a mode, the size of what a linear sum leaves out, is a further error of the mode.
        """
        product = np.zeros(self.std.size)
        found = self._gaussian(effect, tau, product)
        if effect is None:
            return found
        by_parameters = np.nan_to_num(self.modes @ found.step)
        return self._gaussian(effect, tau, effect.modes * found.amount * by_parameters)

    def _gaussian(
        self, effect: CauseEffect | None, tau: float, product: Float
    ) -> _Component:
        """With an error of that standard deviation of each mode: Gaussian in the unknowns."""
        slope = self.slope
        own = self.modes
        prior = self.problem.linked_precision
        begin = self.at.y
        if effect is not None:
            slope = np.column_stack([slope, effect.residual * self.scale])
            own = np.column_stack([own, effect.modes])
            prior = linalg.block_diag(prior, np.array([[1 / effect.std**2]]))
            begin = np.append(begin, 0.0)
        std = np.hypot(self.std, product)
        covariance = np.diag(std[self.test] ** 2)
        covariance = covariance + tau**2 * self.field[np.ix_(self.test, self.test)]
        root = linalg.cholesky(covariance, lower=True)
        a = slope.copy()
        b = self.value.copy()
        a[self.hertz] = linalg.solve_triangular(root, slope[self.hertz], lower=True)
        b[self.hertz] = linalg.solve_triangular(
            root, self.value[self.hertz], lower=True
        )
        hessian = a.T @ a + prior
        step = linalg.solve(hessian, a.T @ b - prior @ begin, assume_a="pos")
        inverse = linalg.inv(hessian)
        rest = b - a @ step
        end = begin + step
        deviance = rest @ rest + 2 * np.log(np.diag(root)).sum() + end @ prior @ end
        deviance += np.linalg.slogdet(hessian)[1] - np.linalg.slogdet(prior)[1]

        # what the field has in the fitted modes says what it has in the others (universal kriging)
        near = linalg.solve_triangular(root, tau**2 * self.field[self.test], lower=True)
        left = own - near.T @ a[self.hertz]
        variance = tau**2 * np.diag(self.field) - (near**2).sum(axis=0) + std**2
        variance = variance + np.einsum("mq,qr,mr->m", left, inverse, left)
        q = self.problem.size
        return _Component(
            deviance=float(deviance),
            step=step[:q],
            amount=float(step[q:].sum()),
            covariance=inverse[:q, :q],
            mode_shift=own @ step + near.T @ rest[self.hertz],
            mode_std=np.sqrt(np.maximum(variance, 1e-16)),
        )
