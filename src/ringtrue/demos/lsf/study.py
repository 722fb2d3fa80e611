"""The study file of the facility: what the validation team knows, and nothing of the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ringtrue.decks.nastran.writer import format_card
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.deck import MAIN
from ringtrue.demos.lsf.facility import Builder
from ringtrue.demos.lsf.spec import DRIVE, FOUNDATION, FRAME, VESSEL

STUDY = "study.toml"
BRACES = "remodel/braces.bdf"
MEMBERS = (
    "columns",
    "girders",
    "cross beams",
)  # one assumption of the analyst: the modulus lowered for bolted joints
TEST_REGIONS = ("foundation", "frame", "vessel", "drive")

_SYSTEM = """The large spinning facility is a test bay for spinning large rotors: a ferro-concrete foundation of \
25 x 10 m on 32 air springs, a steel frame bolted to it by anchors, a vacuum vessel held in the frame, and a \
drivetrain of motor, gearbox, shaft and rotor on the drive deck above the vessel; 1,600 t in all."""

_REASON = """The site inspection found diagonal braces in bays 2 and 4 on both sides of the frame that are not in \
the deck; they are added with the section of the other braces."""

# (name, targets, lower, upper): one candidate a region; the factor multiplies the deck's value
_STIFFNESS = "K1,K2,K3,K4,K5,K6"
_TRANSLATION = "K1,K2,K3"


# spring groups whose forces are predicted
_SPRINGS = {
    "bearing mounts": ("bearing mounts",),
    "anchors": ("anchors front", "anchors middle", "anchors rear"),
    "air springs": ("air springs",),
}


def candidates() -> list[tuple[str, list[str]]]:
    """Name and targets of each candidate region."""
    single = [r for r in S.CONCRETE | S.STEEL if r not in ("haunches", "shaft", *MEMBERS)]
    modulus = [(r, [f"MAT1 {(S.CONCRETE | S.STEEL)[r]} E"]) for r in single]
    modulus.append(("frame members", [f"MAT1 {S.STEEL[r]} E" for r in MEMBERS]))
    bush = [
        (r, [f"PBUSH {pid} {_STIFFNESS if 'anchor' in r else _TRANSLATION}"])
        for r, pid in S.BUSHES.items()
        if r != "air springs"
    ]
    return modulus + bush


Region = tuple[str, list[str]]  # name and targets


@dataclass(frozen=True, slots=True)
class StudyContents:
    """What the study file says of the deck.

    Attributes
    ----------
    candidates : tuple of (str, list of str)
        Name and targets of each candidate region.
    regions : mapping of str to list of int
        Property numbers of what is drawn.
    remodelled : bool
        Whether the missing braces were found on site.
    mac : float, %
        Least mean subspace MAC that is accepted.
    rigid : int
        Least number of rigid-body modes that are paired.
    """

    candidates: tuple[Region, ...]
    regions: Mapping[str, list[int]]
    remodelled: bool = True
    mac: float = 93.0
    rigid: int = 6


def contents() -> StudyContents:
    """Those of the first example."""
    regions = {r: [pid] for r, pid in (S.CONCRETE | S.STEEL | S.BUSHES).items()}
    return StudyContents(tuple(candidates()), regions)


def braces(b: Builder) -> str:
    """The cards of the missing braces, numbered after the deck's own."""
    at = {tuple(x): n for x, n in zip(b.xyz, b.ids, strict=True)}
    eid = 290_001
    lines = []
    for y in FRAME.sides:
        for i in FRAME.bays_left_out:
            ends = [at[(FRAME.portals[i], y, FRAME.mid)], at[(FRAME.portals[i + 1], y, FRAME.top)]]
            lines.append(
                format_card(
                    "CBAR", [eid, S.STEEL["braces"], *ends, 0.0, 1.0, 0.0, None, "56", "56"]
                )
            )
            eid += 1
    return "$ Braces of bays 2 and 4, found on site\n" + "".join(lines)


def access(b: Builder) -> dict[str, list[int]]:
    """Nodes that a crew can reach with a sensor or hammer, by region."""
    out: dict[str, list[int]] = {r: [] for r in TEST_REGIONS}
    for n, part, (x, y, z) in zip(b.ids, b.part_of_node, b.xyz, strict=True):
        if part == "foundation" and _reachable(x, y, z):
            out[part].append(n)
    dependent = {f[2] for _, card, f in b.cards if card == "RBE3"}
    for part in TEST_REGIONS[1:]:
        members = [
            n
            for n, p in zip(b.ids, b.part_of_node, strict=True)
            if p == part and n not in dependent
        ]
        out[part] = members[:: 2 if part == "frame" else 3]
    return out


def _reachable(x: float, y: float, z: float) -> bool:
    top_of_wall = abs(z - FOUNDATION.wall_top) < 1e-6
    floor = (
        abs(z - FOUNDATION.slab) < 1e-6
        and FOUNDATION.wall < y < FOUNDATION.width - FOUNDATION.wall
        and FOUNDATION.end_wall < x < FOUNDATION.length - FOUNDATION.end_wall
    )
    outside = z > FOUNDATION.slab and (
        x in (0.0, FOUNDATION.length) or y in (0.0, FOUNDATION.width)
    )
    return top_of_wall or floor or outside


def _toml_list(values: list[int]) -> str:
    return "[" + ", ".join(map(str, values)) + "]"


def _remodelling(b: Builder, folder: Path) -> list[str]:
    """The section on the missing braces, whose cards are written."""
    (folder / "remodel").mkdir(parents=True, exist_ok=True)
    (folder / BRACES).write_text(braces(b))
    return [
        "[remodel]",
        'file = "deck/frame.bdf"',
        f'cards = "{BRACES}"',
        f'reason = "{_REASON}"',
        "",
    ]


def write_study(b: Builder, folder: Path, seed: int, contents: StudyContents) -> Path:
    """Write study.toml and the remodelling cards, if there are any."""
    lines = [
        "# A validation campaign: deck, tests, and what is uncertain",
        "[study]",
        'title = "Large spinning facility"',
        f'system = "{_SYSTEM}"',
        f"seed = {seed}",
        'use = "running the rotor up to its service speed"',
        "",
        "[model]",
        f'deck = "deck/{MAIN}"',
        'units = "SI"',
        "fmax = 54.0",
        "[model.regions]",
        *(f'"{name}" = {_toml_list(pids)}' for name, pids in contents.regions.items()),
        "",
        "[plan]",
        "fmax = 38.0",
        "references = 6",
        "ambient_sensors = 16",
        "[plan.candidates]",
        *(f"{name} = {_toml_list(nodes)}" for name, nodes in access(b).items()),
        "",
        "[test]",
        'sheet = "data/sensors.csv"',
        'log = "data/campaign.json"',
        'lines = "data/lines.csv"',
        "",
        "[identify]",
        "ambient_fmax = 40.0",
        "hammer_fmin = 8.0",
        "hammer_fmax = 44.0",
        "",
        "# What the delivered model must reach; the run ends with status 1 if it does not",
        "[correlate]",
        "accept_pairs = 18",
        "accept_mean_percent = 2.0",
        f"accept_mean_mac = {contents.mac}",
        "",
        *(_remodelling(b, folder) if contents.remodelled else ()),
        "# Regions whose stiffness is uncertain: each a candidate, none chosen here",
    ]
    for name, targets in contents.candidates:
        lines += ["[[candidate]]", f'name = "{name}"', f"targets = {json.dumps(targets)}"]
    for name, field in (
        ("air springs, vertical", "K3"),
        ("air springs, along", "K1"),
        ("air springs, across", "K2"),
    ):
        lines += [
            "[[suspension]]",
            f'name = "{name}"',
            f'targets = ["PBUSH {S.BUSHES["air springs"]} {field}"]',
        ]
    at = {tuple(x): n for x, n in zip(b.xyz, b.ids, strict=True)}
    lines += [
        "",
        "# What the validated model is for: running the rotor up",
        "[predict]",
        f"rotor = {at[(DRIVE.rotor, VESSEL.y, DRIVE.z)]}",
        "mass = 2500.0",
        'axis = "X"',
        "[predict.springs]",
        *(
            f'"{name}" = {_toml_list([p for r in group for p in contents.regions[r]])}'
            for name, group in _SPRINGS.items()
        ),
    ]
    (folder / STUDY).write_text("\n".join(lines) + "\n")
    return folder / STUDY
