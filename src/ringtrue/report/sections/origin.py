"""Provenance."""

from __future__ import annotations

from ringtrue.report.parts import Block, Cell, Code, Columns, Section, Table, fixed
from ringtrue.report.stages import Stages


def section(data: Stages) -> Section | None:
    """Inputs, versions, seed, settings, timings."""
    p = data.provenance
    if p is None:
        return None
    run = [("ringtrue", p.version), ("Python", p.python), ("Platform", p.platform)]
    run += [("Seed", str(p.seed)), ("Started", p.started), *p.packages.items()]
    spent = [(k, fixed(v, 1)) for k, v in p.timings.items()]
    timings = Table(("|Stage", "Time, s"), spent, "Timings.", ("total", fixed(sum(p.timings.values()), 1)))
    blocks: list[Block] = [Columns([[Table(("|What", "|Version or value"), run, "The run.")], [timings]])]
    inputs = [(name, Cell(sha, "mono")) for name, sha in p.inputs.items()]
    blocks.append(Table(("|Input", "|SHA-256"), inputs, "The input files."))
    blocks.append(Code("Resolved settings", p.settings))
    return Section("provenance", "Provenance", blocks)
