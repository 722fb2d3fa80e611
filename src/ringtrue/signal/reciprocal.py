"""FRFs of a roving hammer: a few fixed sensors, many points struck.

A linear structure without gyroscopic forces answers alike when response and force change places
(Maxwell 1864, Betti 1872; Ewins 2000, section 2.4), so the points struck serve as responses and the
fixed sensors as references.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.motions import LINEAR, channel
from ringtrue.core.signals import Channel, FrfSet

MOTION = ("acceleration", "velocity", "displacement", "unknown")


def exchanged(frfs: FrfSet) -> tuple[FrfSet, str]:
    """FRFs with the responses at the many points of a roving hammer, and a note; as they are where
    they are not such.

    Parameters
    ----------
    frfs : FrfSet
        Exchanged if there are more inputs than outputs, and the outputs are motions of one kind.
    """
    kinds = {LINEAR.get(c.quantity, c.quantity) for c in frfs.outputs}
    if len(frfs.inputs) <= len(frfs.outputs) or len(kinds) != 1 or not kinds <= set(MOTION):
        return frfs, ""
    quantity, unit = kinds.pop(), frfs.outputs[0].unit
    there = replace(
        frfs,
        data=frfs.data.swapaxes(1, 2),
        outputs=tuple(
            Channel(c.id, quantity, unit) if quantity == "unknown" else channel(c.id, quantity)
            for c in frfs.inputs
        ),
        inputs=tuple(channel(c.id, "force") for c in frfs.outputs),
        coherence=frfs.coherence.swapaxes(1, 2),
        averages=np.full(len(frfs.outputs), np.min(frfs.averages)),
        blows=frfs.blows.exchanged() if frfs.blows else None,
    )
    return there, (
        f"roving hammer: {len(frfs.inputs)} points struck, {len(frfs.outputs)} fixed sensors; by "
        "reciprocity the "
        "shapes are at the points struck"
    )
