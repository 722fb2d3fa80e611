"""Multi-start updating of frames with 12 stiffness parameters and 43 measured DOFs, noise-free
data.

    python bench/updating.py starts     many starts, anywhere between the bounds
    python bench/updating.py cost       single updatings from the nominal model

each with [--quick | --full]. The frames are those of concrete_frame.py, some 2,300 DOFs: one that
is made there and, for `starts` and where its data are, the published one, on which one start may
end in another minimum. Its study needs 31 s for ONE start with analytic gradients (its desktop;
another machine, so a statement, not a ratio). An updating is right if the objective is zero at the
truth and every factor comes out as it was drawn.

`starts`: the truth is drawn with each stiffness off by up to 30 %; starts are uniform between the
bounds 0.05 and 2 of the factors. All searches run on one reduced basis; the best end is then solved
in full, the basis enriched there, and the updating repeated until the full solution agrees. A
search weighs shapes more than frequencies (5 % in 1 − MAC, 10 % in frequency): frequencies alone
pair modes wrongly far from the truth.

`cost`: the truth up to 50 % off and up to a factor of 2.5: how many full eigensolutions and
factorisations an updating takes, the first included, until basis and full model agree to 1e-4;
beside it 20 steps of scipy's `least_squares` on full eigensolutions with finite differences, which
do not end it.

Not covered: noise, damping, truth outside the parameters, other structures; MAC and complete
published objectives.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from concrete_frame import PUBLISHED, own_frame, published_frame
from outcome import Check, Peer, Report, arguments, at_least, at_most, sized
from scipy.optimize import least_squares

from ringtrue.core.arrays import Float, Int
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.eigen.pencil import Pencil
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.solvers.matrices import MatrixModel, ObservedMatrices
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.solver import Method, Solution, StartSettings, multi_start, solve
from ringtrue.updating.strategy import solve_verified
from ringtrue.updating.target import Target, Weights

MODES, SPARE = 6, 4  # measured; more that the model returns, so that modes may cross
PUBLISHED_START = 31.0  # s, one start of the published study
WEAK = 1e6  # prior standard deviation: too weak to be seen
ITERATIONS, FINISH = 15, 6  # of every start; starts that go on to the end
# the measured modes are apart: no rotation inside groups
APART = PairingSettings(close=0.001)
STEPS = 20  # of the peer
ENRICHED, LAST = 3, 8  # times that the basis is; steps with full solutions, at most
# at the truth: the prior, at most 0.3 of 1e6, leaves 12 (0.3e-6)² = 1e-12
J_MOST = 1e-10
FACTOR_MOST = 1e-4  # of a stiffness
FACTOR_VERIFIED_MOST = 2e-2  # VERIFIED times the condition
VERIFIED = 1e-4  # frequencies of basis and full model, as `solve_verified` asks
REDUCED_MOST = 1e-8  # frequencies of a basis that is enriched at the point


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Many starts to one truth.

    Attributes
    ----------
    seconds : float
        Of the processor: basis, starts and the solutions in full.
    near : float
        Share of the ends on the basis that are within 0.2 of the truth in the mean of the factors.
    at_truth : float
        The objective there.
    error : float
        Largest of a factor.
    converged : bool
    """

    seconds: float
    near: float
    at_truth: float
    error: float
    converged: bool


def one(model: object, target: Target) -> Problem:
    """The problem on one model."""
    return Problem((Configuration(model, target),))  # type: ignore[arg-type]


def refined(
    model: ReducedModel, full: ObservedMatrices, target: Target, x: Float
) -> tuple[Solution, float]:
    """From the best end on the basis to that of full solutions; and the last frequency error of the
    basis.
    """
    done = solve(one(model, target), start=x)
    error = np.inf
    n = target.frequencies.size
    for _ in range(ENRICHED):
        better, truth = model.enrich(done.x, sensitivities=True)
        error = float(
            np.abs(
                model.modes(done.x).frequencies[:n] / truth.frequencies[:n] - 1
            ).max()
        )
        model = better
        done = solve(one(model, target), start=done.x)
    return solve(one(full, target), start=done.x, iterations=LAST), error


def differences(full: ObservedMatrices, target: Target) -> float:
    """Seconds of scipy's least squares on full solutions with finite differences."""
    problem, start = one(full, target), time.process_time()
    at = problem.evaluate(np.zeros(problem.size))

    def value(y: Float) -> Float:
        now = problem.evaluate(y, at, slopes=False).value
        return now if now.size == at.value.size else np.full(at.value.size, 1e3)

    low, high = problem.parameters.bounds()
    least_squares(value, np.zeros(problem.size), bounds=(low, high), max_nfev=STEPS)
    return time.process_time() - start


class Factorisations:
    """Counts what `Pencil` factorises."""

    def __init__(self) -> None:
        self.count, made = 0, Pencil._make

        def counted(pencil: Pencil, values: Float) -> object:
            self.count += 1
            return made(pencil, values)

        Pencil._make = counted  # type: ignore[method-assign,assignment]


def measured(full: ObservedMatrices, truth: Float) -> Target:
    """The lowest modes at the truth, without noise."""
    t = full.modes(truth)
    return Target(
        t.frequencies[:MODES],
        t.shapes[:, :MODES],
        np.zeros(MODES),
        np.ones(MODES, dtype=bool),
    )


def recovered(runs: list[Run]) -> list[Check]:
    """Whether the truth is the minimum, and is found."""
    return [
        at_most("J at the truth", max(r.at_truth for r in runs), J_MOST),
        at_most("error of a factor", max(r.error for r in runs), FACTOR_MOST),
        at_least("converged", sum(r.converged for r in runs), len(runs)),
    ]


def many_starts(matrices: MatrixModel, rows: Int, seed: int, starts: int) -> Run:
    """To one truth."""
    rng = np.random.default_rng(seed)
    parameters = matrices.parameters(0.05, 2.0, WEAK)
    truth = rng.uniform(-0.3, 0.3, len(parameters))
    observation = matrices.observe(rows)
    full = matrices.observed(
        observation, parameters=parameters, request=ModesRequest(MODES + SPARE)
    )
    target = measured(full, truth)
    search = replace(target, weights=Weights(frequency=0.1, mac=0.05), pairing=APART)
    at_truth = max(one(full, t).cost(truth) for t in (target, search))
    begin = time.process_time()
    model = matrices.reduced(observation, MODES + SPARE, parameters=parameters)
    low, high = parameters.bounds()
    points = rng.uniform(low, high, (starts, low.size))
    found = multi_start(
        one(model, search), points, Method(), StartSettings(ITERATIONS, FINISH)
    )
    done = refined(model, full, target, found.best.x)[0]
    seconds = time.process_time() - begin
    near = np.abs(found.ends - truth).mean(axis=1) < 0.2
    error = float(np.abs(done.x - truth).max())
    return Run(seconds, float(near.mean()), at_truth, error, converged(done))


def converged(done: Solution) -> bool:
    """Whether the updating ended as it should."""
    return done.outcome.value.startswith("converged")


def same_modes(reduced: Float, full: Float) -> Check:
    """Frequencies of the basis at a point where it was enriched."""
    return at_most(
        "frequencies off the full ones by",
        np.abs(reduced / full - 1).max(),
        REDUCED_MOST,
    )


def sensitivities(name: str, matrices: MatrixModel, rows: Int, report: Report) -> None:
    """Modes and sensitivities on the basis and in full."""
    parameters, observation = (
        matrices.parameters(0.05, 2.0, WEAK),
        matrices.observe(rows),
    )
    request = ModesRequest(MODES + SPARE)
    full = matrices.observed(observation, parameters=parameters, request=request)
    x = np.random.default_rng(0).uniform(-0.3, 0.3, len(parameters))
    model = matrices.reduced(observation, MODES + SPARE, parameters=parameters).enrich(
        x, sensitivities=True
    )[0]
    begin = time.process_time()
    for _ in range(20):
        reduced = model.linearise(x)
    seconds = (time.process_time() - begin) / 20
    begin = time.process_time()
    exact = full.linearise(x)
    peer = Peer("the full model", {"ms": 1e3 * (time.process_time() - begin)})
    check = same_modes(reduced.frequencies[:MODES], exact.frequencies[:MODES])
    report.row(
        f"{name}: modes and sensitivities on the basis",
        {"ms": 1e3 * seconds},
        [check],
        [peer],
    )


def starts(
    name: str, matrices: MatrixModel, rows: Int, report: Report, size: tuple[int, int]
) -> None:
    """Truths, and starts to each."""
    seeds, count = size
    runs = [many_starts(matrices, rows, seed, count) for seed in range(seeds)]
    cost = {
        "s at most": max(r.seconds for r in runs),
        "% of starts end near": 100 * float(np.mean([r.near for r in runs])),
    }
    peers = [
        Peer("published, one start, another machine", {"s at most": PUBLISHED_START})
    ]
    what = f"{name}: {count} starts to each of {seeds} truths"
    report.row(
        what, cost, recovered(runs), peers if name.startswith("published") else []
    )
    sensitivities(name, matrices, rows, report)


def verified(errors: list[float], factors: list[float]) -> list[Check]:
    """Basis against full model at the ends; and whether the middle one of the updatings finds the
    truth.
    """
    return [
        at_most("basis off the full model by", max(errors), VERIFIED),
        at_most("error of a factor, median", np.median(factors), FACTOR_VERIFIED_MOST),
    ]


def cost(
    name: str, matrices: MatrixModel, rows: Int, report: Report, size: tuple[int, int]
) -> None:
    """Of single updatings."""
    draws = size[0]
    rng = np.random.default_rng(0)
    parameters, observation = (
        matrices.parameters(0.05, 3.0, WEAK),
        matrices.observe(rows),
    )
    full = matrices.observed(
        observation, parameters=parameters, request=ModesRequest(MODES + SPARE)
    )
    made = Factorisations()
    for off, low, high in (
        ("up to 50 % off", 0.5, 1.5),
        ("0.4 to 2.5 times", 0.4, 2.5),
    ):
        seconds, solutions, factorisations = list[float](), list[float](), list[float]()
        errors, factors = list[float](), list[float]()
        for _ in range(draws):
            truth = rng.uniform(low, high, len(parameters)) - 1
            target = replace(
                measured(full, truth),
                weights=Weights(frequency=0.1, mac=0.05),
                pairing=APART,
            )
            made.count, begin = 0, time.process_time()
            done = solve_verified(
                one(
                    matrices.reduced(observation, MODES + SPARE, parameters=parameters),
                    target,
                )
            )
            seconds.append(time.process_time() - begin)
            solutions.append(1 + done.full_solutions)
            factorisations.append(made.count)
            errors.append(done.error)
            factors.append(float(np.abs(done.solution.x - truth).max()))
        spent = {
            "s": float(np.median(seconds)),
            "full solutions at most": max(solutions),
            "factorisations": float(np.median(factorisations)),
        }
        peer = Peer(
            f"scipy `least_squares`, {STEPS} steps", {"s": differences(full, target)}
        )
        report.row(
            f"{name}: one updating, truth {off}, {draws} draws",
            spent,
            verified(errors, factors),
            [peer],
        )


SIZES = {
    starts: ((1, 20), (2, 100), (20, 100)),
    cost: ((2, 0), (5, 0), (20, 0)),
}  # truths and starts; draws


def main() -> None:
    """Run and state."""
    parser = arguments(__doc__)
    works = {work.__name__: work for work in SIZES}
    parser.add_argument("what", choices=list(works))
    options = parser.parse_args()
    work = works[options.what]
    report = Report(options)
    work("frame of concrete", *own_frame(), report, sized(options, *SIZES[work]))
    if work is cost:
        report.end()
    if PUBLISHED.exists():
        work(
            "published frame", *published_frame(), report, sized(options, *SIZES[work])
        )
    else:
        report.not_run("published frame", "its data (GPL) are not part of the project")
    report.end()


if __name__ == "__main__":
    main()
