"""The section of study.toml that plans a test."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ringtrue.errors import did_you_mean

Method = Literal["independence", "qr", "auto-mac", "information"]
Directions = Literal["triaxial", "uniaxial", "normal"]
Strike = Literal["worst", "greedy", "qr", "mif"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def rising(name: str, low: float | None, high: float | None) -> None:
    """Refuse a band that does not rise from 0 or more."""
    if (low is not None and low < 0) or (high is not None and high <= (low or 0.0)):
        raise ValueError(f"{name}fmin {low} and {name}fmax {high}: must be 0 <= fmin < fmax")


class PlanSection(_Section):
    """What to plan."""

    fmin: float = 0.0
    fmax: float = Field(default=80.0, gt=0)
    sensors: int = Field(
        default=45, gt=0
    )  # measuring points for the hammer test, sensors where not triaxial
    at_hand: int = Field(
        default=0, ge=0
    )  # sensors recorded at once: with more planned, setups; 0: all at once
    ambient_sensors: int = Field(default=12, gt=0)  # measuring points for the ambient tests
    references: int = Field(default=4, gt=0)
    candidates: dict[str, list[int]] = {}  # region -> candidate nodes; empty: the skin of the model
    # m; "even": half of the spacing that the structure gives so many points; not given: that, but
    # at most 0.8 m
    min_distance: Annotated[float, Field(ge=0)] | Literal["even"] | None = None
    damping: float = Field(default=0.01, gt=0)  # expected, for the resolution
    max_auto_mac: float = Field(default=0.25, gt=0, lt=1)
    method: Method = "independence"
    modes: list[
        int
    ] = []  # target modes by their number in the deck, from 1; empty: all of the band
    effective_mass: float = Field(
        default=0.0, ge=0, lt=1
    )  # of the band, modes with such a share of the mass, or
    sensitive: float = Field(
        default=0.0, ge=0
    )  # with such a sum of |∂λ/∂a|/λ over the candidates of the updating, or
    telling: int = Field(
        default=0, ge=0
    )  # so many modes that tell those candidates apart; all 0: every mode
    kinetic: dict[
        str, float
    ] = {}  # region of `candidates` -> share of kinetic energy of a target mode
    weigh: bool = False  # points that carry kinetic energy come first
    cost: dict[
        str, float
    ] = {}  # region of `candidates` -> cost of a point, 1 if not named; for qr and information
    draws: int = Field(
        default=0, ge=0
    )  # of the prior of the candidates of the updating; for information
    precision: float = Field(
        default=0.1, gt=0
    )  # relative, wanted of the lowest damping in an ambient record
    error: float = Field(default=0.05, gt=0)  # relative random, wanted of an FRF, with
    coherence: float = Field(
        default=0.98, gt=0, lt=1
    )  # such a coherence: the number of blows at each reference
    ambient: bool = True  # keep points for ambient tests
    boxes: list[list[float]] = []  # x0 y0 z0 x1 y1 z1 in m; candidates lie in one of them
    keep_out: list[list[float]] = []  # boxes without candidates
    exclude: list[int] = []  # nodes that are no candidates
    fixed: list[int] = []  # nodes that are measured in any case
    redundancy: int = Field(default=0, ge=0)  # points that may fail
    directions: Directions = "triaxial"  # of a sensor: X Y Z, one of them, off the skin
    # driving-point residues by the mean of the logarithms, or by the mode that is excited worst; QR
    # of M·Φ; force appropriation by the mode indicator
    strike: Strike = "greedy"
    strike_at: list[
        int
    ] = []  # candidate nodes that can be struck; what is chosen there is measured. Empty: any point
    suspension: int = Field(default=0, ge=0)  # points to hang from; 0: not asked for
    sensor_mass: float = Field(default=0.0, ge=0)  # kg a point, for the shift of the frequencies
    lines: Literal["mesh", "nearest"] = (
        "mesh"  # the drawing of the points follows the mesh, or joins neighbours
    )
    trials: int = Field(default=0, ge=0)  # virtual tests of the plan
    # N/√Hz at each reference in the virtual tests; not given: what leaves the expected coherence
    background: Annotated[float, Field(ge=0)] | None = None
    ambient_force: float = Field(
        default=0.0, ge=0
    )  # N/√Hz along each channel: virtual ambient tests, too, if > 0

    @model_validator(mode="after")
    def _band(self) -> Self:
        rising("", self.fmin, self.fmax)
        if any(len(b) != 6 for b in (*self.boxes, *self.keep_out)):
            raise ValueError("boxes and keep_out: a box is x0 y0 z0 x1 y1 z1")
        if (self.cost and self.method not in ("qr", "information")) or (
            self.draws and self.method != "information"
        ):
            raise ValueError(
                "cost goes with method qr or information, draws with information; method is "
                f"{self.method}"
            )
        if self.at_hand == 1:
            raise ValueError(
                "at_hand: setups need two sensors, one that stays and one that roves; 0: all at "
                "once"
            )
        if self.ambient_force and not self.trials:
            raise ValueError("ambient_force is that of virtual ambient tests; give trials, too")
        if lost := [r for r in (*self.kinetic, *self.cost) if r not in self.candidates]:
            raise ValueError(
                f"no region {lost[0]!r} in candidates{did_you_mean(lost[0], self.candidates)}"
            )
        if any(v <= 0 for v in (*self.cost.values(), *self.kinetic.values())):
            raise ValueError("cost and kinetic: must be > 0")
        if any(m < 1 for m in self.modes):
            raise ValueError("modes: the first mode of the deck is 1")
        return self
