"""From a built facility to a Nastran deck on disk: a main file and one include a part."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np

from ringtrue.decks.nastran.writer import format_card
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.facility import VARIANTS, ZONE, Builder, Value
from ringtrue.demos.lsf.spec import FRAME, SITE, VESSEL, Spec

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


def write(b: Builder, folder: Path, title: str) -> Path:
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
        "CORD2C", [CYLINDER, 0, 0.0, *_CENTRE, 1.0, *_CENTRE, 0.0, VESSEL.y + 1.0, FRAME.mid]
    )
    tilted = format_card("CORD2R", [10, 0, 0.0, 0.0, 0.0, 0.0, -0.5, 0.8660254, 1.0, 0.0, 0.0])
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
            yield format_card("MAT1", [pid, modulus, None, nu, density, None, None, loss])
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
