"""Regions of a deck that dissipate: what the deck's own GE and B do to its modes is the sum of what
the regions do.

A cantilever of two beams of different material on a spring with dashpots, a plate at its tip:

    |====steel====+====concrete====+==plate
                                   |
                                  bush, K3 B3
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.eigen.damped import complex_modes, project
from ringtrue.errors import InputError
from ringtrue.model.model import Model
from ringtrue.study.opened import Opened
from ringtrue.updating.damping import Mechanism, fit_poles, mode_damping
from ringtrue.updating.damping_regions import (
    Dampers,
    DampingRegion,
    dampers,
    default_regions,
    joined_dampers,
    undamped,
)

FMAX = 300.0
GE, B = {1: 0.01, 2: 0.03, 3: 0.002}, 40.0


def deck(ge: dict[int, float], b: float, bush_ge: float = 0.0) -> str:
    lines = ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{i + 1},,{0.5 * i},0.,0." for i in range(9)]
    lines += [
        f"CBAR,{i + 1},{1 if i < 4 else 2},{i + 1},{i + 2},0.,0.,1." for i in range(8)
    ]
    lines += [
        "GRID,20,,4.,1.,0.",
        "GRID,21,,4.5,1.,0.",
        "GRID,22,,4.5,0.,0.",
        "CQUAD4,30,3,9,22,21,20",
    ]
    lines += [
        "CBUSH,40,4,9,,,,,0",
        "PBUSH,4,K,1.+5,1.+5,2.+5",
        f",,B,,,{b}",
        f",,GE,{bush_ge}",
    ]
    # fields 2 to 9 of MAT1: E, G, NU, RHO, A, TREF, GE
    lines += [
        f"MAT1,{i},{e},,{nu},{rho},,,{ge.get(i, 0.0)}"
        for i, (e, nu, rho) in {
            1: ("2.+11", 0.3, 7850.0),
            2: ("3.+10", 0.2, 2500.0),
            3: ("7.+10", 0.33, 2700.0),
        }.items()
    ]
    lines += [
        "PBAR,1,1,.01,1.-5,2.-5,2.-5",
        "PBAR,2,2,.04,1.-4,1.5-4,2.-4",
        "PSHELL,3,3,.01,3",
        "SPC1,1,123456,1",
    ]
    return "\n".join([*lines, "ENDDATA"]) + "\n"


def read(folder: Path, text: str) -> Opened:
    (folder / "a.bdf").write_text(text)
    return Opened(read_deck(folder / "a.bdf"), 1.0)


def solved(
    opened: Opened,
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """λ, shapes of all nodes, and ΦᵀDΦ, ΦᵀHΦ of the deck as it is."""
    modes = opened.modes(FMAX).modes
    system = opened.analysis.system
    phi = np.asarray(system.local @ modes.shapes)
    return (
        (2 * np.pi * modes.frequencies) ** 2,
        modes.shapes,
        project(phi, system.viscous, system.structural),
    )


SPRING = ParameterSet((Parameter("spring", (CardField("PBUSH", 4, "K3"),)),))


def names(model: Model, **regions: list[int]) -> list[str]:
    return [r.name for r in default_regions(model, SPRING, regions)]


def test_the_parts_make_up_the_damping_of_the_deck(tmp_path: Path) -> None:
    opened = read(tmp_path, deck(GE, B))
    values, shapes, total = solved(opened)
    found = dampers(
        opened.model,
        default_regions(opened.model, SPRING, {}),
        values,
        shapes,
        total,
        0.01,
    )
    assert [r.name for r in found.regions] == ["MAT1 1", "MAT1 2", "MAT1 3", "spring"]
    size = np.abs(total[1]).max()
    np.testing.assert_allclose(
        sum(GE[i + 1] * found.mechanisms[i].matrix for i in range(3)),
        total[1],
        atol=1e-9 * size,
    )
    np.testing.assert_allclose(
        B * found.mechanisms[3].matrix, total[0], atol=1e-9 * np.abs(total[0]).max()
    )
    # every damper is in a region, so nothing is left beside them
    for left in found.base:
        np.testing.assert_allclose(left, 0.0, atol=1e-9 * size)


def test_damping_of_regions_that_are_not_asked_for_stays(tmp_path: Path) -> None:
    opened = read(tmp_path, deck(GE, B, bush_ge=0.05))
    values, shapes, total = solved(opened)
    wanted = DampingRegion("concrete", (CardField("MAT1", 2, "GE"),))
    found = dampers(opened.model, [wanted], values, shapes, total, 0.01)
    here = found.mechanisms[0].matrix
    np.testing.assert_allclose(found.base[0], total[0], rtol=1e-12)
    np.testing.assert_allclose(
        found.base[1] + GE[2] * here, total[1], atol=1e-9 * np.abs(total[1]).max()
    )


def test_loss_factors_and_dashpot_from_the_damping_of_the_modes(tmp_path: Path) -> None:
    """Damping ratios of the deck's complex modes give back its GE and B, with the bush's own GE
    known.
    """
    opened = read(tmp_path, deck(GE, B, bush_ge=0.5))
    values, shapes, total = solved(opened)
    regions = default_regions(opened.model, SPRING, {})
    found = dampers(opened.model, regions, values, shapes, total, 0.01)
    np.testing.assert_allclose(found.base[0], 0.0, atol=1e-9 * np.abs(total[0]).max())
    assert found.base[1][0, 0] > 0.1 * total[1][0, 0]  # the bush's GE is nobody's
    damped = complex_modes(values, *total)
    # two close modes change places
    true, at = damped.damping, np.abs(damped.shapes).argmax(axis=0)
    fit = fit_poles(values, found.mechanisms, true, 1e-4 * true, at, base=found.base)
    np.testing.assert_allclose(
        fit.coefficients, [*GE.values(), B], rtol=2e-3
    )  # the priors pull by some 1e-4
    ratio, std = mode_damping(values, found.mechanisms, fit, at)
    np.testing.assert_allclose(ratio, true, rtol=1e-3)
    assert (std < 1e-3 * true).all()
    blind = fit_poles(
        values, found.mechanisms, true, 1e-4 * true, at
    )  # without what is known of the bush
    assert np.abs(blind.coefficients / [*GE.values(), B] - 1).max() > 0.05


def test_regions_are_called_by_the_names_of_the_study(tmp_path: Path) -> None:
    model = read(tmp_path, deck(GE, B)).model
    assert names(model, beam=[1], tail=[2]) == ["beam", "tail", "MAT1 3", "spring"]
    assert names(model, beam=[1, 2]) == [
        "beam (MAT1 1)",
        "beam (MAT1 2)",
        "MAT1 3",
        "spring",
    ]


def test_cards_of_one_material_are_one_region(tmp_path: Path) -> None:
    text = deck(GE, B).replace("MAT1,2,3.+10,,0.2,2500.0", "MAT1,2,1.5+11,,0.3,7850.0")
    model = read(tmp_path, text).model
    steel, plate, spring = default_regions(model, SPRING, {})
    assert steel.name == "material of density 7850"
    assert [t.id for t in steel.targets] == [1, 2]
    assert (plate.name, spring.nature) == ("MAT1 3", "dashpot")


def test_springs_that_are_no_suspension_have_a_loss_factor(tmp_path: Path) -> None:
    model = read(tmp_path, deck(GE, B)).model
    found = default_regions(model, ParameterSet(()), {"mounts": [4]})
    assert [(r.name, r.nature) for r in found][-1] == ("mounts", "joint")


def test_springs_of_one_make_have_one_loss_factor(tmp_path: Path) -> None:
    more = [
        f"PBUSH,{i},K,{k},{k},{k}"
        for i, k in ((11, 1e5), (12, 2e5), (13, 1e5), (14, 1e5))
    ]
    model = read(
        tmp_path, deck(GE, B).replace("ENDDATA", "\n".join([*more, "ENDDATA"]))
    ).model

    def springs(
        suspension: ParameterSet, **regions: list[int]
    ) -> list[tuple[str, list[int]]]:
        found = default_regions(model, suspension, regions)
        return [
            (r.name, [t.id for t in r.targets])
            for r in found
            if r.nature == "joint" and r.targets[0].id > 10
        ]

    none = ParameterSet(())
    assert springs(none) == [("PBUSH 11,13,14", [11, 13, 14]), ("PBUSH 12", [12])]
    assert springs(none, left=[11, 12], right=[13])[1:] == [
        ("left (PBUSH 12)", [12]),
        ("right", [13]),
        ("PBUSH 14", [14]),
    ]
    hung = ParameterSet((Parameter("rope", (CardField("PBUSH", 13, "K1"),)),))
    assert springs(hung) == [("PBUSH 11,14", [11, 14]), ("PBUSH 12", [12])]


def test_undamped_takes_all_damping_and_nothing_else(tmp_path: Path) -> None:
    opened = read(tmp_path, deck(GE, B, bush_ge=0.05))
    bare = undamped(opened.model)
    system = Opened(bare, 1.0).analysis.system
    assert np.abs(system.structural.data).max(initial=0.0) == 0
    assert np.abs(system.viscous.data).max(initial=0.0) == 0
    assert abs(system.stiffness - opened.analysis.system.stiffness).max() == 0


def test_input_is_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"MAT1 1 E; allowed are loss factors"):
        DampingRegion("a", (CardField("MAT1", 1, "E"),))
    with pytest.raises(InputError, match="not both"):
        DampingRegion("a", (CardField("PBUSH", 4, "GE"), CardField("PBUSH", 4, "B3")))
    with pytest.raises(InputError, match="no target"):
        DampingRegion("a", ())
    opened = read(tmp_path, deck(GE, B))
    values, shapes, total = solved(opened)
    steel = DampingRegion("steel", (CardField("MAT1", 1, "GE"),))
    with pytest.raises(InputError, match="MAT1 1 GE is in two damping regions"):
        dampers(opened.model, [steel, steel], values, shapes, total, 0.01)
    with pytest.raises(InputError, match="MAT1 7 is not in the model"):
        dampers(
            opened.model,
            [DampingRegion("x", (CardField("MAT1", 7, "GE"),))],
            values,
            shapes,
            total,
            0.01,
        )


def test_two_decks_with_common_coefficients_tell_apart_what_one_cannot() -> None:
    """In the first deck A and B act in proportion; the second has B alone. ζ = Σ η_k κ_km / (2
    λ_m).
    """
    one, two = np.array([100.0, 900.0]), np.array([400.0, 2500.0])
    regions = [
        DampingRegion(n, (CardField("MAT1", i, "GE"),)) for i, n in ((1, "A"), (2, "B"))
    ]

    def mechanism(name: str, share: float, values: np.ndarray) -> Mechanism:
        return Mechanism(
            name, "structural", np.diag(share * values), upper=1.0, prior=0.02, std=0.02
        )

    none = np.zeros((2, 2)), np.zeros((2, 2))
    first = Dampers(
        tuple(regions), (mechanism("A", 0.4, one), mechanism("B", 0.6, one)), none
    )
    second = Dampers((regions[1],), (mechanism("B", 1.0, two),), none)
    whole = joined_dampers([first, second])
    assert [m.name for m in whole.mechanisms] == ["A", "B"]
    assert whole.mechanisms[0].matrix[2:].any() == 0
    values, truth = np.concatenate([one, two]), np.array([0.05, 0.01])
    h = sum(c * m.matrix for c, m in zip(truth, whole.mechanisms, strict=True))
    zeta = complex_modes(values, np.zeros((4, 4)), h).damping[
        np.argsort(np.argsort(values))
    ]
    fit = fit_poles(
        values, whole.mechanisms, zeta, 1e-3 * zeta, np.arange(4), base=whole.base
    )
    np.testing.assert_allclose(fit.coefficients, truth, rtol=0.01)
    alone = fit_poles(
        one, first.mechanisms, zeta[:2], 1e-3 * zeta[:2], np.arange(2), base=none
    )
    assert np.abs(alone.coefficients / truth - 1).max() > 0.1
