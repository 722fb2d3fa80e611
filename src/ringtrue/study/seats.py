"""Which nodes of a deck the sensors of a test are read at: the map from points to nodes, for
people.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ringtrue.core.channels import other_names
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.study.results import Seat

SHOWN = 12  # points that a line names


def seats(seen: Observation, sheet: TestModel) -> tuple[Seat, ...]:
    """Where each channel of a test is read.

    Parameters
    ----------
    seen : Observation
        Of the channels on a deck.
    sheet : TestModel
        Where they are found.
    """
    index, sign = sheet.find(seen.channels)
    names = (*sheet.channels, *sheet.forces)
    points = np.concatenate([sheet.at, sheet.force_at])[index].tolist()
    out = []
    for k, channel in enumerate(seen.channels):  # hundreds
        columns = seen.matrix.indices[seen.matrix.indptr[k] : seen.matrix.indptr[k + 1]]
        nodes = tuple(np.unique(seen.dofs.node[columns]).tolist())
        far = float(seen.distance[k] * seen.unit)
        out.append(Seat(channel, names[index[k]], int(sign[k]), points[k], nodes, far))
    return tuple(out)


def seats_json(found: Sequence[Seat]) -> list[dict[str, Any]]:
    """Plain values."""
    return [
        {
            "channel": s.channel,
            "sensor": s.sensor,
            "sign": s.sign,
            "point": s.point,
            "nodes": list(s.nodes),
            "distance_m": s.distance,
        }
        for s in found
    ]


def seat_words(found: Sequence[Seat]) -> tuple[str, ...]:
    """The map from points to nodes, and channels that the sheet has by another name, a line
    each.
    """
    if not found:
        return ()
    at = {s.point: s for s in found}
    other = [s for s in at.values() if s.nodes != (s.point,)]
    told = f"{len(at) - len(other)} of {len(at)} points are read at the node of their number"
    if other:
        told += "; point -> node: " + ", ".join(f"{s.point} -> {_nodes(s)}" for s in other[:SHOWN])
        told += (
            f" and {len(other) - SHOWN} more (--json, summary.json)" if len(other) > SHOWN else ""
        )
    told += f"; at most {max(s.distance for s in found):.2g} m away"
    return told, *other_names(
        [s.channel for s in found], [s.sensor for s in found], [s.sign for s in found]
    )


def _nodes(s: Seat) -> str:
    return "+".join(map(str, s.nodes))
