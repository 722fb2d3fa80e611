"""`modes`, `check` and `reduce`: what a deck holds, its modes, and a part of it as matrices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ringtrue.api.checking import RigidCheck, check_deck
from ringtrue.api.models import read_deck, solve_modes
from ringtrue.api.reduction import reduce_model
from ringtrue.checks import Finding
from ringtrue.checks.materials import DIRECTIONS
from ringtrue.checks.mesh import MeshErrors, mesh_errors
from ringtrue.cli.show import (
    Json,
    file_to,
    json_file,
    one_of,
    out,
    progress,
    rows,
    write_json,
)
from ringtrue.core.arrays import Float
from ringtrue.core.iterate import part
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.errors import ConfigError
from ringtrue.io.modes import WRITTEN, dump_modes
from ringtrue.model.case_control import condenses
from ringtrue.model.ports import ModesResult
from ringtrue.reduction.components import ReductionSettings
from ringtrue.solvers.registry import EMBEDDED, solver, time_limits

ROUNDING = 1e-12  # of the largest value: below is 0

Deck = Annotated[Path, typer.Argument(help="Nastran bulk data, with its includes.")]

TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time-limit",
        metavar="SECONDS",
        help="Longest run of a --solver that is another program.",
        min=1e-3,
        show_default=", ".join(
            f"{name} {limit:g}" for name, limit in time_limits().items()
        ),
    ),
]


def modes(
    deck: Deck,
    n: Annotated[
        int | None,
        typer.Option(
            "-n",
            help="The lowest N modes; else what EIGRL or EIGR asks for, else 20.",
            min=1,
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="All modes from F0 to F1, Hz.")
    ] = None,
    solver_name: Annotated[
        str,
        typer.Option(
            "--solver",
            help="The engine: embedded, mystran, nastran, slepc or a plug-in.",
        ),
    ] = "embedded",
    time_limit: TimeLimit = None,
    ranks: Annotated[
        int | None, typer.Option(help="Processes of the slepc engine.", min=1)
    ] = None,
    launcher: Annotated[
        str,
        typer.Option(
            help="What starts them, in place of --ranks, such as 'srun -n 64'.",
            metavar="COMMAND",
        ),
    ] = "",
    damped: Annotated[
        bool,
        typer.Option(
            "--complex",
            help="Complex modes, by the dashpots, GE, PARAM G and DMIG of the deck.",
        ),
    ] = False,
    mesh: Annotated[
        bool,
        typer.Option(
            "--mesh-error",
            help="How far the mesh puts each frequency off, by refining it once.",
        ),
    ] = False,
    target: Annotated[
        Path | None, file_to("--out", "Write the modes", *WRITTEN)
    ] = None,
    json: Json = None,
) -> int:
    """Natural modes of a deck, with the proof that none is missing; or its complex modes
    (--complex).

    Example: ringtrue modes wing.bdf --band 0 50 --json modes.json
    """
    if mesh and (damped or solver_name != EMBEDDED):
        raise ConfigError(
            "--mesh-error is for natural modes of the embedded engine: leave out --complex and "
            "--solver"
        )
    with progress("modes") as show:
        show(0.0, f"reading {deck}")
        model = read_deck(deck)
        if mesh and condenses(model):
            raise ConfigError(
                "--mesh-error refines whole meshes; this deck is condensed (ASET, superelements)"
            )
        found = solve_modes(
            model,
            band=band,
            count=n,
            engine=solver_name,
            damped=damped,
            ranks=ranks,
            launcher=launcher,
            time_limit=time_limit,
            progress=part(show, 0.2, 0.6 if mesh else 1.0),
        )
        result = found.result
        refined = solver(EMBEDDED, progress=part(show, 0.6, 1.0))
        errors = mesh_errors(model, result.modes, refined) if mesh else None
    if json:
        extra: dict[str, Any] = {"complete": result.complete, "proof": result.proof}
        extra["autospc"] = result.autospc.by_components()
        if errors:
            extra["mesh_error"] = [
                None if np.isnan(e) else e for e in errors.relative.tolist()
            ]
        with json_file(json) as file:
            dump_modes(file, result.modes, more=extra)
    if target:
        # it loads all that reads measurements
        from ringtrue.api.measurements import write_modes

        write_modes(target, result.modes)
    if json != "-":
        _print_modes(deck, result, damped, errors)
        if loose := found.loose:
            more = f" and {len(loose) - 6} more" if len(loose) > 6 else ""
            out.print(
                f"held by AUTOSPC, without stiffness: {' '.join(loose[:6])}{more}"
            )
    # a program that hands back no matrices, and may count nothing
    unproved = bool(np.isnan(result.residuals).all())
    return 0 if result.complete or unproved else 1


def _print_modes(
    deck: Path, result: ModesResult, damped: bool, errors: MeshErrors | None
) -> None:
    """A line a mode, of complex ones with the damping ratio, and with the error of the mesh where
    it was asked for.
    """
    columns = {"f [Hz]": [f"{f:.5g}" for f in result.modes.frequencies]}
    if damped:
        columns["damping [%]"] = [f"{100 * z:.4g}" for z in result.modes.damping]
    if errors:
        columns["mesh error [%]"] = [
            "-" if np.isnan(e) else f"{100 * e:+.2f}" for e in errors.relative
        ]
    columns["residual"] = ["-" if np.isnan(r) else f"{r:.1e}" for r in result.residuals]
    body = [(i + 1, *row) for i, row in enumerate(zip(*columns.values(), strict=True))]
    rows(
        f"{deck}: {len(body)} {'complex ' if damped else ''}modes",
        ("#", *columns),
        body,
    )
    out.print(result.proof)
    if damped:
        out.print(
            "motions that do not oscillate, rigid-body ones among them, are not listed"
        )
    if errors:
        out.print(errors.in_words())


def check(
    deck: Deck,
    units: Annotated[
        str,
        one_of(
            "--units",
            UNIT_SYSTEMS,
            "Unit system of the deck, to judge moduli, densities and size by",
        ),
    ] = "",
    json: Json = None,
) -> int:
    """What a deck holds: cards, mass, centre of gravity, inertia, ground check, free edges and
    findings.

    Example: ringtrue check wing.bdf --units mm-t-s
    """
    found = check_deck(deck, units=units)
    summary: dict[str, Any] = {
        "deck": str(deck),
        "cards": dict(found.cards),
        "kept": dict(found.kept),
        "unsupported": dict(found.unsupported),
        "missing": {card: list(lost) for card, lost in found.missing.items()},
        **_rigid_json(found.rigid),
    }
    summary["findings"] = [
        {"severity": f.severity, "text": f.text, "file": f.file, "line": f.line}
        for f in found.findings
    ]
    if json:
        write_json(summary, json)
    if json != "-":
        _print_check(deck, summary)
    return 0 if found.sound else 1


def _rigid_json(rigid: RigidCheck | None) -> dict[str, Any]:
    """Plain values; nothing where the deck cannot be assembled."""
    if rigid is None:
        return {}
    energy = dict(zip(DIRECTIONS, rigid.ground.energy.tolist(), strict=True))
    return {
        "mass": rigid.mass.mass,
        "centre_of_gravity": rigid.mass.cg.tolist(),
        "inertia": rigid.mass.inertia.tolist(),
        "ground_check": {
            "strain_energy": energy,
            "relative": rigid.ground.relative.tolist(),
            "ok": rigid.ground.ok,
        },
        "free_edges": rigid.free_edges,
        "autospc": dict(rigid.autospc),
    }


def _clean(values: list[Any], scale: float = 0.0) -> Float:
    """With 0 for what is rounding against the largest, and against `scale`."""
    x = np.asarray(values, dtype=np.float64)
    return np.where(np.abs(x) > ROUNDING * np.abs(x).max(initial=scale), x, 0.0)


def _print_check(deck: Path, summary: dict[str, Any]) -> None:
    rows(f"{deck}: cards", ("card", "number"), sorted(summary["cards"].items()))
    if "mass" in summary:
        cg = ", ".join(f"{x:.4g}" for x in _clean(summary["centre_of_gravity"]))
        read = " of what is read" if summary["unsupported"] else ""
        out.print(f"mass{read} {summary['mass']:.6g}, centre of gravity ({cg})")
        # what is taken off to be about it
        moved = summary["mass"] * sum(x * x for x in summary["centre_of_gravity"])
        for row in _clean(summary["inertia"], moved):
            out.print("inertia  " + "  ".join(f"{x: .5e}" for x in row))
        if summary["ground_check"]["ok"]:
            out.print("ground check: rigid-body motion takes no strain energy")
        if summary["free_edges"]:
            out.print(f"edges    {summary['free_edges']}")
    for card, place in summary["unsupported"].items():
        missing = ", ".join(summary["missing"][card])
        out.print(f"unsupported {card}: {place}; missing without it: {missing}")
    for f in summary["findings"]:
        out.print(str(Finding(**f)))
    if not summary["findings"] and not summary["unsupported"]:
        out.print("no findings")


def reduce(
    deck: Deck,
    keep: Annotated[
        list[str],
        typer.Option(
            help="Points to join the part by, such as 101,102, or single DOFs such as 101+Z."
        ),
    ],
    below: Annotated[
        float,
        typer.Option(metavar="HZ", help="The error is stated for modes up to here."),
    ],
    target: Annotated[
        Path, typer.Option("--out", metavar="STEM", help="Write STEM.asm and STEM.pch.")
    ],
    method: Annotated[
        str, typer.Option(help="craig-bampton, guyan, or dynamic (exact at --at).")
    ] = "craig-bampton",
    n: Annotated[
        int | None,
        typer.Option(
            "-n", help="Component modes; else all up to twice --below.", min=0
        ),
    ] = None,
    at: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Frequency of the dynamic condensation."),
    ] = None,
    number: Annotated[
        int, typer.Option(help="Of the superelement.", min=1, max=999)
    ] = 1,
    op4: Annotated[
        bool,
        typer.Option(
            "--op4", help="The matrices in STEM.op4, in full precision, not as DMIG."
        ),
    ] = False,
    json: Json = None,
) -> int:
    """Reduce a part to some of its points, and say what that does to each of its modes.

    The files are those of EXTSEOUT: INCLUDE the one in the bulk data of the whole, the other before
    its ENDDATA.

    Example: ringtrue reduce wing.bdf --keep 101,102 --below 50 --out wing
    """
    # imports all of a study, which the other commands can do without
    from ringtrue.study.summary import finite

    settings = ReductionSettings(below=below, method=method, modes=n, at=at)  # type: ignore[arg-type]
    with progress("reduce") as show:
        show(0.1, f"reducing {deck}")
        part = reduce_model(deck, keep, settings, number=number)
    written = part.write(target, op4=op4)
    if json:
        names = ("frequencies", "reduced", "deviations", "captured")
        numbers = {name: getattr(part, name).tolist() for name in names}
        write_json(finite({"kept": part.kept, "bound": part.bound, **numbers}), json)
    if json != "-":
        body = [
            (i + 1, f"{f:.5g}", _text(r, ".5g"), _text(d, ".2g"), f"{100 * c:.4g}")
            for i, (f, r, d, c) in enumerate(
                zip(
                    part.frequencies,
                    part.reduced,
                    part.deviations,
                    part.captured,
                    strict=True,
                )
            )
        ]
        heads = ("#", "f [Hz]", "reduced [Hz]", "off [%]", "energy captured [%]")
        rows(f"{deck}: {len(part.kept)} of its degrees of freedom", heads, body)
        others = "lower ones by less" if at is None else f"one at {at:g} Hz not at all"
        out.print(
            f"in any whole, a mode at {below:g} Hz moves by at most {part.bound:.2g} %, {others}"
        )
        out.print(f"written: {' '.join(map(str, written))}", soft_wrap=True)
        if op4:
            unit = part.external.unit
            out.print(
                f"above SOL: ASSIGN INPUTT4='{written[-1]}', UNIT={unit}",
                soft_wrap=True,
            )
    return 0


def _text(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "missing"
