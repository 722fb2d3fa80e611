"""Members of a bay with a brace, and a frame whose joints give against one with springs in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import ringtrue as rt
from ringtrue.api.models import open_model
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.members import end_springs
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.study.form import CAUSES

#   3 --4-- 5     feet 1 and 8 are held; the column on the left has two elements, the arm 5-6
#   |       |---6 ends freely, the column on the right changes its section at 7
#   2       7
#   1       8
NODES = {
    1: (0, 0),
    2: (0, 2),
    3: (0, 4),
    4: (3, 4),
    5: (6, 4),
    6: (8, 3),
    7: (6, 2),
    8: (6, 0),
}
BARS = ((1, 1, 2), (1, 2, 3), (2, 3, 4), (2, 4, 5), (2, 5, 6), (1, 5, 7), (3, 7, 8))
INERTIA = {1: 3e-5, 2: 2e-5, 3: 4e-5}
E = 2.1e11
SPRUNG = {(0, 0), (1, 1), (2, 0), (3, 1), (4, 0), (5, 0), (5, 1), (6, 0), (6, 1)}
LENGTH = (4.0, 4.0, 6.0, 6.0, 5**0.5, 2.0, 2.0)


def frame(folder: Path, joint: float = 0.0) -> Model:
    """With springs of `joint` EI/L at the ends of members; 0 is rigid."""
    lines = [
        "SOL 103",
        "CEND",
        "SPC = 1",
        "BEGIN BULK",
        "SPC1,1,123456,1,8",
        f"MAT1,1,{E},,.3,7850.",
    ]
    lines += [f"GRID,{n},,{x}.,0.,{z}." for n, (x, z) in NODES.items()]
    lines += [f"PBAR,{p},1,.01,{i},{i / 2},1.-5" for p, i in INERTIA.items()]
    for k, (pid, *ends) in enumerate(BARS):
        for side in (0, 1):
            if joint and (k, side) in SPRUNG:
                x, z = NODES[ends[side]]
                new = 100 + 2 * k + side
                lines += [
                    f"GRID,{new},,{x}.,0.,{z}.",
                    f"RBE2,{1000 + new},{ends[side]},123,{new}",
                ]
                spring = joint * E * INERTIA[pid] / LENGTH[k]
                for c in (4, 5, 6):
                    lines.append(
                        f"CELAS2,{10 * new + c},{spring:.9E},{ends[side]},{c},{new},{c}"
                    )
                ends[side] = new
        lines.append(f"CBAR,{k + 1},{pid},{ends[0]},{ends[1]},0.,1.,0.")
    path = folder / "frame.bdf"
    path.write_text("\n".join([*lines, "ENDDATA", ""]))
    return rt.read_deck(path)


def test_members_have_springs_where_they_meet_others(tmp_path: Path) -> None:
    model = frame(tmp_path)
    found = end_springs(mesh(model), {"CBAR": np.arange(len(BARS))}, rigid=10.0)
    for k, (pid, *_) in enumerate(BARS):
        for side in (0, 1):
            true = 10 * E * INERTIA[pid] / LENGTH[k] if (k, side) in SPRUNG else np.inf
            np.testing.assert_allclose(found[k, side], true, rtol=1e-6)


def test_joints_that_give_are_springs_between_members_and_nodes(tmp_path: Path) -> None:
    rigid = rt.solve_modes(frame(tmp_path), count=8).frequencies
    edits = [edit for cause, edit, _ in CAUSES if cause == "joints that give"]
    for soften, joint in zip(edits, (25.0, 8.0), strict=True):
        (soft,) = soften(open_model(frame(tmp_path)))
        true = rt.solve_modes(frame(tmp_path, joint), count=8).frequencies
        found = soft.analysis.modes(ModesRequest(8)).modes.frequencies
        np.testing.assert_allclose(found, true, rtol=1e-7)
        assert (true < 0.99 * rigid).sum() >= 4
