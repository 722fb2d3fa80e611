"""The crew's log: which records there are and what excited them, and the data sheets of the sensor
types.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ringtrue.errors import DataError
from ringtrue.io.foreign.parsers import read_json
from ringtrue.study.config import explain


class _Entry(BaseModel):
    """A part of the log. A crew may note down more, but nothing that reads like a key of ours."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    @model_validator(mode="after")
    def _spelled(self) -> Self:
        known = type(self).model_fields
        for key in self.model_extra or ():
            # 0.8: of the names of two keys: one is a misspelling of the other
            if near := get_close_matches(key, known, 1, 0.8):
                raise ValueError(f"unknown key {key!r}; did you mean {near[0]!r}?")
        return self


class SensorType(_Entry):
    """The data sheet of a sensor."""

    quantity: str = ""
    corner_hz: float = Field(default=0.0, ge=0)
    damping: float | None = Field(default=None, gt=0)
    noise: float = Field(default=0.0, ge=0)  # density at its output, unit/sqrt(Hz)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.corrected and self.damping is None:
            raise ValueError("a velocity sensor with a corner needs its damping")
        return self

    @property
    def corrected(self) -> bool:
        """Whether its corner is taken out of records."""
        return self.quantity == "velocity" and self.corner_hz > 0


class _Details(_Entry):
    """What a record says of itself, or its test for all of its records."""

    rate_hz: float | None = Field(default=None, gt=0)
    date: str = ""
    temperature_c: float | None = Field(default=None, gt=-273.15)
    channels: list[str] = []
    setup: int | str = ""
    reference: str | None = None
    force_channel: str = ""
    block_samples: int | None = Field(default=None, gt=0)
    pretrigger_samples: int | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _cut(self) -> Self:
        block = self.block_samples
        pre = self.pretrigger_samples
        if (block is None) != (pre is None):
            raise ValueError(
                f"{'block' if block is None else 'pretrigger'}_samples missing; give both or none"
            )
        if block is not None and pre is not None and pre >= block:
            raise ValueError(
                f"pretrigger_samples {pre} must be less than block_samples {block}"
            )
        return self


class LogRecord(_Details):
    file: str = Field(min_length=1)
    excitation: str


class _Test(_Details):
    name: str
    kind: Literal["ambient", "hammer", "shaker"]
    records: list[LogRecord]

    @model_validator(mode="before")
    @classmethod
    def _shared(cls, data: Any) -> Any:
        """What a test says holds for each of its records that says nothing else."""
        if not (
            isinstance(data, Mapping)
            and isinstance(records := data.get("records"), list)
        ):
            return data
        mine = {k: v for k, v in data.items() if k in _Details.model_fields}
        return {
            **data,
            "records": [
                {**mine, **r} if isinstance(r, Mapping) else r for r in records
            ],
        }


class _Log(_Entry):
    sensors: dict[str, SensorType] = {}
    tests: list[_Test]


class Logged(LogRecord):
    """One record, with the test it belongs to."""

    path: Path
    test: str
    kind: str

    @property
    def temperature(self) -> float:
        """°C; NaN where none was noted down."""
        return float("nan") if self.temperature_c is None else self.temperature_c

    @property
    def name(self) -> str:
        """The name of its file without folder and ending."""
        return self.path.stem

    def goes_on_in(self, later: Logged) -> bool:
        """Whether another may be the next file of one measurement: the same but for numbers in its
        name, which rise.
        """
        known = [k for k in (*LogRecord.model_fields, "test", "kind") if k != "file"]
        (words, numbers), (others, further) = (
            _parts_of_name(self.path),
            _parts_of_name(later.path),
        )
        same = all(getattr(self, k) == getattr(later, k) for k in known)
        return same and words == others and numbers < further


def _parts_of_name(path: Path) -> tuple[list[str], list[int]]:
    """What stays in the names of the files of one measurement, and what counts on."""
    words = re.split(r"\d+", path.stem)
    numbers = re.findall(r"\d+", path.stem)
    return [str(path.parent), path.suffix, *words], [int(n) for n in numbers]


def read_log(path: Path) -> tuple[list[Logged], dict[str, SensorType]]:
    """The crew's log: its records, and the data sheets of the sensor types.

    Raises
    ------
    DataError
        If the file is not there, is not JSON, or has an entry that is missing or not allowed.
    """
    try:
        log = _Log.model_validate(read_json(path))
    except ValidationError as e:
        raise DataError(explain(path, e, _Log, "log")) from e
    records = [
        Logged(
            **{k: getattr(r, k) for k in LogRecord.model_fields},
            path=path.parent / r.file,
            test=t.name,
            kind=t.kind,
        )
        for t in log.tests
        for r in t.records
    ]
    if not records:
        raise DataError(f"{path}: no record in any test")
    return records, log.sensors
