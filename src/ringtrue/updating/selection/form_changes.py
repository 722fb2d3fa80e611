"""What errors of form do to the natural frequencies of a deck: ln λ of each mode as one physical
cause grows, by the deck's own matrices.

Factors on moduli, densities and single properties: shares of strain and kinetic energy (Fox and
Kapoor 1968). Shear flexibility, springs under supports: the modes of the changed deck, a few
amounts of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.fem.assembly import Sum, System, assemble, reduced
from ringtrue.fem.constraints import supports
from ringtrue.fem.element_cards import mesh, pieces
from ringtrue.fem.members import POINT_MASSES
from ringtrue.fem.mesh import ElementMatrices, Mesh
from ringtrue.model.case_control import taken_sets
from ringtrue.model.model import Model, Ragged, table
from ringtrue.shapes import unit

Pattern = Literal["shear", "common", "supports", "property", "single", "damping"]
SHEAR = {"PBAR": ("K1", "K2"), "PBEAM": ("K1", "K2"), "PSHELL": ("TST",)}
SPRUNG = ("CBUSH", "CBUSH1D", "CELAS1", "CELAS2", "CELAS3", "CELAS4")


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """How far each cause is followed.

    Attributes
    ----------
    shear : tuple of float
        Shear flexibility over that of a rectangular section.
    supports : tuple of float
        Largest change of ln λ that the slopes give.
    springs : tuple of float
        ln of the factor on the stiffness.
    reaction : float
        Share of the largest reaction below which a held degree of freedom supports nothing.
    largest : int
        Free degrees of freedom up to which causes are followed that need the modes of changed
        decks, six each.
    near, stay : float
        Relative distance from a test mode of a mode that may become its partner, and by how much
        its MAC must be better.
    local : float
        Share of a single mode in the squared slopes of a property, from which on it is a local
        member.
    """

    shear: tuple[float, ...] = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
    supports: tuple[float, ...] = (0.02, 0.1, 0.3, 0.8, 2.0, 4.0)
    springs: tuple[float, ...] = (-2.0, -1.0, -0.4, 0.4, 1.0, 2.0)
    reaction: float = 1e-6
    largest: int = 10_000
    near: float = 0.1
    stay: float = 0.05
    local: float = 0.95


CHANGES = ChangeSettings()
RECTANGLE = 5 / 6  # shear factor of a rectangular section (Timoshenko 1921)


@dataclass(frozen=True, slots=True, eq=False)
class FormChange(FrozenArrays):
    """ln λ of the paired modes as one cause grows.

    Attributes
    ----------
    pattern : {"shear", "common", "supports", "property", "single", "damping"}
    cause : str
        In words.
    fields : tuple of str
        Parameters to propose, as `PBAR 3 K1,K2`.
    amount : (k,) float64
        Ascending; 0 is the deck.
    change : (k, m) float64
        ln λ over that of the deck.
    joint : bool
        Whether it may act together with others of this kind.
    """

    pattern: Pattern
    cause: str
    fields: tuple[str, ...]
    amount: Float
    change: Float
    joint: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredModes(FrozenArrays):
    """The paired test modes.

    Attributes
    ----------
    observe : (channel, full) csr float64
        Readings of a motion of all degrees of freedom.
    shapes : (channel, n) float64
        Without columns where only frequencies were measured.
    frequencies : (n,) float64, Hz
    """

    observe: sparse.csr_array
    shapes: Float
    frequencies: Float

    def partners(self, system: System, found: EigenModes, of: Int) -> Int:
        """Modes (n,) of a changed deck that have the measured shapes, in place of those (n,) that
        follow from the deck's: modes that come close exchange their shapes.
        """
        if not self.shapes.shape[1]:
            return of
        seen = unit(self.observe @ (system.transform @ found.vectors))
        mac = (unit(self.shapes).T @ seen) ** 2
        f = np.sqrt(np.maximum(found.values, 1e-300)) / (2 * np.pi)
        near = np.abs(np.log(f / self.frequencies[:, None])) < CHANGES.near
        mine = np.zeros(mac.shape, dtype=np.bool_)
        mine[np.arange(of.size), of] = True
        _, best = linear_sum_assignment(
            -np.where(near | mine, mac + CHANGES.stay * mine, 0.0)
        )
        return np.asarray(best, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class DeckModes(FrozenArrays):
    """A deck with its modes.

    Attributes
    ----------
    model : Model
        The whole mesh.
    system : System
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64
        Of unit modal mass.
    at : (n,) int64
        Modes that are paired with test modes.
    measured : MeasuredModes
        These test modes.
    """

    model: Model
    system: System
    values: Float
    vectors: Float
    at: Int
    measured: MeasuredModes


def form_changes(deck: DeckModes) -> tuple[FormChange, ...]:
    """All causes that the deck has a place for; of a large deck those that need no solution."""
    m = mesh(deck.model)
    energies, stiffness = _by_energy(deck, m)
    if deck.vectors.shape[0] > CHANGES.largest:
        return energies
    property_ = _property(deck, m, stiffness)
    return (
        *_shear(deck),
        *_support_springs(deck, m),
        *_grounded(deck, m),
        *property_,
        *energies,
    )


def _linear(
    pattern: Pattern, cause: str, fields: tuple[str, ...], slope: Float
) -> FormChange:
    """Of ln λ that is linear in ln(factor)."""
    amount = np.array([-1.5, 0.0, 1.5])
    return FormChange(pattern, cause, fields, amount, amount[:, None] * slope)


# Energies


def _by_energy(
    deck: DeckModes, m: Mesh
) -> tuple[tuple[FormChange, ...], dict[str, Float]]:
    """Common factors on moduli and densities, and factors on single properties; the shares of
    strain energy of these, (n,) each.
    """
    shapes = deck.vectors[:, deck.at]
    lam = deck.values[deck.at]
    full = _with_ground(deck.system, shapes)
    strain = dict[str, Float]()
    kinetic = dict[str, Float]()
    modulus = np.zeros(lam.size)
    density = np.zeros(lam.size)
    wtmass = deck.model.param("WTMASS", 1.0)
    for card, rows, part in pieces(m):
        u = full[part.dofs]
        energy = np.einsum("edk,edk->ek", u, part.stiffness @ u) / lam
        lumped = part.mass.ndim == 2
        moved = part.mass[:, :, None] * u if lumped else part.mass @ u
        motion = np.einsum("edk,edk->ek", u, moved) * wtmass
        if card not in SPRUNG:
            modulus += energy.sum(axis=0)
        if card not in POINT_MASSES:
            density -= motion.sum(axis=0)
        for name, mine in _owners(deck.model, card, rows):
            strain[name] = strain.get(name, 0.0) + energy[mine].sum(axis=0)
            kinetic[name] = kinetic.get(name, 0.0) + motion[mine].sum(axis=0)
    materials = tuple(
        f"{c} {i} E"
        for c in ("MAT1",)
        if c in deck.model
        for i in deck.model[c].ids.tolist()
    )
    out = [_linear("common", "modulus", materials, modulus)]
    densities = tuple(f.replace(" E", " RHO") for f in materials)
    out.append(_linear("common", "density", densities, density))
    for name in strain:
        for what, slope in (("stiffness", strain[name]), ("mass", -kinetic[name])):
            largest = np.abs(slope).max(initial=0.0)
            if largest <= CHANGES.reaction:
                continue
            local = largest**2 > CHANGES.local * float(slope @ slope)
            out.append(
                _linear(
                    "single" if local else "property", f"{what} of {name}", (), slope
                )
            )
    return tuple(out), strain


def _property(
    deck: DeckModes, m: Mesh, strain: dict[str, Float]
) -> Iterator[FormChange]:
    """The stiffness of the property whose shares of strain energy explain most: by its modes, as
    large changes are not linear.
    """
    lam = (2 * np.pi * deck.measured.frequencies) ** 2
    wanted = np.log(lam / deck.values[deck.at])
    some = {n: s for n, s in strain.items() if s @ s > CHANGES.reaction}
    if not some:
        return
    best = max(some, key=lambda n: float((wanted @ some[n]) ** 2 / (some[n] @ some[n])))
    if float(some[best].max()) ** 2 > CHANGES.local * float(some[best] @ some[best]):
        return
    own = Sum(m.size)
    for card, rows, part in pieces(m):
        for name, mine in _owners(deck.model, card, rows):
            if name == best:
                own.add(part.dofs[mine], part.stiffness[mine])
    made = _scaled(deck, reduced(deck.system.transform, own.total()))
    change = _followed(deck, made, CHANGES.springs)
    order = np.sort(np.append(CHANGES.springs, 0.0))
    yield FormChange("property", f"stiffness of {best}", (), order, change)


def _scaled(deck: DeckModes, part: sparse.csr_array) -> Callable[[float], System]:
    """A deck with ln(factor) s on a part of its stiffness."""

    def made(s: float) -> System:
        stiffness = sparse.csr_array(deck.system.stiffness + (np.exp(s) - 1) * part)
        return replace(deck.system, stiffness=stiffness)

    return made


def _owners(model: Model, card: str, rows: Int) -> Iterator[tuple[str, Bool]]:
    """Names of the properties of some elements, and which have each."""
    t = model[card]
    if "PID" not in t.columns:
        yield card, np.ones(rows.size, dtype=np.bool_)
        return
    pid = t["PID"][rows]
    prefix = "PBUSH" if card in SPRUNG else "property"
    for p in np.unique(pid).tolist():
        yield f"{prefix} {p}", pid == p


def _with_ground(system: System, shapes: Float) -> Float:
    """Motion of all degrees of freedom, with the row of zeros that DOF -1 is, (full + 1, m)."""
    full = system.transform @ shapes
    return np.concatenate([full, np.zeros((1, full.shape[1]))])


def loss_factors(deck: DeckModes) -> tuple[Float, Float]:
    """Loss factors 2ζ of the paired modes by the deck's own damping, (n,), and their shares of
    strain energy in springs and bushes, which stand for joints, (n,).
    """
    shapes = deck.vectors[:, deck.at]
    lam = deck.values[deck.at]
    system = deck.system

    def along(matrix: sparse.csr_array) -> Float:
        return np.asarray(np.sum(shapes * (matrix @ shapes), axis=0))

    loss = along(system.structural) / lam + along(system.viscous) / np.sqrt(lam)
    full = _with_ground(system, shapes)
    joints = np.zeros(lam.size)
    for _, _, part in _springs(deck.model, mesh(deck.model)):
        u = full[part.dofs]
        joints += np.einsum("edk,edk->k", u, part.stiffness @ u) / lam
    return loss, joints


def _springs(model: Model, m: Mesh) -> Iterator[tuple[str, Int, ElementMatrices]]:
    """Card, rows and matrices of springs and bushes."""
    return pieces(m, {c: np.arange(len(model[c])) for c in SPRUNG if c in model})


# Shear flexibility


def _shear(deck: DeckModes) -> Iterator[FormChange]:
    """Of bars and beams, and of plates."""
    for cause, cards in (
        ("shear flexibility of bars and beams", ("PBAR", "PBEAM")),
        ("transverse shear flexibility of plates", ("PSHELL",)),
    ):
        those = [c for c in cards if c in deck.model and len(deck.model[c])]
        if not those:
            continue

        def made(s: float, those: Sequence[str] = those) -> System:
            return assemble(softer(deck.model, those, s))

        amounts = CHANGES.shear
        if made(amounts[-1]).stiffness.shape != deck.system.stiffness.shape:
            continue
        change = _followed(deck, made, amounts)
        if np.abs(change).max(initial=0.0) < CHANGES.reaction:
            continue
        fields = tuple(
            f"{c} {i} {','.join(SHEAR[c])}"
            for c in those
            for i in deck.model[c].ids.tolist()
        )
        yield FormChange("shear", cause, fields, np.array([0.0, *amounts]), change)


def softer(model: Model, cards: Sequence[str], s: float) -> Model:
    """A model with s times the shear flexibility of a rectangular section more.

    Parameters
    ----------
    cards : sequence of str
        Some of PBAR, PBEAM and PSHELL.
    """
    tables = dict(model.tables)
    for card in cards:
        t = tables[card]
        if card == "PSHELL":
            bends = t["MID2"] > 0
            rigid = bends & (t["MID3"] <= 0)
            factor = np.where(rigid, RECTANGLE / s, t["TST"] / (1 + s))
            t = t.with_column("MID3", np.where(rigid, t["MID2"], t["MID3"]))
            tables[card] = t.with_column("TST", np.where(bends, factor, t["TST"]))
            continue
        for k in SHEAR[card]:
            now = t[k]
            given = np.nan_to_num(now) > 0
            factor = np.where(given, now / (1 + s), RECTANGLE / s)
            t = t.with_column(k, factor)
        tables[card] = t
    return replace(model, tables=tables)


# Supports


def _support_springs(deck: DeckModes, m: Mesh) -> Iterator[FormChange]:
    """Held nodes on springs: along, and about, the directions that react."""
    grid = 6 * len(m.xyz)
    held = supports(m)
    held[grid:] = False
    if not held.any():
        return
    released = assemble(_released(deck.model, m, held))
    free = _places(released, deck.system)
    if free is None:
        return
    padded = released.local @ (deck.system.transform @ deck.vectors)
    lam = deck.values
    loose = np.setdiff1d(np.arange(padded.shape[0]), free)
    force = (released.stiffness @ padded - (released.mass @ padded) * lam)[loose][
        :, deck.at
    ]
    compliance = force**2 / lam[deck.at]
    direction = np.abs(released.free.direction[loose])
    size = compliance.sum(axis=1)
    for cause, turning in (("translations", False), ("rotations", True)):
        kind = (direction > 3) == turning
        reacts = kind & (size > CHANGES.reaction * size[kind].max(initial=0.0))
        slope = compliance[reacts].sum(axis=0)
        if not reacts.any() or not slope.max() > 0:
            continue
        rows = np.concatenate([free, loose[reacts]])
        own = (rows.size - reacts.sum(), slope.max())
        cut = replace(
            released,
            stiffness=released.stiffness[rows][:, rows],
            mass=released.mass[rows][:, rows],
            transform=released.transform[:, rows],
        )
        start = replace(deck, vectors=padded[rows])

        def made(s: float, cut: System = cut, own: tuple[int, float] = own) -> System:
            spring = np.zeros(cut.stiffness.shape[0])
            spring[own[0] :] = own[1] / s
            return replace(
                cut,
                stiffness=sparse.csr_array(cut.stiffness + sparse.diags_array(spring)),
            )

        amounts = CHANGES.supports
        change = _followed(start, made, amounts)
        names = released.free.take(loose[reacts])
        nodes = np.unique(names.node).tolist()
        fields = tuple(f"support of {n}" for n in nodes)
        text = f"{cause} at {len(nodes)} held nodes"
        yield FormChange(
            "supports", text, fields, np.array([0.0, *amounts]), change, joint=True
        )


def _released(model: Model, m: Mesh, held: Bool) -> Model:
    """Without the constraints of the nodes; scalar points stay held."""
    tables = {k: t for k, t in model.tables.items() if k not in ("SPC", "SPC1")}
    grid = tables["GRID"]
    if "PS" in grid.columns:
        tables["GRID"] = grid.with_column("PS", np.full(len(grid), ""))
    points = (
        m.scalar[supports(m)[held.size - m.scalar.size :]]
        if m.scalar.size
        else m.scalar
    )
    if points.size:
        sid = int(taken_sets(model, "SPC")[0])
        tables["SPC1"] = table(
            "SPC1", SID=[sid], C=np.array(["0"]), G=Ragged.of([points])
        )
    return replace(model, tables=tables)


def _places(released: System, system: System) -> Int | None:
    """Rows of the free degrees of freedom of a deck where its supports are free, too; None where
    it has others.
    """
    at = {n: i for i, n in enumerate(released.free.labels())}
    own = system.free.labels()
    if not set(own) <= at.keys():
        return None
    return np.array([at[n] for n in own], dtype=np.int64)


def _grounded(deck: DeckModes, m: Mesh) -> Iterator[FormChange]:
    """Springs to the ground, or to nodes that are held."""
    moves = np.append(np.diff(deck.system.transform.indptr) > 0, False)
    springs = Sum(m.size)
    fields = dict[str, None]()
    for card, rows, part in _springs(deck.model, m):
        node = np.where(part.dofs >= 0, part.dofs // 6, -1)
        node = np.where(moves[part.dofs], node, -1)
        single = np.array(
            [np.unique(n[n >= 0]).size == 1 for n in node], dtype=np.bool_
        )
        if not single.any():
            continue
        springs.add(part.dofs[single], part.stiffness[single])
        for name, mine in _owners(deck.model, card, rows):
            if (mine & single).any():
                fields[name] = None
    if not fields:
        return
    made = _scaled(deck, reduced(deck.system.transform, springs.total()))
    change = _followed(deck, made, CHANGES.springs)
    order = np.sort(np.append(CHANGES.springs, 0.0))
    yield FormChange("supports", "springs to the ground", tuple(fields), order, change)


# Modes along a cause


def _followed(
    deck: DeckModes, made: Callable[[float], System], amounts: Sequence[float]
) -> Float:
    """Change of ln λ of the paired modes at all amounts and at 0, ascending, (k + 1, n).

    Each amount is solved anew: on a basis of few modes a deck that is nearly rigid in some way
    (shear, a support) would lock.
    """
    count = deck.values.size
    change = {0.0: np.zeros(deck.at.size)}
    for side in (-1.0, 1.0):
        near = deck.vectors[:, deck.at]
        for s in sorted((a for a in amounts if a * side > 0), key=abs):
            system = made(s)
            found = solve_modes(Pencil(system.stiffness, system.mass), count)
            same = (near.T @ (system.mass @ found.vectors)) ** 2
            _, of = linear_sum_assignment(-same)
            near = found.vectors[:, of]
            of = deck.measured.partners(system, found, of)
            # rounding, if rigid
            lam = np.maximum(found.values[of], 1e-12 * found.values[-1])
            change[s] = np.log(lam / deck.values[deck.at])
    return np.stack([change[s] for s in sorted(change)])
