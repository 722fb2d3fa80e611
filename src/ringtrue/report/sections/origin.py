"""Provenance."""

from __future__ import annotations

import re

from ringtrue.report.parts import Block, Cell, Code, Columns, Section, Table, fixed
from ringtrue.report.stages import Stages

LONG = re.compile(r"\[\s*((?:[\d.+-]+,\s*){6})((?:[\d.+-]+,\s*){20,}[\d.+-]+,?)\s*\]")


def _shortened(text: str) -> str:
    """Settings with long lists of numbers cut; the store holds them in full."""
    return LONG.sub(lambda m: f"[{m[1]}… {m[2].rstrip(',').count(',') + 1} more]", text)


def section(data: Stages) -> Section | None:
    """Inputs, versions, seed, settings, timings."""
    p = data.provenance
    if p is None:
        return None
    run = [("ringtrue", p.version), ("Python", p.python), ("Platform", p.platform)]
    run += [("Seed", str(p.seed)), ("Started", p.started.replace("T", " ")), *p.packages.items()]
    spent = [(k, fixed(v, 1)) for k, v in p.timings.items()]
    timings = Table(
        ("|Stage", "Time, s"), spent, "Timings.", ("total", fixed(sum(p.timings.values()), 1))
    )
    blocks: list[Block] = [
        Columns([[Table(("|What", "|Version or value"), run, "The run.")], [timings]])
    ]
    inputs = [(name, Cell(sha, "mono")) for name, sha in p.inputs.items()]
    blocks.append(
        Table(("|Input", "|SHA-256"), inputs, "The input files.", scroll=len(inputs) > 16)
    )
    blocks.append(Code("Resolved settings", _shortened(p.settings)))
    return Section("provenance", "Provenance", blocks)
