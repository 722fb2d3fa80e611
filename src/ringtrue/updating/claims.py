"""What can be said of a chosen set: how far its members may be off, and whether its mirror image
does as well.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.updating.choose import Choice
from ringtrue.updating.identifiable import cosines
from ringtrue.updating.objective import Residual
from ringtrue.updating.search import Search
from ringtrue.updating.subsets import aicc

# difference of AICc below which a model is as good (Burnham and Anderson 2002, section 2.6)
RIVAL = 2.0


def stated_errors(search: Search, best: Choice, end: Residual) -> Float:
    """Standard deviation (k,) of x of each member: what all other candidates may be off by widens
    it.

    Those that scale a field of a member are held: it stands for them. Masses that the deck may lack
    elsewhere are, too: that something was left out is rare. Of A⁻¹ + ddᵀ, d the step to the common
    minimum: `posterior.around`.
    """
    members = best.members.tolist()
    beside = ~search.apart[members].any(axis=0) & ~np.isin(
        np.arange(best.x.size), [*search.lumps, *members]
    )
    every = [*members, *np.flatnonzero(beside).tolist()]
    g, x = end.slope[:, every] * search.prior[every], best.x[every] / search.prior[every]
    inverse = np.linalg.inv(g.T @ g + np.eye(len(every)))
    square = np.diag(inverse) + (inverse @ (g.T @ end.value - x)) ** 2
    return np.asarray((np.sqrt(square) * search.prior[every])[: len(members)])


def mirrored(search: Search, best: Choice, zero: Residual) -> dict[int, int]:
    """Of each member what is most alike to it at the deck, where all of these together do as well.

    Of a symmetric structure the frequencies do not tell an error from its mirror image. One of two
    members in the place of its image is not as good.
    """
    members = best.members.tolist()
    like = cosines(zero.slope * search.prior)[members]
    like[:, np.setdiff1d(np.arange(best.x.size), np.setdiff1d(search.pool, members))] = 0.0
    image = np.where(like.max(axis=1, initial=0.0) > search.alike, like.argmax(axis=1), members)
    if (
        (image == members).all()
        or np.unique(image).size < image.size
        or search.apart[np.ix_(image, image)].any()
    ):
        return {}
    x = np.zeros(best.x.size)
    x[image] = best.x[members]
    rise = aicc(search, [best, search.fit(image.tolist(), x)])
    return dict(zip(members, image.tolist(), strict=True)) if rise[1] - rise[0] < RIVAL else {}
