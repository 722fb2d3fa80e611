"""Factors of parameters as values of a model, and as changes of the fields of its deck.

A deck whose unit of time is not the second (mm-kg-ms), with its time in seconds.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField, Parameter, ParameterSet, is_matrix
from ringtrue.core.units import UnitSystem
from ringtrue.errors import InputError, UnsupportedError, did_you_mean
from ringtrue.model.cards import END_A, END_B, MADE, NONSTRUCTURAL, resectioned
from ringtrue.model.model import Model, Ragged

# A PBEAM whose end B equals its end A keeps that.
BOTH_ENDS = dict(zip(END_A, END_B, strict=True)) | {
    f"{name}A": f"{name}B" for name in ("NSI", "M1", "M2", "N1", "N2")
}


@dataclass(frozen=True, slots=True)
class FieldChange:
    """A new value of a field of a card: `FieldChange("MAT1", 7, "E", 7.1e10)`;
    `FieldChange("DMIG", 1, "A", 0.8)` is a factor on all terms of the matrix.
    """

    card: str
    id: int
    field: str
    value: int | float | str


def resolve_target(model: Model, target: CardField | FieldChange) -> Int:
    """Rows of the target's table that it means, (k,) int64, k >= 1.

    Raises
    ------
    InputError
        If the card, the id or the field is not in the model.
    """
    if target.card not in model:
        raise InputError(
            f"no {target.card} card in the model{did_you_mean(target.card, model.tables)}"
        )
    table = model[target.card]
    ply = ply_field(target.field)
    of_list = ply is not None and isinstance(table.columns.get(ply[0]), Ragged)
    if target.field not in table.columns and not of_list:
        raise InputError(
            f"{target.card} has no field {target.field}{did_you_mean(target.field, table.columns)}"
        )
    if target.card in NONSTRUCTURAL and (table.ids == target.id).sum() > 1:
        raise InputError(
            f"{target.card} {target.id} has several values; give each a set of its own, united "
            "by NSMADD"
        )
    is_list = isinstance(table.columns.get(target.field), Ragged)
    if is_list and not is_matrix(target.card, target.field):
        raise InputError(f"{target.card} field {target.field} is a list, not one value")
    rows = np.flatnonzero(table.ids == target.id)
    if not rows.size:
        near = table.ids[
            np.argsort(abs(table.ids - target.id), kind="stable")[:3]
        ].tolist()
        raise InputError(
            f"{target.card} {target.id} is not in the model; did you mean {near[0]}? The nearest "
            f"ids are {near}"
        )
    if ply and target.field not in table.columns:
        count = int(table.ragged(ply[0]).sizes[rows].min())
        if not 1 <= ply[1] <= count:
            what = {"PBEAM": "stations between its ends"}.get(
                target.card, "dimensions" if target.card in MADE else "plies"
            )
            raise InputError(
                f"{target.card} {target.id} has no {target.field}: it has {count} {what}"
            )
    return rows


def ply_field(field: str) -> tuple[str, int] | None:
    """`T3` as ("T", 3): the column of a list and the number of its entry (a ply, a station), from
    1; None without.
    """
    found = re.fullmatch(r"([A-Z](?:[A-Z0-9]*[A-Z])?)([0-9]+)", field)
    return (found[1], int(found[2])) if found else None


def field_value(model: Model, target: CardField | FieldChange) -> Any:
    """The value of a target in the first of its rows, of one ply for a field such as T3 of a
    PCOMP; 1 for a whole matrix, whose value is the factor on it.
    """
    row = int(resolve_target(model, target)[0])
    if is_matrix(target.card, target.field):
        return np.float64(1.0)
    table = model[target.card]
    if target.field in table.columns:
        return table[target.field][row]
    name, number = ply_field(target.field) or ("", 0)
    return table.ragged(name).row(row)[number - 1]


def companions(model: Model, target: CardField) -> tuple[CardField, ...]:
    """The target, and the same field at end B and at the stations of a PBEAM that are equal
    there.
    """
    row = int(resolve_target(model, target)[0])
    twin = BOTH_ENDS.get(target.field) if target.card == "PBEAM" else None
    if twin is None:
        return (target,)
    table = model[target.card]
    same = [target]
    value = table[target.field][row]
    if table[twin][row] == value:
        same.append(replace(target, field=twin))
    if (name := f"{target.field}X") in table.columns:
        equal = np.flatnonzero(table.ragged(name).row(row) == value)
        same += [replace(target, field=f"{name}{k + 1}") for k in equal.tolist()]
    return tuple(same)


def _nominal(model: Model, parameter: Parameter, target: CardField) -> float:
    value = field_value(model, target)
    where = f"parameter {parameter.name}: {target.card} {target.id} {target.field}"
    if not isinstance(value, np.floating):
        raise InputError(f"{where} is no real quantity, got {value!r}")
    if np.isnan(value):
        raise InputError(
            f"{where} is blank in the deck; write its value there to put a factor on it"
        )
    return float(value)


def has_fields(parameter: Parameter) -> bool:
    """Whether it is a factor on the deck's own fields, as no motion of nodes or part of a property
    is.

    A lump is the mass of a card of its own, which the deck gets.
    """
    places = any(t.elements or t.step for t in parameter.targets) and not parameter.lump
    return not (parameter.shapes or parameter.substructures or places)


def _refuse_what_no_field_holds(parameter: Parameter) -> None:
    if not has_fields(parameter):
        raise InputError(
            f"parameter {parameter.name} moves nodes or places, or holds for some elements "
            "only: it has derivatives, "
            "but cannot be written into the deck's fields; give those elements a property of "
            "their own"
        )


def carried(model: Model, parameters: ParameterSet) -> ParameterSet:
    """The parameters of which a model has a target, each with the targets that it has."""
    mine = []
    for p in parameters.parameters:
        there = tuple(
            t for t in p.targets if t.card in model and t.id in model[t.card].ids
        )
        mine.append(replace(p, targets=there))
    return ParameterSet(
        tuple(p for p in mine if p.targets or p.shapes or p.substructures)
    )


def field_changes(
    model: Model, parameters: ParameterSet, factors: Float
) -> list[FieldChange]:
    """The deck's fields at the given factors (p,), in the order of the parameters; a field met
    twice gets both.

    Raises
    ------
    InputError
        If a target is not in the model, is blank or is no real quantity.
    """
    a = np.asarray(factors, dtype=np.float64)
    if a.shape != (len(parameters),):
        raise InputError(f"factors must have shape ({len(parameters)},), got {a.shape}")
    values: dict[CardField, float] = {}
    for parameter, factor in zip(parameters.parameters, a.tolist(), strict=True):
        _refuse_what_no_field_holds(parameter)
        for target in parameter.targets:
            for one in companions(model, target):
                before = values.get(one, _nominal(model, parameter, one))
                values[one] = before * factor + one.step * (factor - 1)
    return [FieldChange(t.card, t.id, t.field, v) for t, v in values.items()]


def apply_factors(model: Model, parameters: ParameterSet, factors: Float) -> Model:
    """A copy of the model with each parameter's fields times its factor (p,).

    Raises
    ------
    InputError
        If a target is not in the model, is blank or is no real quantity.
    """
    grouped: dict[tuple[str, str], list[FieldChange]] = {}
    all_changes = field_changes(model, parameters, factors)
    for change in all_changes:
        if is_matrix(change.card, change.field):
            model = _with_matrix(model, change)
        elif change.field in model[change.card].columns:
            grouped.setdefault((change.card, change.field), []).append(change)
        else:
            model = _with_ply(model, change)
    for (card, name), changes in grouped.items():
        ids = np.array([c.id for c in changes], dtype=np.int64)
        model = model.with_values(card, name, ids, np.array([c.value for c in changes]))
    return _with_sections(model, all_changes)


def _with_sections(model: Model, changes: Sequence[FieldChange]) -> Model:
    """A copy with the PBAR and PBEAM of the sections whose dimensions changed."""
    tables = dict(model.tables)
    for card, made in MADE.items():
        if ids := [c.id for c in changes if c.card == card]:
            tables[made] = resectioned(tables, card, np.array(ids))
    return replace(model, tables=tables)


def _with_matrix(model: Model, change: FieldChange) -> Model:
    """A copy with all terms of a matrix multiplied."""
    table = model[change.card]
    terms = table.ragged(change.field)
    mine = np.isin(terms.owner, resolve_target(model, change))
    scaled = Ragged(
        np.where(mine, terms.values * float(change.value), terms.values), terms.offsets
    )
    columns = {**table.columns, change.field: scaled}
    return replace(
        model, tables={**model.tables, change.card: replace(table, columns=columns)}
    )


def _with_ply(model: Model, change: FieldChange) -> Model:
    """A copy with one value of one ply replaced."""
    table = model[change.card]
    name, number = ply_field(change.field) or ("", 0)
    column = table.ragged(name)
    values = column.values.copy()
    values[column.offsets[resolve_target(model, change)] + number - 1] = change.value
    columns = {**table.columns, name: Ragged(values, column.offsets)}
    return replace(
        model, tables={**model.tables, change.card: replace(table, columns=columns)}
    )


DASHPOTS = {  # card -> fields that hold a force over a velocity
    "PDAMP": ("B",),
    "CDAMP2": ("B",),
    "CDAMP4": ("B",),
    "PVISC": ("CE", "CR"),
    "PBUSH": ("B1", "B2", "B3", "B4", "B5", "B6"),
}


def in_seconds(model: Model, unit: UnitSystem) -> Model:
    """The model with frequencies in Hz, whatever its unit of time; the same where that is the
    second.

    Of K φ = λ M φ with λ in 1/T² the mass matrix times T² has λ in 1/s²: PARAM,WTMASS takes the
    factor, and CM2 for masses of DMIG.

    Raises
    ------
    UnsupportedError
        If the deck has dashpots: their values are forces over velocities in its own unit of time.
    """
    if unit.time == 1:
        return model
    if found := _dashpots(model):
        raise UnsupportedError(
            f"{found}: dashpots of a deck whose unit of time is {unit.time:g} s are not read; "
            "leave them out, or write "
            "the deck in a system with seconds"
        )
    square = unit.time**2
    scaled = {name: model.param(name, 1.0) * square for name in ("WTMASS", "CM2")}
    return replace(model, params={**model.params, **scaled}, time=unit.time)


def _dashpots(model: Model) -> str:
    """The first thing of a model that damps by velocity; empty without one."""
    for card, fields in DASHPOTS.items():
        for name in fields:
            if card in model and (np.nan_to_num(model[card][name]) != 0).any():
                return f"{card} {name}"
    if model.case.b2gg or model.case.b2pp:
        return "B2GG or B2PP"
    return next(
        (f"PARAM {name}" for name in ("ALPHA1", "ALPHA2") if model.param(name, 0.0)), ""
    )
