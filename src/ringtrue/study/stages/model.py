"""The deck and its modes."""

from __future__ import annotations

from ringtrue.checks.deck import check_deck
from ringtrue.checks.materials import autospc_findings, mass_properties, whole_mass
from ringtrue.core.iterate import Progress, part
from ringtrue.model.cards import MADE
from ringtrue.model.model import Model
from ringtrue.study.results import ModelStage
from ringtrue.study.scene import make_scene, scene_modes
from ringtrue.study.session import Session


def run(session: Session, progress: Progress) -> ModelStage:
    """Read, check, weigh and solve the deck."""
    progress(0.0, "reading the deck")
    opened = session.initial
    report = check_deck(opened.model, units=session.deck.units)
    progress(0.2, "modes of the deck")
    result = opened.modes(session.first_fmax, part(progress, 0.2, 1.0))
    held = (
        any(c in opened.model for c in ("SPC", "SPC1"))
        or (opened.model["GRID"]["PS"] != "").any()
    )
    findings = [*report.findings, *autospc_findings(opened.analysis.system)]
    mass = whole_mass(opened.model) if held else mass_properties(opened.analysis.system)
    scene = make_scene(opened.model, session.deck.regions, session.length)
    return ModelStage(
        title=opened.model.case.title,
        files=tuple(opened.model.files),
        units=session.deck.units,
        cards=_counted(opened.model),
        findings=tuple(str(f) for f in findings),
        nodes=len(opened.model["GRID"]),
        dof=int(opened.analysis.system.stiffness.shape[0]),
        mass=mass,
        modes=scene_modes(result.modes, scene),
        residuals=result.residuals,
        proof=result.proof,
        scene=scene,
    )


def _counted(model: Model) -> dict[str, int]:
    """Cards of the deck by name; a PBAR that a PBARL makes is none."""
    count = {card: len(table) for card, table in sorted(model.tables.items())}
    for source, made in MADE.items():
        if source in count:
            count[made] -= count[source]
    return {card: n for card, n in count.items() if n}
