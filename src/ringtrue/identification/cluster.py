"""Grouping the poles of all orders: one cluster for each mode."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.shapes.mac import mac

CUT = 0.08  # a pole-and-shape distance within which poles of different orders are one mode


def distances(pole: Complex, psi: Complex) -> Float:
    """(k, k) |λ_i − λ_j| / max|λ| + 1 − MAC_ij (Magalhães et al. 2009)."""
    size = np.abs(pole)
    d = np.abs(pole[:, None] - pole) / np.maximum(size[:, None], size)
    return np.asarray(d + np.maximum(1 - mac(psi, psi), 0.0))


def cluster_poles(pole: Complex, psi: Complex, order: Int, cut: float = CUT) -> Int:
    """A label (k,) int64 for each pole, from 0, by average linkage; a label holds one pole of an
    order at most.

    The second pole of an order in a cluster is the one farther from the others: it gets -1.
    """
    if pole.size < 2:
        return np.zeros(pole.size, dtype=np.int64)
    d = distances(pole, psi)
    np.fill_diagonal(d, 0.0)
    d = 0.5 * (d + d.T)
    label = (
        np.asarray(
            fcluster(linkage(squareform(d, checks=False), "average"), cut, "distance"),
            dtype=np.int64,
        )
        - 1
    )
    together = label[:, None] == label
    away = (d * together).sum(1)
    rank = np.lexsort((away, order, label))
    key = np.stack([label[rank], order[rank]])
    again = np.concatenate([[False], (key[:, 1:] == key[:, :-1]).all(0)])
    label[rank[again]] = -1
    return label
