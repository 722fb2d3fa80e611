"""Section properties of PBARL and PBEAML; torsion and shear centres of thin walls after Young,
Budynas (2002).

Sections stand in the y (up), z (right) axes of the element. I12 = ∫ yz dA about the centroid. N1
and N2 are y and z of the centroid (neutral axis) from the shear centre, absent where the two
coincide. Shear areas are those of the walls along the force. The functions are generic in the kind
of number, so that a complex step passes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import pi
from types import MappingProxyType
from typing import Any

import numpy as np

Properties = dict[str, Any]


def _rod(radius: float) -> Properties:
    return _tube(radius, 0.0) | {"K1": 0.9, "K2": 0.9}


def _tube(outer: float, inner: float) -> Properties:
    _positive(outer, outer - inner)
    inertia = pi * (outer**4 - inner**4) / 4
    return {
        "A": pi * (outer**2 - inner**2),
        "I1": inertia,
        "I2": inertia,
        "J": 2 * inertia,
        "K1": 0.5,
        "K2": 0.5,
    }


def _bar(width: float, height: float) -> Properties:
    _positive(width, height)
    short, long = sorted((width, height), key=lambda x: x.real)
    q = short / long
    return {
        "A": width * height,
        "I1": width * height**3 / 12,
        "I2": height * width**3 / 12,
        "J": long * short**3 * (1 / 3 - 0.21 * q * (1 - q**4 / 12)),
        "K1": 5 / 6,
        "K2": 5 / 6,
    }


def _box(width: float, height: float, flange: float, web: float) -> Properties:
    """DIM3 is the thickness of the top and bottom, DIM4 that of the sides."""
    return _box1(
        width,
        height,
        top=flange,
        bottom=flange,
        right=web,
        left=web,
    )


def _box1(
    width: float, height: float, top: float, bottom: float, right: float, left: float
) -> Properties:
    """Four walls of different thickness; the shear centre is taken at the centroid."""
    clear = height - top - bottom
    inside = width - left - right
    _positive(clear, inside, top, bottom, right, left)
    parts = (
        (width, top, 0.0, height - top / 2),
        (width, bottom, 0.0, bottom / 2),
        (right, clear, (width - right) / 2, bottom + clear / 2),
        (left, clear, (left - width) / 2, bottom + clear / 2),
    )
    values, _ = _rectangles(*parts)
    b = width - (left + right) / 2
    h = height - (top + bottom) / 2
    area = values["A"]
    return values | {
        "J": 4 * (b * h) ** 2 / (b / top + b / bottom + h / left + h / right),
        "K1": clear * (left + right) / area,
        "K2": inside * (top + bottom) / area,
    }


# width along z, height along y, z and y of the centre
Part = tuple[float, float, float, float]


def _rectangles(*parts: Part) -> tuple[Properties, tuple[float, float]]:
    """A, I1, I2, I12 of rectangles that do not overlap, and y, z of their centroid."""
    area = sum(b * h for b, h, _, _ in parts)
    zc = sum(b * h * z for b, h, z, _ in parts) / area
    yc = sum(b * h * y for b, h, _, y in parts) / area
    return {
        "A": area,
        "I1": sum(b * h**3 / 12 + b * h * (y - yc) ** 2 for b, h, _, y in parts),
        "I2": sum(h * b**3 / 12 + b * h * (z - zc) ** 2 for b, h, z, _ in parts),
        "I12": sum(b * h * (y - yc) * (z - zc) for b, h, z, y in parts),
    }, (yc, zc)


def _open(
    parts: tuple[Part, ...],
    strips: tuple[tuple[float, float], ...],
    centre: tuple[float, float],
) -> Properties:
    """Rectangles, with the torsion of strips (length of the middle line, thickness) and a shear
    centre (y, z).
    """
    values, (yc, zc) = _rectangles(*parts)
    values["J"] = sum(length * t**3 for length, t in strips) / 3
    return values | {"N1": yc - centre[0], "N2": zc - centre[1]}


def _sheared(values: Properties, along_y: float, along_z: float) -> Properties:
    """With the shear factors K1 and K2 of these shear areas."""
    return values | {"K1": along_y / values["A"], "K2": along_z / values["A"]}


def _i(
    height: float, bottom: float, top: float, web: float, t_bottom: float, t_top: float
) -> Properties:
    """DIM1 height, DIM2 and DIM3 the flange widths, DIM4 the web, DIM5 and DIM6 the flange
    thicknesses.
    """
    clear = height - t_bottom - t_top
    _positive(clear, bottom, top, web, t_bottom, t_top)
    parts = (
        (bottom, t_bottom, 0.0, t_bottom / 2),
        (web, clear, 0.0, t_bottom + clear / 2),
        (top, t_top, 0.0, height - t_top / 2),
    )
    between = height - (t_bottom + t_top) / 2
    up = between * t_top * top**3 / (t_top * top**3 + t_bottom * bottom**3)
    values = _open(
        parts,
        ((bottom, t_bottom), (top, t_top), (between, web)),
        (t_bottom / 2 + up, 0.0),
    )
    return _sheared(values, clear * web, 5 / 6 * (bottom * t_bottom + top * t_top))


def _i1(flanges: float, web: float, clear: float, height: float) -> Properties:
    """DIM1 the flange outside the web (both sides), DIM3 the height between the flanges."""
    t = (height - clear) / 2
    return _i(height, flanges + web, flanges + web, web=web, t_bottom=t, t_top=t)


def _h(inside: float, sides: float, height: float, bar: float) -> Properties:
    """DIM1 between the uprights, DIM2 both uprights together, DIM4 the thickness of the cross
    bar.
    """
    _positive(inside, sides, height, bar)
    side = sides / 2
    z = inside / 2 + sides / 4
    parts = ((side, height, -z, 0.0), (side, height, z, 0.0), (inside, bar, 0.0, 0.0))
    values = _open(
        parts, ((height, side), (height, side), (inside + side, bar)), (0.0, 0.0)
    )
    return _sheared(values, 5 / 6 * sides * height, inside * bar)


def _cross(arms: float, upright: float, height: float, bar: float) -> Properties:
    """DIM1 both horizontal arms outside the upright, DIM2 the upright's width, DIM4 the thickness
    of the arms.
    """
    _positive(arms, upright, height, bar, height - bar)
    z = upright / 2 + arms / 4
    parts = (
        (upright, height, 0.0, 0.0),
        (arms / 2, bar, -z, 0.0),
        (arms / 2, bar, z, 0.0),
    )
    values = _open(parts, ((height, upright), (arms, bar)), (0.0, 0.0))
    return _sheared(values, 5 / 6 * upright * height, 5 / 6 * (arms + upright) * bar)


def _t(width: float, height: float, flange: float, web: float) -> Properties:
    """Flange on top."""
    clear = height - flange
    _positive(clear, width - web, flange, web)
    parts = ((width, flange, 0.0, 0.0), (web, clear, 0.0, -height / 2))
    values = _open(parts, ((width, flange), (height - flange / 2, web)), (0.0, 0.0))
    return _sheared(values, clear * web, 5 / 6 * width * flange)


def _t1(height: float, web: float, flange: float, bar: float) -> Properties:
    """Upright flange on the right (DIM1 high, DIM3 thick), web to the left (DIM2 long, DIM4
    thick).
    """
    return _turned(_t(height, web + flange, flange, bar))


def _t2(width: float, height: float, flange: float, web: float) -> Properties:
    """Flange below."""
    values = _t(width, height, flange, web)
    return values | {"N1": -values["N1"]}


def _turned(values: Properties) -> Properties:
    """A section turned by a quarter, y to z; it must be symmetric about one of its axes."""
    swapped = {"I1": "I2", "I2": "I1", "K1": "K2", "K2": "K1", "N1": "N2", "N2": "N1"}
    return {swapped.get(k, k): v for k, v in values.items()}


def _chan(width: float, height: float, web: float, flange: float) -> Properties:
    """Web on the left, flanges to the right."""
    overhang = width - web
    clear = height - 2 * flange
    _positive(overhang, clear, web, flange)
    z = web / 2 + overhang / 2
    y = (height - flange) / 2
    parts = (
        (web, height, 0.0, 0.0),
        (overhang, flange, z, y),
        (overhang, flange, z, -y),
    )
    b = width - web / 2
    h = height - flange
    out = 3 * b**2 * flange / (6 * b * flange + h * web)
    values = _open(parts, ((b, flange), (b, flange), (h, web)), (0.0, -out))
    return _sheared(values, clear * web, 2 * overhang * flange)


def _chan1(overhang: float, web: float, clear: float, height: float) -> Properties:
    return _chan(overhang + web, height, web, (height - clear) / 2)


def _chan2(leg: float, base: float, height: float, width: float) -> Properties:
    """Base below, legs upward."""
    return _turned(_chan(height, width, base, leg))


def _l(width: float, height: float, foot: float, upright: float) -> Properties:
    """Foot below, DIM3 thick; upright on the left, DIM4 thick. Shear centre where the middle lines
    meet.
    """
    clear = height - foot
    overhang = width - upright
    _positive(clear, overhang, foot, upright)
    parts = ((width, foot, overhang / 2, 0.0), (upright, clear, 0.0, height / 2))
    values = _open(
        parts, ((width - upright / 2, foot), (height - foot / 2, upright)), (0.0, 0.0)
    )
    return _sheared(values, clear * upright, overhang * foot)


def _z(flange: float, web: float, clear: float, height: float) -> Properties:
    """Upper flange to the left of the web, lower one to the right; DIM3 between the flanges."""
    t = (height - clear) / 2
    _positive(flange, web, clear, t)
    y = (height - t) / 2
    z = (flange + web) / 2
    parts = ((web, height, 0.0, 0.0), (flange, t, -z, y), (flange, t, z, -y))
    side = flange + web / 2
    values = _open(parts, ((side, t), (side, t), (height - t, web)), (0.0, 0.0))
    return _sheared(values, clear * web, 2 * flange * t)


def _hat(height: float, t: float, top: float, brim: float) -> Properties:
    """Top above, DIM3 wide; a brim of DIM4 at each web."""
    clear = height - 2 * t
    _positive(clear, top - 2 * t, t, brim)
    side = (top - t) / 2
    foot = top / 2 - t + (brim + t) / 2
    up = height - t
    parts = (
        (top, t, 0.0, up),
        *((t, clear, sign * side, up / 2) for sign in (-1, 1)),
        *((brim + t, t, sign * foot, 0.0) for sign in (-1, 1)),
    )
    strips = ((2 * side, t), (up, t), (up, t), (brim + t / 2, t), (brim + t / 2, t))
    values = _open(parts, strips, (_hat_centre(up, 2 * side, brim + t / 2), 0.0))
    return _sheared(values, 2 * clear * t, (top - 2 * t + 2 * brim) * t)


def _hat_centre(h: float, a: float, c: float) -> float:
    """Height of the shear centre above the brim, from the shear flow under a sideways force; middle
    lines.
    """
    end = a / 2 + c
    side = a / 2
    foot = (end**2 - side**2) / 2  # the flow where brim and web meet, over t
    web = foot * h + side * h**2 / 2
    lip = (end**2 * c - (end**3 - side**3) / 3) / 2
    above = a * (foot + side * h) + (side**2 * a - 2 * side**3 / 3) / 2
    return (h * above + a * web) / (2 * lip + above)


def _hat1(width: float, height: float, top: float, t: float, base: float) -> Properties:
    """A hat of thickness DIM4 and width DIM3 at its top, on a plate of DIM1 x DIM5; shear centre as
    in `_box1`.
    """
    clear = height - base - t
    _positive(clear, top - 2 * t, width - top, t, base)
    side = (top - t) / 2
    brim = (width - top) / 2
    parts = (
        (width, base, 0.0, base / 2),
        (top, t, 0.0, height - t / 2),
        *((t, clear, sign * side, base + clear / 2) for sign in (-1, 1)),
        *((brim, t, sign * (top + brim) / 2, base + t / 2) for sign in (-1, 1)),
    )
    values, _ = _rectangles(*parts)
    area = values["A"]
    h = height - (t + base) / 2
    cell = _cells([(2 * side * h, 2 * (side + h) / t + 2 * side / base)])
    lips = 2 * brim * (t + base) ** 3 / 3
    return values | {
        "J": cell + lips,
        "K1": 2 * clear * t / area,
        "K2": (top * t + width * base) / area,
    }


def _dbox(
    width: float,
    height: float,
    middle: float,
    left: float,
    web: float,
    right: float,
    *plates: float,
) -> Properties:
    """Two cells: DIM3 from the left side to the middle of the web, DIM7 to DIM10 top and bottom,
    left then right.
    """
    cells = (  # clear and middle width, left end of the plates, outer wall, top, bottom
        (middle - left - web / 2, middle - left / 2, left, left, *plates[:2]),
        (
            width - middle - right - web / 2,
            width - middle - right / 2,
            middle + web / 2,
            right,
            *plates[2:],
        ),
    )
    parts = [
        (t, height, z, height / 2)
        for t, z in ((left, left / 2), (web, middle), (right, width - right / 2))
    ]
    loops = []
    depths = []
    for clear, wide, z, wall, top, bottom in cells:
        _positive(clear, height - top - bottom, wall, web, top, bottom)
        parts += [
            (clear, top, z + clear / 2, height - top / 2),
            (clear, bottom, z + clear / 2, bottom / 2),
        ]
        depths.append(height - (top + bottom) / 2)
        loops.append(
            (wide * depths[-1], wide / top + wide / bottom + depths[-1] / wall)
        )
    shared = sum(depths) / 2 / web
    values, _ = _rectangles(*parts)
    return values | {
        "J": _cells([(a, around + shared) for a, around in loops], shared),
        "K1": (left + web + right) * height / values["A"],
        "K2": sum(b * h for b, h, _, _ in parts[3:]) / values["A"],
    }


def _cells(cells: Sequence[tuple[float, float]], shared: float = 0.0) -> Any:
    """Bredt's torsion constant of one or two cells: area and ∮ ds/t of each, and ∫ ds/t of the wall
    between them.
    """
    flow = np.diag([around for _, around in cells])
    if len(cells) > 1:
        flow[0, 1] = flow[1, 0] = -shared
    area = np.array([a for a, _ in cells])
    return (4 * area @ np.linalg.solve(flow, area)).item()


def _hexa(point: float, width: float, height: float) -> Properties:
    """DIM1 the width of each pointed side, DIM2 the whole width; torsion of a solid after
    Saint-Venant.
    """
    middle = width - 2 * point
    _positive(middle, point, height)
    area = height * (middle + point)
    i1 = middle * height**3 / 12 + point * height**3 / 24
    out = middle / 2 + point / 3
    i2 = height * middle**3 / 12 + 2 * (
        height * point**3 / 36 + height * point / 2 * out**2
    )
    return {
        "A": area,
        "I1": i1,
        "I2": i2,
        "J": area**4 / (4 * pi**2 * (i1 + i2)),
        "K1": 5 / 6,
        "K2": 5 / 6,
    }


def _positive(*lengths: float) -> None:
    if min(x.real for x in lengths) <= 0:
        raise ValueError(
            "the dimensions do not make a section: a thickness or a clear width is not positive"
        )


def _tube2(outer: float, wall: float) -> Properties:
    return _tube(outer, outer - wall)


FALLBACK: Mapping[str, Mapping[int, int]] = (
    MappingProxyType(  # a blank dimension (from 0) is that of another
        {"DBOX": {4: 3, 5: 3, 6: 3, 7: 3, 8: 5, 9: 5}}
    )
)
SECTIONS: Mapping[str, tuple[int, Callable[..., Properties]]] = MappingProxyType(
    {
        "ROD": (1, _rod),
        "TUBE": (2, _tube),
        "TUBE2": (2, _tube2),
        "BAR": (2, _bar),
        "BOX": (4, _box),
        "BOX1": (6, _box1),
        "I": (6, _i),
        "I1": (4, _i1),
        "H": (4, _h),
        "CROSS": (4, _cross),
        "T": (4, _t),
        "T1": (4, _t1),
        "T2": (4, _t2),
        "CHAN": (4, _chan),
        "CHAN1": (4, _chan1),
        "CHAN2": (4, _chan2),
        "L": (4, _l),
        "Z": (4, _z),
        "HAT": (4, _hat),
        "HAT1": (5, _hat1),
        "DBOX": (10, _dbox),
        "HEXA": (3, _hexa),
    }
)


def section(kind: str, dimensions: Sequence[Any]) -> Properties:
    """The properties of a section with these dimensions; a blank one (nan) may be that of another.

    Raises
    ------
    ValueError
        If the dimensions do not make a section.
    """
    dims = list(dimensions)
    for k, other in FALLBACK.get(kind, {}).items():
        dims[k] = dims[other] if dims[k] != dims[k] else dims[k]
    return SECTIONS[kind][1](*dims)
