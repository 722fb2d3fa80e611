"""Members, joints and supports that a deck may lack, ranked by what one stiffness explains; and as
cards: a brace as CBAR, a joint or support as CBUSH.

Of an added spring of stiffness k, ∂λ/∂k is the square of its extension in the mode (Fox and Kapoor
1968). It is asked what k ≥ 0 explains of the deviations that the parameters leave, all of them free
to take its part: Rao's score statistic (1948) with the prior of the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.display import with_error
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.decks.nastran.writer import Value, format_card
from ringtrue.errors import InputError
from ringtrue.fem.assembly import System
from ringtrue.fem.element_cards import MATERIAL, PROPERTY
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.reduction.dense_models import DenseModel, matrices_at
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.updating.problem import Problem, single
from ringtrue.updating.selection.member_pairs import (
    AXIAL,
    LINES,
    MemberSearch,
    PossibleMembers,
    possible_members,
)
from ringtrue.updating.selection.proposal import Proposal
from ringtrue.updating.selection.selection_rules import falling, short_update
from ringtrue.updating.selection.subset_search import DEFAULT_SEARCH
from ringtrue.updating.target import Target

ROUNDING = 1e-9  # share of a squared slope below which it is rounding


@dataclass(frozen=True, slots=True)
class MemberRanking:
    """What is ranked, and how many are shown.

    Attributes
    ----------
    most : int
        Members that are proposed.
    tried : int
        Single members of each form, and sets of members, that the slopes rank first: so many of
        each are fitted with all parameters.
    paired : int
        Braces of one length and inclination, up to which any two of them are also tried with one
        stiffness; structures are built of like parts.
    suspended : float
        A deck of which six modes are below so many times the lowest one of the test is suspended
        softly: it lacks no support.
    starts : tuple of float
        Of a stiffness, in units of what the slopes give.
    std : float
        Standard deviation of the logarithm of a stiffness before the test: none to speak of.
    """

    most: int = 6
    tried: int = 16
    paired: int = 24
    suspended: float = 0.5
    starts: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0)
    std: float = 10.0


RANKING = MemberRanking()


@dataclass(frozen=True, slots=True)
class MissingMember:
    """A member that would explain deviations of the deck.

    Attributes
    ----------
    form : {"brace", "link", "support"}
    components : str
        As in `PossibleMembers`.
    nodes : tuple of (int, int)
        Ids of GRID of each of the like members; the second is 0 for the ground.
    stiffness, std : float
        Of each, and its standard deviation, in units of the deck.
    arm : float
        Length: stiffness about an axis is `stiffness` times its square.
    share : float
        Of the squared weighted deviations that the parameters leave, what it explains.
    remaining : float
        The same with those that are ranked before it in the model.
    worth : float
        Fall of the squared weighted deviations less the price of one stiffness and of the search
        among all members (AICc); not above 0 where chance finds as good a one.
    modes : tuple of int
        Test modes, from 0, whose deviations it lowers most.
    """

    form: str
    components: str
    nodes: tuple[tuple[int, int], ...]
    stiffness: float
    std: float
    arm: float
    share: float
    remaining: float
    worth: float
    modes: tuple[int, ...]

    @property
    def name(self) -> str:
        """Where it is: `brace 39 to 78 and 3 others`."""
        a, b = self.nodes[0]
        place = f"{self.form} {a} to {b}" if b else f"{self.form} at {a}"
        more = len(self.nodes) - 1
        return f"{place} and {more} other{'s' if more > 1 else ''}" if more else place

    @property
    def stands_for(self) -> bool:
        """Whether those that are ranked before it explain more than half of what it does."""
        return self.remaining < self.share / 2

    def text(self, unit: str = "") -> str:
        """What it is and what speaks for it, in one sentence."""
        size, error = with_error(self.stiffness, self.std)
        amount = f"{size} ± {error}{f' {unit}' if unit else ''}"
        if self.std > self.stiffness:
            amount = "stiff, how much is not known,"
        each = " each" if len(self.nodes) > 1 else ""
        where = (
            "" if self.components == "axial" else f" along directions {self.components}"
        )
        mode = "mode" if len(self.modes) == 1 else "modes"
        modes = f"{mode} {', '.join(str(m + 1) for m in self.modes)}"
        proof = f"worth {self.worth:.1f} (AICc)"
        if self.worth <= 0:
            proof = "one of so many members may explain as much by chance"
        text = f"{self.name}: {amount}{each}{where} explains "
        text += f"{100 * self.share:.0f} % of the deviations that the parameters leave"
        text += f", most in test {modes}; {proof}" if modes else f"; {proof}"
        if self.stands_for:
            text += "; it is an alternative to those before it"
        return text


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel(FrozenArrays):
    """The modes of a model at the parameters that fit best without a member.

    Attributes
    ----------
    system : System
        Of the deck.
    values : (m,) float64, (rad/s)²
        Of three times as many modes as the test has.
    vectors : (f, m) float64
        Of unit modal mass.
    d_stiffness, d_mass : (p, m, m) float64
        Changes of the matrices by one prior standard deviation of each parameter, along the modes.
    readings : (channel, m) float64
    x : (p,) float64
        The parameters, in units of their prior standard deviations.
    aim : Target
    """

    system: System
    values: Float
    vectors: Float
    d_stiffness: Float
    d_mass: Float
    readings: Float
    x: Float
    aim: Target

    @classmethod
    def of(
        cls, system: System, model: ReducedModel, rows: Int, x: Float, aim: Target
    ) -> FittedModel:
        """Of a reduced model at x (p,), seen at some rows of its channels."""
        most = min(3 * aim.frequencies.size + 10, model.basis.size)
        values, phi = replace(model, count=most).coordinates(x)
        at = matrices_at(model, x)
        prior = model.parameters.std()
        step = prior[:, None, None]
        return cls(
            system=system,
            values=values,
            vectors=model.basis.vectors @ phi,
            d_stiffness=phi.T @ at.d_stiffness @ phi * step,
            d_mass=phi.T @ at.d_mass @ phi * step,
            readings=at.observe[rows] @ phi,
            x=x / prior,
            aim=aim,
        )

    @classmethod
    def after(
        cls,
        proposal: Proposal,
        system: System,
        model: ReducedModel,
        rows: Int,
        aim: Target,
    ) -> FittedModel:
        """Where a proposal leads; what it leaves is weighed by what it has left over."""
        left = replace(aim, weights=proposal.left_over(aim.weights))
        return cls.of(system, model, rows, proposal.x, left)

    def suspended(self, below: float) -> bool:
        """Whether six modes are below so many times the lowest used one of the test."""
        lowest = float(self.aim.frequencies[self.aim.used].min(initial=np.inf))
        limit = (2 * np.pi * below * lowest) ** 2
        return int(np.count_nonzero(self.values < limit)) >= 6

    def with_members(self, added: Float, start: Float) -> Problem:
        """The test over the parameters, in units of their priors from the point on, and the
        stiffness of members without a prior to speak of.

        Parameters
        ----------
        added : (q, m, m) float64
            Stiffness matrices of members along the modes.
        start : (q,) float64
            Stiffness of each at x = 0.
        """
        scaled = added * np.where(start > 0, start, 1.0)[:, None, None]
        own = [Parameter(f"p{i}", (), 0.02, 50.0, std=1.0) for i in range(self.x.size)]
        more = [
            Parameter(f"k{i}", (), 1e-3, 1e3, std=RANKING.std)
            for i in range(len(added))
        ]
        dense = DenseModel(
            stiffness=np.diag(self.values) + np.tensordot(start, added, axes=1),
            mass=np.eye(self.values.size),
            d_stiffness=np.concatenate([self.d_stiffness, scaled]),
            d_mass=np.concatenate([self.d_mass, np.zeros_like(scaled)]),
            observation=self.readings,
            parameters=ParameterSet((*own, *more)),
            count=self.values.size,
        )
        return single(dense, self.aim)


@dataclass(frozen=True, slots=True, eq=False)
class _Scores:
    """What each choice explains with one stiffness, what stays free to take its part.

    Attributes
    ----------
    own : (u,) float64
        gᵀC⁻¹g of each, C = I + GGᵀ with the slopes G of what stays free.
    along : (u,) float64
        gᵀC⁻¹r of each.
    left : float
        rᵀC⁻¹r.
    """

    own: Float
    along: Float
    left: float

    @classmethod
    def of(cls, value: Float, free: Float, members: Float) -> _Scores:
        """From deviations (r,) and the slopes (r, p) and (r, u)."""
        inner = np.eye(free.shape[1]) + free.T @ free
        before = np.column_stack([value, members])
        rest = before - free @ linalg.solve(inner, free.T @ before, assume_a="pos")
        sizes = np.einsum("rk,rk->k", before, rest)
        # what moves nothing, or what the others do as well, is left with rounding
        size = np.sum(members**2, axis=0)
        seen = (sizes[1:] > ROUNDING * size) & (
            size > ROUNDING**2 * size.max(initial=0.0)
        )
        own = np.where(seen, sizes[1:], np.inf)
        return cls(own, rest[:, 1:].T @ value, float(sizes[0]))

    def falls(self) -> Float:
        """Fall of the squared deviations at the best k ≥ 0 of each, (u,)."""
        return np.maximum(self.along, 0.0) ** 2 / self.own


def missing_members(model: Model, fitted: FittedModel) -> tuple[MissingMember, ...]:
    """Those that explain most of the deviations of a deck, the first first; none where none
    explains more than noise.
    """
    r = RANKING
    search = (
        MemberSearch(supports=0) if fitted.suspended(r.suspended) else MemberSearch()
    )
    possible = possible_members(model, fitted.system, search)
    if not len(possible):
        return ()
    choices = choices_of(possible, r)
    extension = possible.extensions(fitted.system, fitted.vectors)
    stiffness = np.einsum("qri,qrj->qij", extension, extension)
    screen = _Screen.of(fitted, stiffness, choices)
    promise = screen.scores.falls()
    hopeful = falling(promise)[: np.count_nonzero(promise > DEFAULT_SEARCH.noise)]
    kind = [
        possible.forms[choices[u][0]] if choices[u].size == 1 else "" for u in hopeful
    ]
    first = [
        u
        for k in sorted(set(kind))
        for u in hopeful[np.array(kind) == k][: r.tried].tolist()
    ]
    if not first:
        return ()
    fits = [
        _fit(fitted, stiffness[choices[u]].sum(axis=0), screen.stiffness(u))
        for u in first
    ]
    without = _fit(fitted)
    fall = np.array([without.value - f.value for f in fits])
    # of two that explain as much, the one of a single member
    several = np.array([choices[u].size > 1 for u in first], dtype=np.bool_)
    order = falling(fall - DEFAULT_SEARCH.noise * several)
    price = DEFAULT_SEARCH.noise + 2 * np.log(len(choices))
    out: list[MissingMember] = []
    before: list[int] = []
    used: set[int] = set()
    for i in order.tolist():
        u = first[i]
        at = choices[u]
        if len(out) == r.most or fall[i] <= DEFAULT_SEARCH.noise:
            break
        if not used.isdisjoint(at.tolist()):
            continue
        share = float(fall[i] / without.value)
        one = MissingMember(
            form=possible.forms[at[0]],
            components=possible.components[at[0]],
            nodes=tuple((a, b) for a, b in possible.nodes[at].tolist()),
            stiffness=fits[i].stiffness,
            std=fits[i].std,
            arm=float(possible.arms[at[0]]),
            share=share,
            remaining=share * screen.kept(u, before),
            worth=float(fall[i] - price),
            modes=_lowered(without, fits[i]),
        )
        out.append(one)
        before.append(u)
        used.update(at.tolist())
    return tuple(out)


@dataclass(frozen=True, slots=True, eq=False)
class _Screen:
    """All choices by the slopes at the point without a member.

    Attributes
    ----------
    value : (r,) float64
        Deviations of the deck, linearised: the prior is about it.
    parameters : (r, p) float64
        Slopes to the parameters.
    members : (r, u) float64
        Slopes to the stiffness of each choice.
    scores : _Scores
    """

    value: Float
    parameters: Float
    members: Float
    scores: _Scores

    @classmethod
    def of(
        cls, fitted: FittedModel, stiffness: Float, choices: Sequence[Int]
    ) -> _Screen:
        """Of the members (q, m, m) along the modes."""
        problem = fitted.with_members(stiffness, np.zeros(len(stiffness)))
        e = problem.evaluate(np.zeros(problem.size))
        parameters, alone = np.hsplit(e.slope, [fitted.x.size])
        members = np.stack([alone[:, at].sum(axis=1) for at in choices], axis=1)
        value = e.value + parameters @ fitted.x
        return cls(value, parameters, members, _Scores.of(value, parameters, members))

    def stiffness(self, u: int) -> float:
        """The best one of a choice."""
        return float(self.scores.along[u] / self.scores.own[u])

    def kept(self, u: int, before: Sequence[int]) -> float:
        """The part of its fall that a choice keeps with others in the model, 0 to 1."""
        g = self.members[:, list(before)]
        # slopes without a prior: so large that C⁻¹ leaves nothing along them
        free = np.column_stack([self.parameters, 1e4 * g / np.linalg.norm(g, axis=0)])
        rest = _Scores.of(self.value, free, self.members[:, [u]]).falls()[0]
        return float(min(rest / self.scores.falls()[u], 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The parameters, and a member, updated: J, stiffness with its standard deviation, and the
    squared deviations of each test mode.
    """

    value: float
    stiffness: float
    std: float
    by_mode: Float


def _fit(fitted: FittedModel, added: Float | None = None, start: float = 0.0) -> _Fit:
    """A short updating over the parameters and one stiffness, of the matrix (m, m) `added`."""
    count = fitted.x.size
    more = (
        np.zeros((0, *fitted.d_stiffness.shape[1:])) if added is None else added[None]
    )
    problem = fitted.with_members(more, np.full(len(more), start))
    begin = np.zeros(problem.size)
    if added is not None:  # slopes tell too little of a stiff member
        begin = min(
            (np.append(begin[:-1], np.log(s)) for s in RANKING.starts), key=problem.cost
        )
    done = short_update(problem, range(problem.size), begin)
    e = problem.evaluate(done.x)
    modes = fitted.aim.frequencies.size
    by_mode = np.bincount(e.mode, e.value**2, modes).astype(np.float64)
    if added is None:
        return _Fit(done.value, 0.0, 0.0, by_mode)
    parameters, member = np.hsplit(e.slope, [count])
    k = start * float(np.exp(done.x[-1]))
    own = float(_Scores.of(e.value, parameters, member).own[0])
    return _Fit(done.value, k, k * own**-0.5, by_mode)


def _lowered(without: _Fit, found: _Fit) -> tuple[int, ...]:
    """Up to three test modes whose deviations fall most."""
    fall = without.by_mode - found.by_mode
    most = np.argsort(-fall, kind="stable")[:3]
    return tuple(most[fall[most] > 0].tolist())


def choices_of(possible: PossibleMembers, ranking: MemberRanking) -> list[Int]:
    """Sets of members with one stiffness, rows each: single ones; of braces any two of one kind,
    and all that are parallel and as long.
    """
    out = [np.array([i]) for i in range(len(possible))]
    kinds: dict[tuple[float, ...], list[int]] = {}
    parallel: dict[tuple[float, ...], list[int]] = {}
    for i, along in enumerate(possible.along):
        if possible.forms[i] != "brace":
            continue
        signed = along * next((float(np.sign(v)) for v in along if v), 1.0)
        kinds.setdefault(tuple(np.abs(along).tolist()), []).append(i)
        parallel.setdefault(tuple(signed.tolist()), []).append(i)
    for some in kinds.values():
        if len(some) <= ranking.paired:
            out += [np.array(pair) for pair in combinations(some, 2)]
    return out + [np.array(some) for some in parallel.values() if len(some) > 2]


def member_cards(model: Model, members: Sequence[MissingMember], unit: str = "") -> str:
    """A file of cards for `[[remodel]]`: the first member; the others, each of which may stand in
    its place, as comments.

    A brace has the material of a member at its ends, the area of its stiffness, and hinges. It is
    a square bar: area A, second moments A²/12.

    Parameters
    ----------
    model : Model
        The deck.
    members : sequence of MissingMember
        The first first.
    unit : str
        Of a stiffness, for the comments.

    Raises
    ------
    InputError
        If there is no member, or no member of the deck has an isotropic material for a brace.
    """
    if not members:
        raise InputError("no missing member is proposed: there are no cards to write")
    tables = model.tables.values()
    number = 1 + max(
        int(t.ids.max(initial=0)) for t in tables if t.card.startswith(("C", "P"))
    )
    parts = []
    for rank, member in enumerate(members, start=1):
        made = _cards(model, member, number)
        number += len(member.nodes) + 1
        head = (
            f"$ {rank}. {member.name}, {member.stiffness:.3g} +- {member.std:.1g} "
            f"{unit}"
        ).rstrip()
        head += (
            f", explains {100 * member.share:.0f} %, worth {member.worth:.1f} (AICc)\n"
        )
        if rank > 1:
            made = "".join(f"$ {line}\n" for line in made.splitlines())
        parts.append(head + made)
    return "".join(parts)


def _cards(model: Model, member: MissingMember, number: int) -> str:
    """The property, then an element for each of the like members."""
    if member.form == "brace":
        return _bars(model, member, number)
    along, about = member.stiffness, member.stiffness * member.arm**2
    named = "1" if member.components == AXIAL else member.components
    held: list[Value] = [
        (along if k <= 3 else about) if str(k) in named else None for k in range(1, 7)
    ]
    frame = None if member.components == AXIAL else 0
    out = format_card("PBUSH", [number, "K", *held])
    for eid, (a, b) in enumerate(member.nodes, start=number + 1):
        out += format_card(
            "CBUSH", [eid, number, a, b or None, None, None, None, frame]
        )
    return out


def _bars(model: Model, member: MissingMember, number: int) -> str:
    """Of one area, between hinges."""
    grid = model["GRID"]
    ends = positions(model)[grid.find(np.array(member.nodes).ravel())].reshape(-1, 2, 3)
    line = ends[:, 1] - ends[:, 0]
    mid = _material(model, member)
    table = model["MAT1"]
    modulus = float(table["E"][table.find(np.array([mid]))[0]])
    area = member.stiffness * float(np.linalg.norm(line[0])) / modulus
    inertia = area**2 / 12
    out = format_card("PBAR", [number, mid, area, inertia, inertia, 2 * inertia])
    for k, (a, b) in enumerate(member.nodes):
        ends_and_plane = [a, b, *_beside(line[k])]
        pins = [None, 56, 56]
        out += format_card("CBAR", [number + 1 + k, number, *ends_and_plane, *pins])
    return out


def _beside(along: Float) -> list[Value]:
    """The basic axis that is least along a line: the bar is square, any will do."""
    return [float(k == int(np.argmin(np.abs(along)))) for k in range(3)]


def _material(model: Model, member: MissingMember) -> int:
    """The MAT1 of a line element at the first node, or at any of the nodes."""
    for node in (n for pair in member.nodes for n in pair):
        for card in (c for c in LINES if c in model):
            table = model[card]
            first, second = ("G1", "G2") if "G1" in table.columns else ("GA", "GB")
            for row in np.flatnonzero(
                (table[first] == node) | (table[second] == node)
            ).tolist():
                if "MID" in table.columns:
                    mid = int(table["MID"][row])
                else:
                    held = model[PROPERTY[card]]
                    at = held.find(table["PID"][[row]])
                    mid = int(held[MATERIAL[held.card][0]][at[0]])
                if "MAT1" in model and mid in model["MAT1"].ids:
                    return mid
    raise InputError(f"{member.name}: no line element at its nodes has a MAT1")
