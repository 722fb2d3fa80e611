"""From a built facility to files: a Nastran deck, a main file and one include a part; and the study
file, which holds what the validation team knows, and nothing of the truth.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from ringtrue.decks.nastran.writer import format_card
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.facility import VARIANTS, ZONE, Builder, Value
from ringtrue.demos.lsf.spec import DRIVE, FOUNDATION, FRAME, SITE, VESSEL, Spec

CYLINDER = 20  # the vessel's frame
FILES = ("foundation", "springs", "frame", "vessel", "drive", "site")
MAIN = "lsf.bdf"
_CENTRE = (VESSEL.y, FRAME.mid)
_ABOUT = {
    "foundation": "Ferro-concrete foundation: slab, long walls, end walls, haunches",
    "springs": "Array of 32 air springs, slab to ground",
    "frame": "Steel frame: six portals on anchors, girders, braces, brackets",
    "vessel": "Vacuum vessel: cylinder, rings, dished heads, mounts. Frame 20: r, theta, along x",
    "drive": "Drivetrain: deck, motor, gearbox, bearings, shaft, rotor",
    "site": "Platform, piping, cabinets, hung parts",
}


def write_facility(b: Builder, folder: Path, title: str) -> Path:
    """Write the deck; returns the path of its main file."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [p for p in FILES if any(c[0] == p for c in b.cards)]
    for part in parts:
        (folder / f"{part}.bdf").write_text("".join(_part(b, part)))
    (folder / "properties.bdf").write_text("".join(properties(b)))
    (folder / MAIN).write_text(_main(title, parts))
    return folder / MAIN


def _main(title: str, parts: list[str]) -> str:
    frames = format_card(
        "CORD2C",
        [CYLINDER, 0, 0.0, *_CENTRE, 1.0, *_CENTRE, 0.0, VESSEL.y + 1.0, FRAME.mid],
    )
    tilted = format_card(
        "CORD2R", [10, 0, 0.0, 0.0, 0.0, 0.0, -0.5, 0.8660254, 1.0, 0.0, 0.0]
    )
    control = "".join(
        [
            format_card("EIGRL", [1, None, None, 40]),
            format_card("PARAM", ["AUTOSPC", "YES"]),
            format_card("PARAM", ["K6ROT", 100.0]),
            format_card("PARAM", ["GRDPNT", 0]),
        ]
    )
    includes = "".join(f"INCLUDE '{p}.bdf'\n" for p in [*parts, "properties"])
    return (
        f"$ {title}\n$ Units: m, kg, s, N. x along the bay, y across, z up.\nSOL "
        f"103\nCEND\nTITLE = {title}\n"
        f"ECHO = NONE\nMETHOD = 1\nBEGIN BULK\n{control}"
        f"$ Frame of the vessel: z along the bay, theta from y to z\n{frames}"
        f"$ Frame of the motor mounts: inclined by 30 degrees about x\n{tilted}{includes}ENDDATA\n"
    )


def _part(b: Builder, part: str) -> Iterable[str]:
    yield f"$ {'-' * 70}\n$ {_ABOUT[part]}\n$ {'-' * 70}\n"
    mine = [i for i, p in enumerate(b.part_of_node) if p == part]
    xyz = np.array([b.xyz[i] for i in mine]).reshape(-1, 3)
    frame = 0
    if part == "vessel":
        frame = CYLINDER
        d = xyz - (0.0, VESSEL.y, FRAME.mid)
        theta = np.degrees(np.arctan2(d[:, 2], d[:, 1]))
        xyz = np.stack([np.hypot(d[:, 1], d[:, 2]), theta, d[:, 0]], axis=1)
    for i, x in zip(mine, xyz.tolist(), strict=True):
        yield format_card(
            "GRID", [b.ids[i], frame or None, *(round(v, 6) for v in x), frame or None]
        )
    last = ""
    for where, card, fields in b.cards:
        if where != part:
            continue
        if card != last:
            yield f"$ {card}\n"
            last = card
        yield format_card(card, list(fields))


def _property(spec: Spec, region: str, pid: int, mid: int) -> str:
    if region in S.CONCRETE:
        return format_card("PSOLID", [pid, mid])
    if region in S.SHELL:
        return format_card("PSHELL", [pid, mid, S.SHELL[region], mid, None, mid])
    s = S.SECTIONS[region].times(spec.section.get(region, 1.0))
    if region in ("girders", "braces", "vessel rings", "shaft"):
        head: list[Value] = [pid, mid, s.area, s.i1, s.i2, s.j, None, None]
        return format_card("PBAR", [*head, *([None] * 8), s.k1, s.k2])
    # end A, no stress points, one station at end B with the same section, then the shear factors
    beam: list[Value] = [pid, mid, s.area, s.i1, s.i2, None, s.j, None, *([None] * 8)]
    return format_card("PBEAM", [*beam, "YESA", 1.0, *([None] * 6), s.k1, s.k2])


def properties(b: Builder) -> Iterable[str]:
    """Materials, shell, solid, beam and bush properties."""
    yield "$ Properties and materials: one of each a region, with equal numbers\n"
    rng = np.random.default_rng([b.spec.seed, 78])
    used = {f[1] for _, card, f in b.cards if card in _WITH_PROPERTY}
    for region, base in {**S.CONCRETE, **S.STEEL}.items():
        yield f"$ {region}\n"
        variants = range(VARIANTS if b.spec.scatter else 1)
        for zone, v in product(range(b.spec.zones), variants):
            pid = base + ZONE * zone + 1000 * v
            factor = b.spec.zone_factor(region, zone)
            if b.spec.scatter:
                factor *= float(np.exp(b.spec.scatter * rng.standard_normal()))
            if pid not in used:
                continue
            yield _property(b.spec, region, pid, pid)
            modulus = b.spec.modulus[region] * factor
            density = b.spec.density[region]
            nu = 0.2 if region in S.CONCRETE else 0.3
            loss = b.spec.loss.get(region) or None
            yield format_card(
                "MAT1", [pid, modulus, None, nu, density, None, None, loss]
            )
    done = set()
    for region, pid, factor in b.bushes:
        if pid in done:
            continue
        done.add(pid)
        if pid == S.BUSHES[region] or pid % 100 == 1:
            yield f"$ {region}\n"
        k: list[Value] = [factor * v if v else None for v in b.spec.bush[region]]
        card: list[Value] = [pid, "K", *k]
        if region == "air springs" and any(b.spec.dashpot):
            card += [None, "B", *b.spec.dashpot, None, None, None]
        elif b.spec.loss.get(region):
            card += [None, "GE", b.spec.loss[region]]
        yield format_card("PBUSH", card)
    if b.spec.site:
        yield from _site_properties()


_WITH_PROPERTY = {"CHEXA", "CPENTA", "CQUAD4", "CTRIA3", "CBEAM", "CBAR", "CBUSH"}


def _site_properties() -> Iterable[str]:
    yield "$ Partition wall, platform, pipe and what they hang on\n"
    wall = SITE.partition
    floor = SITE.platform
    pipe = SITE.pipe
    yield format_card("PSOLID", [wall, wall])
    yield format_card("MAT1", [wall, 2.9e10, None, 0.2, 2450.0, None, None, 0.01])
    yield format_card("PSHELL", [floor, floor, 0.060, floor, None, floor])
    yield format_card("MAT1", [floor, 4.0e10, None, 0.3, 1500.0, None, None, 0.01])
    yield format_card("PBEAM", [pipe, pipe, 0.0200, 6.0e-4, 6.0e-4, None, 1.2e-3, 60.0])
    yield format_card("MAT1", [pipe, 2.0e11, None, 0.3, 7850.0, None, None, 0.01])
    clamp = [3.0e8] * 3 + [1.0e7] * 3
    yield format_card("PBUSH", [SITE.pipe_clamp, "K", *clamp, None, "GE", 0.05])
    hose = SITE.hose_bridge * (2 * np.pi * 1.92) ** 2
    crane = SITE.crane * (2 * np.pi * 2.24) ** 2
    stiff = 6.0e9
    for link, along, across in (
        (SITE.hose_link, stiff, hose),
        (SITE.crane_link, crane, stiff),
    ):
        k: list[Value] = [along, across, stiff, None, None, None]
        yield format_card("PBUSH", [link, "K", *k, None, "GE", 0.06])


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
    single = [
        r for r in S.CONCRETE | S.STEEL if r not in ("haunches", "shaft", *MEMBERS)
    ]
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
            ends = [
                at[(FRAME.portals[i], y, FRAME.mid)],
                at[(FRAME.portals[i + 1], y, FRAME.top)],
            ]
            lines.append(
                format_card(
                    "CBAR",
                    [eid, S.STEEL["braces"], *ends, 0.0, 1.0, 0.0, None, "56", "56"],
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
        lines += [
            "[[candidate]]",
            f'name = "{name}"',
            f"targets = {json.dumps(targets)}",
        ]
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
