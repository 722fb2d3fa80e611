"""What AUTOSPC holds in a model."""

from __future__ import annotations

from collections.abc import Iterator

from ringtrue.checks.findings import Finding
from ringtrue.core.dofs import DofSet
from ringtrue.fem.assembly import System

_NAMED = 5


def autospc_findings(system: System) -> Iterator[Finding]:
    """Components that are held as nothing stiffens them: a warning for translations of nodes that
    move otherwise.
    """
    loose = system.loose()
    if len(loose):
        text = f"AUTOSPC holds translations of nodes that move otherwise: {_in_words(loose)}"
        yield Finding("warning", f"{text}; nothing stiffens them")
    every = system.autospc
    others = loose.find(every.node, every.direction) < 0
    if others.any():
        rest = DofSet(every.node[others], every.direction[others])
        yield Finding("info", f"AUTOSPC holds {_in_words(rest)}; nothing stiffens them")


def _in_words(dofs: DofSet) -> str:
    """`component 6 of node 3, components 123 of 7 nodes (1, 2, 4, 5, 8, ...)`."""
    return ", ".join(
        _group(components, nodes) for components, nodes in dofs.by_components().items()
    )


def _group(components: str, nodes: list[int]) -> str:
    more = ", ..." if len(nodes) > _NAMED else ""
    names = ", ".join(map(str, nodes[:_NAMED])) + more
    where = f"node {names}" if len(nodes) == 1 else f"{len(nodes)} nodes ({names})"
    if components == "0":
        return where.replace("node", "scalar point", 1)
    return f"component{'s' if len(components) > 1 else ''} {components} of {where}"
