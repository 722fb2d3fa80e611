"""Which parameters a region of a model offers to an updating."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ringtrue.core.display import Displayed
from ringtrue.errors import InputError
from ringtrue.model.model import Model
from ringtrue.study.config_sections import target_words
from ringtrue.updating.selection.candidates import CandidateSettings, Kind
from ringtrue.updating.selection.generation import generate

KINDS: tuple[Kind, ...] = ("material", "property", "spring", "mass")  # those that a deck can hold


@dataclass(frozen=True, eq=False)
class RegionParameter(Displayed):
    """A factor on fields of a deck that changes elements of a region.

    Attributes
    ----------
    name : str
        Card, number and field.
    what : str
        In words, with the nominal value.
    targets : tuple of str
        As `targets` of a `[[candidate]]`, such as "MAT1 7 E".
    lower, upper, std : float
        Bounds of the factor and prior standard deviation of its logarithm, as usual for it.
    elements : tuple of int
        All elements that it changes.
    inside : int
        How many of them are in the region.
    """

    name: str
    what: str
    targets: tuple[str, ...]
    lower: float
    upper: float
    std: float
    elements: tuple[int, ...]
    inside: int


def region_parameters(model: Model, elements: Collection[int]) -> tuple[RegionParameter, ...]:
    """The factors that change elements of a region: materials, properties, springs, masses.

    Parameters
    ----------
    model : Model
    elements : collection of int
        Numbers of elements.

    Returns
    -------
    tuple of RegionParameter
        Those first that change little besides the region.

    Examples
    --------
    >>> import ringtrue as rt
    >>> rt.region_parameters(rt.read_deck(rt.example_deck()), [11])[0].targets
    ('PELAS 1 K',)
    """
    wanted = {int(e) for e in elements}
    try:
        made = generate(model, CandidateSettings(KINDS, model.units))
    except InputError:  # the deck offers none
        return ()
    found = []
    for c in made:
        inside = len(wanted.intersection(c.elements))
        words = target_words(c.parameter)
        if not inside or not words:
            continue
        p = c.parameter
        entry = RegionParameter(
            name=c.name,
            what=c.what,
            targets=tuple(words),
            lower=float(f"{p.lower:.4g}"),
            upper=float(f"{p.upper:.4g}"),
            std=p.std,
            elements=c.elements,
            inside=inside,
        )
        found.append(entry)
    return tuple(sorted(found, key=lambda r: -r.inside / len(r.elements)))
