"""Section properties of PBARL and PBEAML; torsion of open and closed thin walls after Young, Budynas (2002)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import pi
from types import MappingProxyType

Properties = dict[str, float]


def _rod(radius: float) -> Properties:
    _positive(radius)
    inertia = pi * radius**4 / 4
    return {"A": pi * radius**2, "I1": inertia, "I2": inertia, "J": 2 * inertia, "K1": 0.9, "K2": 0.9}


def _tube(outer: float, inner: float) -> Properties:
    _positive(outer, outer - inner)
    inertia = pi * (outer**4 - inner**4) / 4
    return {"A": pi * (outer**2 - inner**2), "I1": inertia, "I2": inertia, "J": 2 * inertia, "K1": 0.5, "K2": 0.5}


def _bar(width: float, height: float) -> Properties:
    _positive(width, height)
    return {
        "A": width * height,
        "I1": width * height**3 / 12,
        "I2": height * width**3 / 12,
        "J": _rectangle_torsion(width, height),
        "K1": 5 / 6,
        "K2": 5 / 6,
    }


def _rectangle_torsion(a: float, b: float) -> float:
    long, short = max(a, b), min(a, b)
    q = short / long
    return long * short**3 * (1 / 3 - 0.21 * q * (1 - q**4 / 12))


def _box(width: float, height: float, flange: float, web: float) -> Properties:
    """DIM3 is the thickness of the top and bottom, DIM4 that of the sides."""
    _positive(width - 2 * web, height - 2 * flange, flange, web)
    inside = width - 2 * web, height - 2 * flange
    area = width * height - inside[0] * inside[1]
    middle = width - web, height - flange
    return {
        "A": area,
        "I1": (width * height**3 - inside[0] * inside[1] ** 3) / 12,
        "I2": (height * width**3 - inside[1] * inside[0] ** 3) / 12,
        "J": 2 * flange * web * (middle[0] * middle[1]) ** 2 / (middle[0] * web + middle[1] * flange),
        "K1": 2 * inside[1] * web / area,
        "K2": 2 * inside[0] * flange / area,
    }


def _i(height: float, bottom: float, top: float, web: float, t_bottom: float, t_top: float) -> Properties:
    """DIM1 height, DIM2 and DIM3 the flange widths, DIM4 the web, DIM5 and DIM6 the flange thicknesses."""
    clear = height - t_bottom - t_top
    _positive(clear, bottom, top, web, t_bottom, t_top)
    parts = ((bottom, t_bottom, t_bottom / 2), (web, clear, t_bottom + clear / 2), (top, t_top, height - t_top / 2))
    area = sum(b * h for b, h, _ in parts)
    centre = sum(b * h * y for b, h, y in parts) / area
    between = height - (t_bottom + t_top) / 2
    return {
        "A": area,
        "I1": sum(b * h**3 / 12 + b * h * (y - centre) ** 2 for b, h, y in parts),
        "I2": sum(h * b**3 / 12 for b, h, _ in parts),
        "J": (bottom * t_bottom**3 + top * t_top**3 + between * web**3) / 3,
        "K1": clear * web / area,
        "K2": 5 / 6 * (bottom * t_bottom + top * t_top) / area,
    }


def _positive(*lengths: float) -> None:
    if min(lengths) <= 0:
        raise ValueError("the dimensions do not make a section: a thickness or a clear width is not positive")


SECTIONS: Mapping[str, tuple[int, Callable[..., Properties]]] = MappingProxyType(
    {"ROD": (1, _rod), "TUBE": (2, _tube), "BAR": (2, _bar), "BOX": (4, _box), "I": (6, _i)}
)
