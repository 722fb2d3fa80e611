"""Sensitivities and the choice of the parameters."""

from __future__ import annotations

from ringtrue.plots import updating as plots
from ringtrue.report.parts import Block, Items, Plot, Section, Table, Tabs, sentence
from ringtrue.report.stages import Stages
from ringtrue.study.words import stand_ins


def section(data: Stages) -> Section | None:
    """Heat maps of both sensitivities, sets with their rules, clusters."""
    s = data.sensitivity
    if s is None:
        return None
    if data.correlate is not None:
        f = data.correlate.fe_remodelled.frequencies[s.fe_modes]
    elif data.model is not None:
        f = data.model.modes.frequencies[s.fe_modes]
    else:
        return None
    one = plots.sensitivity(s, s.d_frequency, "∂ ln f / ∂x", f)
    caption = (
        "Sensitivity of the {} to the candidates; x = ln(factor) of logarithmic "
        "parameters, else factor − 1."
    )
    frequencies = Plot(one, caption.format("natural frequencies"))
    blocks: list[Block] = [frequencies]
    if s.d_mac.size:
        two = Plot(
            plots.sensitivity(s, s.d_mac, "∂ MAC / ∂x", f),
            caption.format("MAC with the paired test shape"),
        )
        blocks = [Tabs([("Frequencies", [frequencies]), ("Mode shapes", [two])])]
    rows = [(k, str(len(v)), ", ".join(v), sentence(s.rules.get(k, ""))) for k, v in s.sets.items()]
    blocks.append(
        Table(
            ("|Set", "Size", "|Parameters", "|Rule"),
            rows,
            "Parameter sets and how each was chosen.",
        )
    )
    held = dict.fromkeys(line for found in s.held.values() for line in stand_ins(found))
    if held:
        blocks.append(Items(tuple(held), "Held at the deck's values"))
    if s.clusters:
        blocks.append(Items(s.clusters, "Candidates that the data cannot tell apart"))
    return Section("sensitivities", "Sensitivities and parameters", blocks)
