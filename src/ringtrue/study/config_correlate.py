"""The section of study.toml that says how modes are paired and when they are accepted."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ringtrue.correlation.assignment import PairingSettings

Tam = Literal["irs", "guyan", "hybrid", "serep", "craig-bampton"]


OF_SHAPES = {
    "accept_mac",
    "accept_mean_mac",
    "accept_orthogonality",
    "accept_off_diagonal",
    "expand",
}


class CorrelateSection(BaseModel):
    """Pairing and acceptance."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    mac_gate: float = Field(default=0.6, gt=0, lt=1)
    # |f_FE − f_test|/f_test; None: 0.4, and beyond it modes that look alike and like no other
    frequency_gate: float | None = Field(default=None, gt=0)
    lock: list[
        str
    ] = []  # "3:7": test mode 3 belongs to mode 7 of the initial deck, and to what becomes of it
    forbid: list[str] = []  # that do not belong together
    rigid_below: float | None = (
        None  # Hz: rigid-body modes lie below; None: the largest gap decides
    )
    tolerance: float | None = Field(
        default=None, gt=0
    )  # m, sensor to node; None: 3 % of the deck, or a mesh width
    match: Literal["nearest", "rigid"] = (
        "nearest"  # a sensor off the nodes: the nearest node, or the nodes around it
    )
    align: Literal["", "points", "nearest"] = (
        ""  # lay the test onto the deck by points numbered as nodes, or by nearest
    )
    accept_percent: float = 5.0
    # judged where results are shown: no stage depends on them
    accept_hz: float | None = Field(default=None, exclude=True)
    accept_mac: float | None = Field(default=80.0, exclude=True)
    accept_pairs: int | None = Field(default=None, ge=0, exclude=True)
    accept_mean_percent: float | None = Field(default=None, ge=0, exclude=True)
    accept_mean_mac: float | None = Field(default=None, ge=0, le=100, exclude=True)
    accept_orthogonality: float = Field(
        default=90.0, ge=0, le=100
    )  # %, least cross-orthogonality of a pair
    accept_off_diagonal: float = Field(
        default=10.0, ge=0, le=100
    )  # %, largest between different modes
    # the mass at the channels that orthogonality is over
    tam: Tam = "irs"
    # of the test shapes to the whole deck, for the error indicators (hybrid if not given) and the
    # report (none)
    expand: Literal["", "hybrid", "serep", "guyan", "dynamic"] = ""

    @field_validator("lock", "forbid")
    @classmethod
    def _pairs(cls, value: list[str]) -> list[str]:
        if wrong := [v for v in value if not re.fullmatch(r"[1-9]\d*:[1-9]\d*", v)]:
            raise ValueError(
                f"{wrong[0]!r} is no pair of a test mode and a mode of the deck, from 1, such as "
                "'3:7'"
            )
        return value

    def gates(self, confidence: float = 0.5) -> PairingSettings:
        """The gates of the pairing; a frequency gate that is given holds for all pairs."""
        gates = PairingSettings(mac_gate=self.mac_gate, min_confidence=confidence)
        own = self.frequency_gate
        return gates if own is None else replace(gates, frequency_gate=own, reach=1.0)
