"""Every reader of a file that a user gives, for the files of this folder and for `scripts/fuzz`.

`seeds/<kind>/` holds small intact files, written by ringtrue, scipy, h5py, nptdms and openpyxl;
`faults/<kind>/` files that once ended the process, hung, took memory without bound or gave a
traceback, each named after its fault.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from ringtrue.api.inspection import inspect_file
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.geometry import read_recorded_model
from ringtrue.decks.nastran.results.modes import read_recorded
from ringtrue.decks.nastran.results.sensitivity import read_sensitivities
from ringtrue.errors import DataError
from ringtrue.io.campaign_tables import read_statics
from ringtrue.io.choices import read_choice
from ringtrue.io.frfs import holds_frfs, read_frfs
from ringtrue.io.matrices import read_matrices
from ringtrue.io.modes import read_modes, read_std
from ringtrue.io.records import read_record, read_runs
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.study.config import read_config
from ringtrue.study.log import read_log

CORPUS = Path(__file__).parent
SEEDS = CORPUS / "seeds"
FAULTS = CORPUS / "faults"
RATE = 200.0  # Hz, for records that do not tell theirs


def _record(path: Path) -> Any:
    return read_record(path, None if path.suffix in (".uff", ".tdms", ".wav") else RATE)


def _record_with_gaps(path: Path) -> Any:
    return read_record(path, check=False, gaps=True)


def _results(path: Path) -> Any:
    """Modes, or the deck of an OP2 that has none; both are tried of one that has the two."""
    try:
        deck = read_recorded_model(path).deck()
    except DataError:
        return read_recorded(path)
    with suppress(DataError):
        read_recorded(path)
    return deck


_OF_KIND: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "choice": (read_choice,),
    "deck": (read_deck,),
    "frf": (read_frfs, holds_frfs),
    "log": (read_log,),
    "matrices": (read_matrices,),
    "modes": (read_modes, read_std),
    "record": (_record, _record_with_gaps, read_runs),
    "results": (_results,),
    "sensitivity": (read_sensitivities,),
    "sensors": (read_sensor_sheet,),
    "statics": (read_statics,),
    "study": (read_config,),
}
READERS = {kind: (*readers, inspect_file) for kind, readers in _OF_KIND.items()}


def kinds() -> list[tuple[str, str]]:
    """Each kind of file with each ending that it has among the seeds."""
    return sorted({(path.parent.name, path.suffix) for path in SEEDS.glob("*/*")})


def seeds(kind: str, ending: str) -> list[Path]:
    """The intact files of a kind and ending."""
    return sorted((SEEDS / kind).glob(f"*{ending}"))
