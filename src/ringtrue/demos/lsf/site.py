"""What stands on the site and not in the analyst's deck: platform, piping, cabinets and two hung
parts.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ringtrue.demos.lsf import spec as S

if TYPE_CHECKING:
    from ringtrue.demos.lsf.facility import Builder

# property number -> what it is made of; see `deck.properties`
PARTITION, PLATFORM, PIPE, HOSE_LINK, CRANE_LINK, PIPE_CLAMP = 5, 71, 72, 73, 74, 75
HOSE_BRIDGE, CRANE = 9_000.0, 12_000.0  # kg, hung so softly that they move alone
CABINETS = ((4.0, 0.45, S.TOP, 1500.0), (21.0, 9.55, S.MID, 2500.0), (14.2, 9.55, S.TOP, 1200.0))


def site(b: Builder) -> None:
    """Adds the parts that the analyst left out."""
    _platform(b)
    _piping(b)
    _hung(b)
    for x, y, z, mass in CABINETS:
        b.mesh.element("CONM2", b.mesh.node(x, y, z), None, mass)


def _platform(b: Builder) -> None:
    """A service platform along one side of the frame, cantilevered from the lower girder."""
    m, n = b.mesh, b.spec.mesh
    m.part = "site"
    spans = [np.linspace(a, c, n.span + 1)[:-1] for a, c in pairwise(S.PORTALS)]
    x = np.concatenate([*spans, S.PORTALS[-1:]])
    y = S.SIDES[0] - np.array([0.0, 0.4, 0.8])
    g = m.lattice(np.stack(np.meshgrid(x, y, [S.MID], indexing="ij"), axis=-1)[:, :, 0])
    for i in range(x.size - 1):
        for j in range(y.size - 1):
            m.element(
                "CQUAD4", PLATFORM, *map(int, (g[i, j], g[i + 1, j], g[i + 1, j + 1], g[i, j + 1]))
            )


def _piping(b: Builder) -> None:
    m = b.mesh
    m.part = "site"
    x = np.concatenate(
        [np.linspace(a, c, 5)[:-1] for a, c in zip(S.PORTALS[:-1], S.PORTALS[1:], strict=True)]
    )
    x = np.append(x, S.PORTALS[-1])
    y, z = S.SIDES[1] - 0.6, S.MID + 0.5
    nodes = m.lattice(np.stack([x, np.full_like(x, y), np.full_like(x, z)], axis=1))
    for a, c in pairwise(nodes.tolist()):
        m.element("CBEAM", PIPE, a, c, 0.0, 0.0, 1.0)
    for i in range(0, len(nodes), 4):
        girder = m.nearest("frame", (float(x[i]), S.SIDES[1], S.MID))[0]
        m.element("CBUSH", PIPE_CLAMP, int(nodes[i]), girder, None, None, None, 0, 0.0)


def _hung(b: Builder) -> None:
    m = b.mesh
    m.part = "site"
    for point, place, mass, pid in (
        (
            m.nearest("foundation", (25.0, 5.0, S.WALL_TOP))[0],
            (25.0, 5.0, S.WALL_TOP),
            HOSE_BRIDGE,
            HOSE_LINK,
        ),
        (
            m.nearest("foundation", (0.0, 5.0, S.WALL_TOP))[0],
            (0.0, 5.0, S.WALL_TOP),
            CRANE,
            CRANE_LINK,
        ),
    ):
        hung = m.node(*place, new=True)
        m.element("CONM2", hung, None, mass)
        m.element("CBUSH", pid, hung, point, None, None, None, 0)
