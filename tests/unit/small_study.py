"""A small complete study: a frame of three storeys on fixed feet, measured on a perturbed copy of its deck.

Three floors of CQUAD4 (2 x 2 elements, 4 x 3 m) stand on four columns of CBEAM, two elements a storey:

        +-----+   z = 9 m   columns 100 x 140 mm steel, floors 100 mm of concrete
        +-----+   z = 6 m   nine modes (sway along x and y, torsion) between 2.5 and 15 Hz
        +-----+   z = 3 m
        |     |   z = 0     clamped

The truth scales the modulus of the columns storey by storey; the study must find the factors from noisy signals.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.backends.embedded import EmbeddedSolver
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import Norm
from ringtrue.core.signals import Channel
from ringtrue.correlate.observe import observe
from ringtrue.io.nastran.reader import read_deck
from ringtrue.io.records import RecordChannel, write_record
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.frames import positions
from ringtrue.model.ports import ModesRequest
from ringtrue.virtual.response import simulate

TRUTH = {"storey 1": 0.75, "storey 2": 1.25, "storey 3": 1.1}
DAMPING, FMAX = 0.01, 20.0
AMBIENT_RATE, HAMMER_RATE = 64.0, 64.0
AMBIENT_SECONDS, BLOCK, PRETRIGGER, HITS = 400.0, 1536, 16, 3
CORNERS = ((0, 0), (2, 0), (2, 2))  # triaxial points on each floor, by place in its 3 x 3 grid
REFERENCES = ("325+X", "325+Y")


def node(level: int, i: int, j: int) -> int:
    """Number of the floor's node (i, j); level 0 are the feet, odd half storeys carry 50."""
    return 100 * level + 10 * (i + 1) // 1 + (j + 3)


def deck(factors: dict[str, float]) -> str:
    """The bulk data with the modulus of each storey's columns scaled."""
    lines = ["SOL 103", "CEND", "TITLE = Three storeys", "SPC = 1", "BEGIN BULK"]
    x, y = (0.0, 2.0, 4.0), (0.0, 1.5, 3.0)
    corners = [(i, j) for i in (0, 2) for j in (0, 2)]
    lines += [f"GRID,{node(0, i, j)},,{x[i]},{y[j]},0.0" for i, j in corners]
    for level in (1, 2, 3):
        lines += [
            f"GRID,{node(level, i, j)},,{x[i]},{y[j]},{3.0 * level}" for i in range(3) for j in range(3)
        ]
        lines += [f"GRID,{node(level, i, j) + 1000},,{x[i]},{y[j]},{3.0 * level - 1.5}" for i, j in corners]
        e = 100 * level
        lines.append(f"$ columns of storey {level}")
        for i, j in corners:
            middle = node(level, i, j) + 1000
            lines.append(f"CBEAM,{e + 1},{level},{node(level - 1, i, j)},{middle},1.0,0.0,0.0")
            lines.append(f"CBEAM,{e + 2},{level},{middle},{node(level, i, j)},1.0,0.0,0.0")
            e += 2
        for k, (i, j) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
            ring = [node(level, i, j), node(level, i + 1, j), node(level, i + 1, j + 1), node(level, i, j + 1)]
            lines.append(f"CQUAD4,{e + 10 + k},10," + ",".join(map(str, ring)))
        modulus = 2.1e11 * factors.get(f"storey {level}", 1.0)
        lines.append(f"MAT1,{level},{modulus:.9E},,0.3,7850.0   $ columns of storey {level}".replace("   $", ",   $"))
        lines.append(f"PBEAM,{level},{level},0.014,1.1667-5,2.2867-5,0.0,2.8-5")
    lines += ["MAT1,10,3.+10,,0.2,2500.0", "PSHELL,10,10,0.1,10,,10"]
    lines.append("SPC1,1,123456," + ",".join(str(node(0, i, j)) for i, j in corners))
    lines.append("ENDDATA")
    return "\n".join(lines) + "\n"
