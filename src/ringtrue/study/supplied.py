"""FRFs and modes that come from files, by the names of the sensor sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.channels import match_channels, opposite, other_names
from ringtrue.core.modes import ModeSet, Norm, Uncertainty
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.assignment import Locks
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.errors import DataError, about
from ringtrue.io.frfs import read_frfs
from ringtrue.io.modes import read_modes, read_std
from ringtrue.signal.frf_sets import exchange_by_reciprocity, join_frfs
from ringtrue.study.config import StudyConfig
from ringtrue.study.opened import Opened
from ringtrue.study.placing import mesh_points
from ringtrue.study.reference import locks, settings
from ringtrue.study.results import IdentifiedModes, IdentifyStage


def check_channels(channels: Sequence[str], sheet: TestModel, path: Path) -> None:
    """Refuse motions that have no place on the sensor sheet.

    Raises
    ------
    DataError
    """
    with about(path):
        sheet.pick(channels, forces=False)


def modes_by_sheet(
    modes: ModeSet, sheet: TestModel, path: Path
) -> tuple[ModeSet, tuple[str, ...]]:
    """Modes by the names of the sheet, rows of opposite sign turned; and which names were others.

    Raises
    ------
    DataError
        If a channel is not on the sheet, or two are the same sensor.
    """
    check_channels(modes.channels, sheet, path)
    with about(path):
        names, sign = sheet.named(modes.channels)
    return replace(
        modes, shapes=modes.shapes * sign[:, None], labels=names
    ), other_names(modes.channels, names, sign)


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
    found = []
    notes = dict[str, None]()
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
    return modes.rows(
        [c for c, i in zip(modes.channels, index.tolist(), strict=True) if i < 0]
    )


def _sides(
    channels: Sequence[Channel], sheet: TestModel, source: str
) -> tuple[tuple[Channel, ...], Float]:
    with about(source):
        names, sign = sheet.named([c.id for c in channels])
    return tuple(replace(c, id=n) for c, n in zip(channels, names, strict=True)), sign


@dataclass(frozen=True, slots=True, eq=False)
class PairedFrequencies:
    """The modes of a test without channels, with the shapes of their partners in a deck at some of
    its nodes.

    The shapes say which mode of the model a frequency belongs to while parameters change; they are
    no measurement.

    Attributes
    ----------
    modes : ModeSet
        All of the test; NaN where a mode has no partner.
    points : TestModel
        The nodes, as channels.
    taken : tuple (m,) of str
        Which mode of the deck each is taken for, or why none.
    notes : tuple of str
        The pairs, those in doubt, and modes without partner.
    """

    modes: ModeSet
    points: TestModel
    taken: tuple[str, ...]
    notes: tuple[str, ...]


def pair_frequencies(
    test: ModeSet, opened: Opened, gates: PairingSettings, locks: Locks
) -> PairedFrequencies:
    """Pair frequencies with modes of the deck as it came, and give them their shapes.

    Raises
    ------
    DataError
        If no mode has a partner.
    """
    modes = opened.modes(
        (1 + gates.frequency_gate) * float(test.frequencies.max(initial=0.0))
    ).modes
    pairing = pair_modes(test, modes.rows(()), gates, locks=locks)
    if not pairing.a.size:
        raise DataError(
            f"{test.source}: no mode of the deck within {100 * gates.frequency_gate:.3g} % of "
            "one of the test"
        )
    points = mesh_points(opened)
    look = opened.observation(points, np.inf)
    shapes = np.full((len(points.channels), len(test)), np.nan)
    shapes[:, pairing.a] = look(modes.shapes[:, pairing.b])
    pairs = list(zip(pairing.a.tolist(), pairing.b.tolist(), strict=True))
    said = dict(zip(pairing.unpaired_a.tolist(), pairing.reasons_a, strict=True))
    said |= {i: f"taken for mode {j + 1} of the deck, by frequency" for i, j in pairs}
    listed = ", ".join(f"{i + 1} for {j + 1}" for i, j in pairs)
    unpaired = (
        f"mode {i + 1} is not used: {said[i]}" for i in pairing.unpaired_a.tolist()
    )
    doubts = pairing.doubts()
    if doubts:
        doubts = (
            *doubts,
            "`lock` and `forbid` under [correlate] decide which mode a frequency is",
        )
    return PairedFrequencies(
        replace(test, shapes=shapes, labels=points.channels, norm=Norm.MODEL_SHAPES),
        points,
        tuple(said[i] for i in range(len(test))),
        (f"no shapes: mode {listed} of the deck, by frequency", *doubts, *unpaired),
    )


NO_MODES = ModeSet(np.zeros(0), np.zeros(0), np.zeros((0, 0)), ())
NOT_KNOWN = Uncertainty.independent(np.zeros(0), np.zeros(0), np.zeros((0, 0)))


def supplied_modes(
    path: Path, sheet: TestModel, unused: Sequence[str]
) -> IdentifyStage:
    """The modes of a file as those of a test, without the unused channels; standard deviations
    where the file has them.

    Raises
    ------
    DataError
        If it holds no mode or no shapes, or a channel is not on the sensor sheet.
    """
    modes, notes = modes_by_sheet(
        without_channels(read_modes(path), unused), sheet, path
    )
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if not modes.channels:
        raise DataError(
            f"{path}: frequencies without shapes: leave `sheet` out of [test], and they are "
            "compared alone"
        )
    why = (f"as given in {path.name}",) * len(modes)
    return _of_file(path, sheet, modes, why, notes)


def supplied_frequencies(
    path: Path, opened: Opened, config: StudyConfig
) -> IdentifyStage:
    """Frequencies alone as a test: they take the shapes of modes of the deck, and are no test of
    these.

    Raises
    ------
    DataError
        If the file holds no mode or shapes, or no mode has a partner in the deck.
    """
    modes = read_modes(path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if modes.channels:
        raise DataError(
            f"{path}: has shapes; give the `sheet` of [test] that says where its channels are"
        )
    found = pair_frequencies(modes, opened, settings(config), locks(config))
    return _of_file(path, found.points, found.modes, found.taken, found.notes)


def _of_file(
    path: Path,
    sheet: TestModel,
    modes: ModeSet,
    why: tuple[str, ...],
    notes: tuple[str, ...],
) -> IdentifyStage:
    std = Uncertainty.independent(*read_std(path), np.zeros(modes.shapes.shape))
    return IdentifyStage(
        test=sheet,
        ambient=IdentifiedModes(NO_MODES, NOT_KNOWN),
        hammer=IdentifiedModes(modes, std, why),
        source=f"file {path.name}",
        frf_notes=notes,
    )
