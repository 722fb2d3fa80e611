"""What a deck holds and what is wrong with it, before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from ringtrue.api.models import in_units
from ringtrue.checks import Finding
from ringtrue.checks.deck import check_deck as checked
from ringtrue.checks.deck import readable
from ringtrue.checks.elements import free_edges_in_words, shell_edges
from ringtrue.checks.materials import (
    GroundCheck,
    MassProperties,
    autospc_findings,
    check_units,
    ground_check,
    ground_findings,
    mass_properties,
    unconstrained,
)
from ringtrue.core.display import Displayed
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.decks.nastran.reader import Survey, survey
from ringtrue.errors import RingtrueError, UnsupportedCard
from ringtrue.fem.assembly import assemble
from ringtrue.model.cards import effects
from ringtrue.model.frames import extent
from ringtrue.model.model import Model


@dataclass(frozen=True, eq=False)
class RigidCheck:
    """How a deck moves as a rigid body.

    Attributes
    ----------
    mass : MassProperties
        Of the whole structure, held or not, in units of the deck.
    ground : GroundCheck
    free_edges : str
        Of shells, in words.
    autospc : mapping of str to list of int
        Components that AUTOSPC holds, and the nodes.
    """

    mass: MassProperties
    ground: GroundCheck
    free_edges: str
    autospc: Mapping[str, list[int]]


@dataclass(frozen=True, eq=False)
class DeckCheck(Displayed):
    """What a deck holds and what is wrong with it.

    Attributes
    ----------
    model : Model
        What is read of it.
    cards, kept : mapping of str to int
        All cards, and those that are kept but not used.
    unsupported : mapping of str to str
        Cards that are not read, with the first place of each.
    missing : mapping of str to tuple of str
        What the model lacks without them.
    findings : tuple of Finding
        Errors first. Those of a card have its name and the numbers of what is meant.
    rigid : RigidCheck, optional
        None where the deck cannot be assembled; a finding says why.
    size : float
        Diagonal of the nodes, units of the deck; 0 without nodes.
    implausible : mapping of str to tuple of Finding
        For each unit system what would not be plausible in it: none where the deck may be in it.
    """

    UNITS: ClassVar[Mapping[str, str]] = {}

    model: Model
    cards: Mapping[str, int]
    kept: Mapping[str, int]
    unsupported: Mapping[str, str]
    missing: Mapping[str, tuple[str, ...]]
    findings: tuple[Finding, ...]
    rigid: RigidCheck | None
    size: float
    implausible: Mapping[str, tuple[Finding, ...]]

    @property
    def sound(self) -> bool:
        """Whether all is read and there is no error."""
        return not self.unsupported and all(
            f.severity != "error" for f in self.findings
        )


def check_deck(deck: str | Path, *, units: str = "") -> DeckCheck:
    """What a deck holds: cards, mass, ground check, free edges, and findings with their places.

    Parameters
    ----------
    deck : str or Path
    units : str
        The unit system that it is said to be in, as in `read_deck`; empty: moduli, densities and
        size are not judged by one.

    Raises
    ------
    DeckError
        On anything malformed.
    InputError
        If the unit system is not known.

    Examples
    --------
    >>> import ringtrue as rt
    >>> found = rt.check_deck(rt.example_deck(), units="SI")
    >>> found.sound, found.rigid.mass.mass
    (True, 3.0)
    """
    found = survey(deck)
    findings = _findings(found, units)
    unsupported = dict(found.unsupported)
    model = readable(found.model) if unsupported else found.model
    there = "GRID" in model and len(model["GRID"]) > 0
    rigid = _rigid_of_readable(model, findings, unsupported) if there else None
    return DeckCheck(
        model=in_units(model, units) if units else model,
        cards=dict(found.cards),
        kept=dict(found.model.kept),
        unsupported=unsupported,
        missing={card: tuple(effects(card)) for card in unsupported},
        findings=tuple(findings),
        rigid=rigid,
        size=float(extent(model)) if there else 0.0,
        implausible={name: tuple(check_units(model, name)) for name in UNIT_SYSTEMS},
    )


def _findings(found: Survey, units: str) -> list[Finding]:
    """What is wrong with the deck, as far as it is read."""
    partial = bool(found.unsupported)
    findings = list(checked(found.model, units, partial=partial).findings)
    extra = {(f.file, f.line) for f in findings}
    lost = []
    for fault in (f for f in found.faults if (str(f.path), f.line) not in extra):
        place = f"{fault.path}:{fault.line}: " if fault.line else f"{fault.path}: "
        text = str(fault).removeprefix(place)
        lost.append(Finding("error", text, str(fault.path), fault.line or 0))
    return lost + findings


def _rigid_of_readable(
    model: Model, findings: list[Finding], unsupported: dict[str, str]
) -> RigidCheck | None:
    """`_rigid` without the cards that assembly refuses, which are added to the unsupported; None
    where it is not possible, with a finding of the reason unless others say what is wrong.
    """
    try:
        return _rigid(model, findings, partial=bool(unsupported))
    except UnsupportedCard as e:
        if e.card not in model:
            findings.append(Finding("error", str(e)))
            return None
        place = f"{e.path}:{e.line}" if e.line else ""
        unsupported[e.card] = ": ".join(t for t in (place, e.why) if t)
        rest = {card: t for card, t in model.tables.items() if card != e.card}
        return _rigid_of_readable(
            readable(replace(model, tables=rest)), findings, unsupported
        )
    except RingtrueError as e:  # the rest of the check is worth more than the mass
        if not any(f.severity == "error" for f in findings):
            findings.append(Finding("error", str(e)))
        return None


def _rigid(model: Model, findings: list[Finding], *, partial: bool) -> RigidCheck:
    """Mass properties, ground check, free edges and what AUTOSPC holds; findings of these are added
    to the findings, but of what cards that are not read may hold.
    """
    held = assemble(model)
    system = assemble(unconstrained(model))
    ground = ground_check(system)
    mass = mass_properties(system)
    findings += [] if partial else autospc_findings(held)
    findings += ground_findings(model, ground)
    free = "" if partial else free_edges_in_words(shell_edges(model))
    return RigidCheck(mass, ground, free, held.autospc.by_components())
