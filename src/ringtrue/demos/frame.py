"""A small complete study: a frame of three storeys on fixed feet, measured on a perturbed copy of
its deck.

Three ribbed floors of CQUAD4 (2 x 2 elements, 4 x 3 m) stand on four columns of CBEAM, two
elements a storey:

        +-----+   z = 9 m   columns of steel, floors 100 mm of concrete, 3 times as stiff
        +-----+   z = 6 m   nine modes below 18 Hz: sway along x and y, torsion
        +-----+   z = 3 m
        |     |   z = 0     clamped

The truth scales the modulus of the columns storey by storey; the study must find the factors from
noisy signals.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModalModel
from ringtrue.core.signals import Channel
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import observe
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.records import write_record
from ringtrue.model.frames import positions
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.virtual.measurements import write_sheet
from ringtrue.virtual.sensors import simulate

TRUTH = {1: 0.75, 2: 1.25, 3: 1.1}
DAMPING, FMAX, RATE = 0.01, 20.0, 64.0
AMBIENT_SECONDS, BLOCK, PRETRIGGER, HITS = 400.0, 1280, 16, 3
CORNERS = ((0, 0), (2, 0), (0, 2), (2, 2))
MEASURED = CORNERS[:3]
REFERENCES = ("303+X", "303+Y")


def node(level: int, i: int, j: int) -> int:
    """Number of the node (i, j) of a floor's 3 x 3 grid; level 0 are the feet, + 50 is half a
    storey below.
    """
    return 100 * level + 1 + i + 3 * j


def _storey(level: int, modulus: float) -> list[str]:
    x, y = (0.0, 2.0, 4.0), (0.0, 1.5, 3.0)
    lines = [
        f"GRID,{node(level, i, j)},,{x[i]},{y[j]},{3.0 * level}"
        for j in range(3)
        for i in range(3)
    ]
    lines += [
        f"GRID,{node(level, i, j) + 50},,{x[i]},{y[j]},{3.0 * level - 1.5}"
        for i, j in CORNERS
    ]
    lines.append(f"$ columns of storey {level}")
    for k, (i, j) in enumerate(CORNERS):
        low, middle, high = (
            node(level - 1, i, j),
            node(level, i, j) + 50,
            node(level, i, j),
        )
        lines.append(f"CBEAM,{100 * level + 2 * k},{level},{low},{middle},1.0,0.0,0.0")
        lines.append(
            f"CBEAM,{100 * level + 2 * k + 1},{level},{middle},{high},1.0,0.0,0.0"
        )
    for k, (i, j) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        ring = [
            node(level, i, j),
            node(level, i + 1, j),
            node(level, i + 1, j + 1),
            node(level, i, j + 1),
        ]
        lines.append(f"CQUAD4,{100 * level + 10 + k},10," + ",".join(map(str, ring)))
    lines.append(f"MAT1,{level},{modulus:.7E},,0.3,7850.0 $ steel of storey {level}")
    lines.append(f"PBEAM,{level},{level},0.0140,2.2867-5,1.1667-5,0.0,2.8-5")
    return lines


def deck(factors: Mapping[int, float] | None = None) -> str:
    """The bulk data with the modulus of each storey's columns times a factor."""
    scale = factors or {}
    lines = ["SOL 103", "CEND", "TITLE = Three storeys", "SPC = 1", "BEGIN BULK"]
    feet = [node(0, i, j) for i, j in CORNERS]
    lines += [
        f"GRID,{n},,{2.0 * i},{1.5 * j},0.0"
        for n, (i, j) in zip(feet, CORNERS, strict=True)
    ]
    for level in (1, 2, 3):
        lines += _storey(level, 2.0e11 * scale.get(level, 1.0))
    lines += ["MAT1,10,3.+10,,0.2,2500.0", "PSHELL,10,10,0.1,10,3.0,10"]
    lines += ["SPC1,1,123456," + ",".join(map(str, feet)), "ENDDATA"]
    return "\n".join(lines) + "\n"


def test_model() -> TestModel:
    """Three corners of each floor, X and Y."""
    points = np.array([node(level, i, j) for level in (1, 2, 3) for i, j in MEASURED])
    xyz = np.array(
        [[2.0 * i, 1.5 * j, 3.0 * level] for level in (1, 2, 3) for i, j in MEASURED]
    )
    names = tuple(f"{p}+{a}" for p in points.tolist() for a in "XY")
    axes = np.tile(np.eye(3)[:2], (points.size, 1))
    lines = np.stack([points[:-1], points[1:]], axis=1)
    return TestModel(points, xyz, names, np.repeat(points, 2), axes, lines)


def modal(folder: Path, test: TestModel, truth: str = "") -> ModalModel:
    """The true structure (a deck, else that of TRUTH) at the channels; inputs are all channels."""
    (folder / "truth.bdf").write_text(truth or deck(TRUTH))
    model = read_deck(folder / "truth.bdf")
    with EmbeddedSolver().open(model) as analysis:
        real = analysis.modes(ModesRequest(band=(-1.0, RATE / 2))).modes
        seen = observe(
            test, model["GRID"].ids, positions(model), analysis.dofs, tolerance=0.01
        )(real.shapes)
    (folder / "truth.bdf").unlink()
    omega = 2 * np.pi * real.frequencies
    poles = omega * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))
    none = np.zeros((len(test.channels),) * 2, dtype=np.complex128)
    return ModalModel(
        poles=poles,
        shapes=seen,
        participation=seen.T / (2j * poles.imag[:, None]),
        lower=none,
        upper=none,
        outputs=tuple(Channel(c, "acceleration", "m/s^2") for c in test.channels),
        inputs=tuple(Channel(c, "force", "N") for c in test.channels),
        kind="receptance",
    )


def _channels(test: TestModel) -> list[RecordChannel]:
    at = dict(zip(test.channels, test.at.tolist(), strict=True))
    return [
        RecordChannel(
            c,
            at[c],
            "acceleration",
            "m/s^2",
            sensitivity=1.0,
            range=10.0,
            sensor="accelerometer",
        )
        for c in test.channels
    ]


def _hammer(model: ModalModel, at: int, rng: np.random.Generator) -> Float:
    """(1 + channel, sample): blocks of one impact each, the force first."""
    pulse = np.sin(np.pi * np.arange(1, 4) / 4)
    force = np.zeros((HITS, BLOCK))
    force[:, PRETRIGGER : PRETRIGGER + 3] = (
        pulse * rng.uniform(800, 1200, HITS)[:, None]
    )
    loads = np.zeros((HITS, len(model.inputs), BLOCK))
    loads[:, at] = force
    motion = np.concatenate([simulate(model, load, RATE) for load in loads], axis=1)
    motion += rng.normal(0, 1e-3 * np.abs(motion).max(), motion.shape)
    return np.vstack(
        [force.reshape(1, -1) + rng.normal(0, 0.05, (1, HITS * BLOCK)), motion]
    )


@cache
def signals(
    seed: int = 0, truth: str = ""
) -> tuple[Float, tuple[Float, ...], TestModel]:
    """The ambient record, a hammer record for each reference, and the test model."""
    test = test_model()
    with tempfile.TemporaryDirectory() as folder:
        model = modal(Path(folder), test, truth)
    rng = np.random.default_rng(seed)
    hits = tuple(_hammer(model, test.channels.index(r), rng) for r in REFERENCES)
    forces = rng.normal(0, 10.0, (len(model.inputs), int(AMBIENT_SECONDS * RATE)))
    motion = simulate(model, forces, RATE, tail=0)
    ambient = motion + rng.normal(0, 0.01 * motion.std(), motion.shape)
    return ambient, hits, test


def write_data(
    folder: Path, *, ambient: bool = True, hammer: bool = True, truth: str = ""
) -> None:
    """The campaign's folder: records, sensor sheet and log."""
    folder.mkdir(parents=True, exist_ok=True)
    quiet, hits, test = signals(truth=truth)
    write_sheet(folder / "sensors.csv", test, test.channels)
    table = _channels(test)
    tests: list[dict[str, object]] = []
    if ambient:
        write_record(folder / "ambient.h5", quiet, RATE, table)
        tests.append(
            {
                "name": "wind",
                "kind": "ambient",
                "records": [{"file": "ambient.h5", "excitation": "ambient"}],
            }
        )
    if hammer:
        records = []
        for reference, volts in zip(REFERENCES, hits, strict=True):
            name = f"hammer-{reference.replace('+', 'p')}.h5"
            force = RecordChannel(
                f"F:{reference}",
                0,
                "force",
                "N",
                sensitivity=1e-3,
                range=10.0,
                sensor="hammer",
            )
            write_record(
                folder / name,
                volts * np.r_[1e-3, np.ones(len(table))][:, None],
                RATE,
                [force, *table],
            )
            records.append(
                {
                    "file": name,
                    "excitation": "hammer",
                    "setup": 1,
                    "reference": reference,
                }
            )
        tests.append(
            {
                "name": "hammer",
                "kind": "hammer",
                "block_samples": BLOCK,
                "pretrigger_samples": PRETRIGGER,
                "records": records,
            }
        )
    (folder / "campaign.json").write_text(
        json.dumps({"sensors": {}, "tests": tests}, indent=1)
    )


MODEL = f'[model]\ndeck = "deck/frame.bdf"\nfmax = {FMAX}\n'
TEST = '[test]\nsheet = "data/sensors.csv"\nlog = "data/campaign.json"\n'
SETTINGS = (
    "[identify]\nambient_fmin = 1.0\nhammer_fmin = 1.0\nhammer_fmax = "
    "20.0\n[update]\nleft_out = 2\n"
)


def candidates(storeys: Iterable[int]) -> str:
    """The moduli of these storeys' columns as candidates."""
    form = (
        '[[candidate]]\nname = "columns {0}"\ntargets = ["MAT1 {0} E"]\nlower '
        "= 0.5\nupper = 2.0\n"
    )
    return "".join(form.format(k) for k in storeys)


FULL = MODEL + TEST + SETTINGS + candidates(TRUTH)


def write_study(
    folder: Path, toml: str = FULL, *, ambient: bool = True, hammer: bool = True
) -> Path:
    """A folder with deck, data and study.toml."""
    (folder / "deck").mkdir(parents=True, exist_ok=True)
    (folder / "deck" / "frame.bdf").write_text(deck())
    if "[test]" in toml:
        write_data(folder / "data", ambient=ambient, hammer=hammer)
    (folder / "study.toml").write_text(toml)
    return folder / "study.toml"


DEMO = f"""\
# A frame of three storeys: deck, ambient and hammer records, and what is uncertain
[study]
title = "Frame of three storeys"
use = "its response to wind"

{MODEL}
{TEST}
{SETTINGS}
# What the delivered model must reach
[correlate]
accept_percent = 3.0
accept_mac = 90.0
accept_pairs = 7

# Regions whose stiffness is uncertain
{candidates(TRUTH)}"""


def write_demo(folder: Path) -> Path:
    """The worked example of the studio: deck, records and study.toml, which is given back; what is
    there already stays.
    """
    study = folder / "study.toml"
    return study if study.exists() else write_study(folder, DEMO)
