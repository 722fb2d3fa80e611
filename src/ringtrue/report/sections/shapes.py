"""Mode shapes in motion."""

from __future__ import annotations

from ringtrue.core.modes import ModeSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.plots.scene import Shown, modes
from ringtrue.report.parts import Scene3D, Section, Stages, fixed


def section(data: Stages) -> Section | None:
    """One viewer for all stages and modes."""
    scene = data.model.scene if data.model is not None else None
    shown = _final(data) + _before(data) + _expanded(data) + _test_only(data)
    if not shown:
        return None
    text = "Mode shapes"
    if scene is not None:
        text += ": the model's skin, coloured by its displacement"
    if data.test is not None:
        text += "; the test's wireframe in orange"
        text += (
            ", turned and scaled onto the model's shape" if scene is not None else ""
        )
    view = Scene3D(modes(scene, data.test, shown), f"{text}.", 540)
    return Section("shapes", "Mode shapes", [view])


def first(data: Stages) -> Scene3D | None:
    """The first pair of the final model and the test, for the headline."""
    shown = _final(data)
    if not shown or data.model is None:
        return None
    caption = "First pair, final model."
    if data.test is not None:
        caption = "First pair: test in orange over the final model."
    return Scene3D(modes(data.model.scene, data.test, shown[:1]), caption, 350)


def _paired(
    data: Stages,
    stage: str,
    table: CorrelationTable,
    test: ModeSet,
    *,
    seen: ModeSet,
    skin: ModeSet | None,
) -> list[Shown]:
    out = []
    names = data.names
    for r in table.rows():
        t = r.test - 1
        k = r.fe - 1
        label = f"test {r.test} · FE {r.fe} · {fixed(r.test_hz, 2)} Hz"
        if name := names.get(r.test_hz):
            label += f" · {name}"
        info = f"test {fixed(r.test_hz, 3)} Hz, FE {fixed(r.fe_hz, 3)} Hz, "
        info += f"Δf {fixed(r.deviation_percent, 2, sign=True)} %"
        fe = (skin, k) if skin is not None and k < len(skin) else None
        if table.frequency_only:
            out += [Shown(stage, label, info, fe, None)] if fe else []
            continue
        info += f", MAC {fixed(r.mac_percent, 1)} %"
        info += (
            f", subspace MAC {fixed(r.subspace_mac_percent, 1)} %" if r.subspace else ""
        )
        out.append(
            Shown(
                stage,
                label,
                info,
                fe=fe,
                test=(test, t),
                seen=(seen, k),
            )
        )
    return out


def _final(data: Stages) -> list[Shown]:
    if data.final is None or data.reference is None:
        return []
    f = data.final
    stage = "Final model and test"
    return _paired(data, stage, f.table, data.reference, seen=f.observed, skin=f.modes)


def _before(data: Stages) -> list[Shown]:
    """The modes of the deck before the updating: with those of the test, or alone."""
    c = data.correlate
    m = data.model.modes if data.model is not None else None
    if c is None:
        return [_alone("Model", m, k, (m, k), None) for k in range(len(m))] if m else []
    test = c.reference.elastic
    out: list[Shown] = []
    if m:
        stage = "Initial model and test"
        out += _paired(data, stage, c.initial, test, seen=c.fe_initial, skin=m)
    if c.remodelling is not None:
        stage = "Remodelled and test"
        out += _paired(data, stage, c.remodelled, test, seen=c.fe_remodelled, skin=None)
    return out


def _expanded(data: Stages) -> list[Shown]:
    """The test shapes spread over the model, as the study asks for."""
    if data.correlate is None or (e := data.correlate.expanded) is None:
        return []
    test = data.correlate.reference.elastic
    out = []
    for k, (f, misfit) in enumerate(
        zip(test.frequencies.tolist(), e.misfit.tolist(), strict=True)
    ):
        info = f"{fixed(f, 3)} Hz, expanded ({e.method}), misses the readings by "
        info += f"{fixed(100 * misfit, 1)} %"
        label = f"mode {k + 1} · {fixed(f, 2)} Hz"
        out.append(
            Shown(
                "Test, expanded",
                label,
                info,
                fe=(e.modes, k),
                test=(test, k),
                seen=(test, k),
            )
        )
    return out


def _test_only(data: Stages) -> list[Shown]:
    if data.identify is None or data.test is None:
        return []
    out = []
    word = data.identify.source
    for name, found in (
        ("Ambient test", data.identify.ambient),
        (word[:1].upper() + word[1:], data.identify.hammer),
    ):
        if found is not None:
            m = found.modes
            out += [_alone(name, m, k, None, (m, k)) for k in range(len(m))]
            others = found.others
            for k, kind in enumerate(others.classes):
                stage = f"{name}, {kind}"
                out.append(_alone(stage, others.modes, k, None, (others.modes, k)))
    return out


def _alone(
    stage: str,
    m: ModeSet,
    k: int,
    fe: tuple[ModeSet, int] | None,
    test: tuple[ModeSet, int] | None,
) -> Shown:
    f = float(m.frequencies[k])
    zeta = float(m.damping[k])
    info = f"{fixed(f, 3)} Hz" + (
        f", damping {fixed(100 * zeta, 2)} %" if zeta > 0 else ""
    )
    return Shown(stage, f"mode {k + 1} · {fixed(f, 2)} Hz", info, fe, test)
