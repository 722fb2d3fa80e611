"""What a test has measured, by the names that its sensor sheet has for the channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ringtrue.core.arrays import Float
from ringtrue.core.channels import match_channels, opposite, other_names
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import about
from ringtrue.io.frfs import read_frfs
from ringtrue.signal.frf_sets import exchange_by_reciprocity, join_frfs


def check_channels(channels: Sequence[str], sheet: TestModel, path: Path) -> None:
    """Refuse motions that have no place on the sensor sheet.

    Raises
    ------
    DataError
    """
    with about(path):
        sheet.pick(channels, forces=False)


def modes_by_sheet(modes: ModeSet, sheet: TestModel, path: Path) -> tuple[ModeSet, tuple[str, ...]]:
    """Modes by the names of the sheet, rows of opposite sign turned; and which names were others.

    Raises
    ------
    DataError
        If a channel is not on the sheet, or two are the same sensor.
    """
    check_channels(modes.channels, sheet, path)
    with about(path):
        names, sign = sheet.named(modes.channels)
    return replace(modes, shapes=modes.shapes * sign[:, None], labels=names), other_names(
        modes.channels, names, sign
    )


def frfs_by_sheet(frfs: FrfSet, sheet: TestModel) -> tuple[FrfSet, tuple[str, ...]]:
    """FRFs by the names of the sheet, those of opposite sign turned; and which names were others.

    A channel that the sheet does not have keeps its name.

    Raises
    ------
    DataError
        If two responses, or two references, are the same sensor.
    """
    outputs, out_sign = _sides(frfs.outputs, sheet, frfs.source)
    inputs, in_sign = _sides(frfs.inputs, sheet, frfs.source)
    before = [c.id for c in (*frfs.outputs, *frfs.inputs)]
    after = [c.id for c in (*outputs, *inputs)]
    if before == after:
        return frfs, ()
    data = frfs.data * out_sign[:, None] * in_sign
    notes = other_names(before, after, [*out_sign, *in_sign])
    return replace(frfs, data=data, outputs=outputs, inputs=inputs), notes


def supplied_frfs(
    paths: Sequence[Path], sheet: TestModel, lost: Sequence[str]
) -> tuple[FrfSet | None, tuple[str, ...]]:
    """The FRFs of all files without the channels `lost` as one set, by the names of the sheet; None
    without a file.

    Responses are at the many points. Beside it a note on channels that have other names in the
    files.

    Raises
    ------
    DataError
        If the files do not fit together, or a response is not on the sensor sheet.
    """
    if not paths:
        return None, ()
    either_way = [*lost, *filter(None, map(opposite, lost))]
    found, notes = [], dict[str, None]()
    for p in paths:
        frfs, other = frfs_by_sheet(read_frfs(p, either_way), sheet)
        found.append(frfs)
        notes.update(dict.fromkeys(other))
    frfs, _ = exchange_by_reciprocity(found[0] if len(found) == 1 else join_frfs(found))
    check_channels([c.id for c in frfs.outputs], sheet, paths[0])
    return frfs, tuple(notes)


def without_channels(modes: ModeSet, lost: Sequence[str]) -> ModeSet:
    """Modes at the channels that are not among the lost ones, by whatever sign these are named."""
    index, _ = match_channels(modes.channels, lost)
    return modes.rows([c for c, i in zip(modes.channels, index.tolist(), strict=True) if i < 0])


def _sides(
    channels: Sequence[Channel], sheet: TestModel, source: str
) -> tuple[tuple[Channel, ...], Float]:
    with about(source):
        names, sign = sheet.named([c.id for c in channels])
    return tuple(replace(c, id=n) for c, n in zip(channels, names, strict=True)), sign
