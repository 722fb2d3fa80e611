"""Mode shapes as the screens show them."""

from __future__ import annotations

from ringtrue.core.modes import ModeSet
from ringtrue.plots.scene import Shown, modes
from ringtrue.studio.session import StudioSession
from ringtrue.study.results import CorrelateStage, FinalStage, IdentifyStage, ModelStage
from ringtrue.viewer.view import View


def pair_view(session: StudioSession, state: str, pair: tuple[int, int]) -> View | None:
    """The shapes of a test mode and an FE mode over each other; None where they are not stored."""
    stage: CorrelateStage | None = session.stage("correlate")
    model: ModelStage | None = session.stage("model")
    found: IdentifyStage | None = session.stage("identify")
    if stage is None or found is None or state == "ambient and hammer":
        return None
    final: FinalStage | None = session.stage("final")
    seen: ModeSet
    skin: ModeSet | None
    if state == "final" and final is not None:
        seen, skin = final.observed, final.modes
    elif state == "remodelled":
        seen, skin = stage.fe_remodelled, None
    else:
        seen, skin = stage.fe_initial, model.modes if model is not None else None
    test = stage.reference.elastic
    t, k = pair
    if t >= len(test) or k >= len(seen):
        return None
    drawn = skin is not None and k < len(skin)
    shown = Shown(
        state,
        f"test {t + 1} · FE {k + 1}",
        f"test {test.frequencies[t]:.4g} Hz, FE {seen.frequencies[k]:.4g} Hz",
        fe=(skin, k) if skin is not None and drawn else None,
        test=(test, t),
        seen=(seen, k),
    )
    scene = model.scene if model is not None and drawn else None
    return modes(scene, found.test, [shown])


def pair_shapes(session: StudioSession, state: str, pair: tuple[int, int]) -> None:
    """Show them."""
