"""ringtrue next to a rank of the `slepc` solver: assembles a share of the elements, and does what
`slepc` asks for through files of a folder; the distributed matrices are the rank's.

Each rank (`slepc_worker`) starts a process of it and answers it by pipe. What is asked follows from
the files alone, so that all ranks are asked the same. No process holds K, M or the modes of the
whole model: each writes its part of the files.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.derivatives import modal_coefficients
from ringtrue.eigen.eigenpairs import eigenvalue
from ringtrue.eigen.shift import start_shift, suitable_shift
from ringtrue.errors import RingtrueError
from ringtrue.fem.assembly import (
    Share,
    assemble,
    refuse_held,
    without_massless_rotations,
)
from ringtrue.fem.mesh import applied
from ringtrue.fem.parametrisation.derivatives import by_owner
from ringtrue.fem.parametrisation.element_derivatives import element_derivatives
from ringtrue.io.files import atomic_write
from ringtrue.io.foreign.parsers import read_npy
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.basis import CHUNK
from ringtrue.solvers.wire import make_file, receive, send, write_columns

POLL = 0.02  # s
BUFFER = 4  # modes above the requested ones that derivatives converge on
QUESTION = "asked.pickle"
ANSWER = "answer.json"
SHAPES = "shapes.npy"
LOWEST = "modes.npy"
TOLERANCE = 1e-9  # of the residual of a derivative, relative to its load


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """What `slepc` asks for.

    Attributes
    ----------
    request : ModesRequest
    parameters : ParameterSet, optional
        Derivatives of the lowest modes up to `top` in place of modes.
    top : float, (rad/s)²
    readings : (channel, full) csr float64, optional
        Derivatives of shapes at these channels in place of all DOFs.
    """

    request: ModesRequest
    parameters: ParameterSet | None = None
    top: float = 0.0
    readings: sparse.csr_array | None = None

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """See `ShareQuestion`."""
        if self.parameters is None:
            return own.modes(self.request, at(SHAPES))
        return own.derivatives(self, at(SHAPES), at(LOWEST))


class ShareQuestion(Protocol):
    """What all shares are asked."""

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """Write the arrays of the answer, each share its part, to files by their name; the rest of
        it.
        """


def place(folder: Path, number: int, what: str) -> Path:
    """Where a part of the answer to a question stands."""
    return folder / f"{number}-{what}"


def put(path: Path, content: bytes) -> None:
    """Write a file of which others wait to see the whole."""
    with atomic_write(path) as part:
        part.write_bytes(content)


def put_object(path: Path, value: object) -> None:
    """The same of an object for the other process."""
    put(path, pickle.dumps(value))


def failure(e: RingtrueError) -> bytes:
    """An error for the other process."""
    return pickle.dumps((type(e), str(e), e.__dict__))


def failed(content: bytes) -> RingtrueError:
    """The error of `failure`."""
    kind, text, values = pickle.loads(content)
    e: RingtrueError = kind.__new__(kind, text)
    e.__dict__.update(values)
    return e


class Rank:
    """The rank behind the pipe."""

    def __init__(self, source: BinaryIO, sink: BinaryIO) -> None:
        self._source = source
        self._sink = sink

    def __call__(
        self, do: str, *arrays: Any_, **values: Any
    ) -> tuple[dict[str, Any], list[Any_]]:
        """What the rank answers.

        Raises
        ------
        EOFError
            If it is gone.
        """
        send(self._sink, {"do": do, **values}, arrays)
        answer = receive(self._source)
        if answer is None:
            raise EOFError("the rank is gone")
        return answer

    def summed(self, a: Float) -> Float:
        """See `Share`."""
        total: Float = self("sum", np.asarray(a, dtype=np.float64))[1][0]
        return total

    def gathered(self, a: Any_) -> Any_:
        """See `Share`."""
        return self("gather", a)[1][0]


class ShareOfModel:
    """A share of a model, assembled, and what is known of its modes.

    Attributes
    ----------
    cols : (c,) int64
        The free DOFs at which the share has stiffness or mass.
    touched : (t,) int64
        The full DOFs that these move.
    moved : (t, c) csr float64
        Their motions by those of the free DOFs.
    where : (full + 1,) int64
        The position of each full DOF, and of none, among the touched ones; -1 for the others.
    """

    def __init__(self, model: Model, share: Share, rank: Rank, folder: Path) -> None:
        self.model = model
        self.share = share
        self.rank = rank
        self.folder = folder
        system, _ = without_massless_rotations(model, assemble(model, share), share)
        refuse_held(system)
        self.transform = system.transform
        self.where = np.full(self.transform.shape[0] + 1, -1)
        self.autospc = system.autospc
        self.size = len(system.free)
        k, m = (share.summed(A.diagonal()) for A in (system.stiffness, system.mass))
        self.shift = self.first_shift = start_shift(k, m)
        both = (system.stiffness.indices, system.mass.indices)
        self.cols: Int = np.unique(np.concatenate(both)).astype(np.int64)
        moved = sparse.csr_array(system.transform[:, self.cols])
        self.touched: Int = np.flatnonzero(np.diff(moved.indptr))
        self.moved = sparse.csr_array(moved[self.touched])
        self.where[self.touched] = np.arange(self.touched.size)
        self.values: Float = np.empty(0)
        self._from_lowest = False
        rank(
            "matrices",
            *_entries(system.stiffness),
            *_entries(system.mass),
            size=self.size,
        )

    def modes(self, request: ModesRequest, path: Path) -> dict[str, Any]:
        """Write shapes of modes (m, full), frequencies and residuals."""
        answer, residuals = self._solved(request)
        # a shift much nearer to zero than the first elastic mode loses digits
        if (residuals > 1e-7).any():
            self.shift = -suitable_shift(self.values)
            answer, residuals = self._solved(request)
        n = residuals.size
        self._write(path, np.eye(n, self.values.size), None)
        answer["values"] = self.values[:n].tolist()
        answer["residuals"] = residuals.tolist()
        answer["autospc"] = [
            self.autospc.node.tolist(),
            self.autospc.direction.tolist(),
        ]
        return answer

    def _solved(self, request: ModesRequest) -> tuple[dict[str, Any], Float]:
        band = None
        if request.band is not None:
            low, high = (eigenvalue(f) for f in request.band)
            band = (self.shift if low <= 0 else low, high)
        answer, (values, residuals) = self.rank(
            "modes",
            count=min(request.count, self.size),
            band=band,
            shift=self.shift,
            path=str(self._vectors),
        )
        self.values = values
        self._from_lowest = band is None or band[0] == self.shift
        return answer, residuals

    @property
    def _vectors(self) -> Path:
        return self.folder / "vectors.npy"

    def derivatives(self, asked: Asked, path: Path, lowest: Path) -> dict[str, Any]:
        """Write the lowest modes (m, full) and their ∂φ/∂a, (p m, full) or (p m, channel); φᵀK'φ
        and φᵀM'φ, (p, m, m).
        """
        assert asked.parameters is not None
        self._known_to(asked.top)
        m = int((self.values <= asked.top).sum())
        self._write(lowest, np.eye(m, self.values.size), None)
        p = len(asked.parameters)
        readings = asked.readings
        direct = readings is None or p <= readings.shape[0]
        seen = None if readings is None else sparse.csr_array(readings @ self.transform)
        phi = self.modes_found
        left = None
        if not direct and seen is not None:
            left = self._adjoint(seen, m)
        K, M, more = self._products(asked.parameters, m, left)
        K, M = (self.share.summed(a) for a in (K, M))
        along = modal_coefficients(K, M, self.values)
        answer = {"stiffness": K[:, :m].tolist(), "mass": M[:, :m].tolist()}
        z = None
        if direct:
            z = self._columns(more.reshape(-1, p * m), np.tile(self.values[:m], p))
        if seen is None:
            self._write(path, along.transpose(0, 2, 1).reshape(p * m, -1), z)
            return answer
        rows = np.unique(seen.indices)
        seen = sparse.csr_array(seen[:, rows])
        shapes = np.einsum("cn,pnm->pmc", seen @ phi[:, rows].T, along)
        if z is not None:
            shapes += (seen @ z[:, rows].T).T.reshape(shapes.shape)
        else:
            shapes -= self.share.summed(more)
        if self.share.number == 0:
            np.save(path, shapes.reshape(p * m, -1))
        return answer

    def _known_to(self, top: float) -> None:
        """Find all modes from the lowest to well above `top`, if they are not there."""
        while True:
            above = int((self.values > top * (1 + 1e-6)).sum())
            if self._from_lowest and (above >= BUFFER or self.values.size >= self.size):
                return
            more = (
                max(self.values.size, 1)
                if not self._from_lowest
                else self.values.size + BUFFER
            )
            self._solved(ModesRequest(more))

    def find_lowest(self, count: int, shift: float) -> None:
        """Find so many of the lowest modes from a shift, if they are not there."""
        enough = self.values.size >= min(count, self.size)
        if not (self._from_lowest and enough and self.shift == shift):
            self.shift = shift
            self._solved(ModesRequest(count))

    @property
    def modes_found(self) -> Any_:
        """The modes (m, free) that were found last, in a file."""
        return read_npy(self._vectors)

    def full(self, path: Path, along: Float | None = None) -> Float:
        """Motions (touched + 1, k) of the columns of a file (k, free), or of combinations of these;
        the last row is that of no DOF.
        """
        own = read_npy(path)[:, self.cols].T
        x = self.moved @ (own if along is None else own @ along)
        return np.vstack([x, np.zeros((1, x.shape[1]))])

    def inner(self, a: Float, b: Float, stiffness: float, mass: float) -> Float:
        """aᵀ(k K + m M)b of columns of which this share has its rows, and two factors k and m."""
        out = np.empty((a.shape[1], b.shape[1]))
        for first in range(0, b.shape[1], CHUNK):
            some = slice(first, first + CHUNK)
            made = self.rank("times", b[:, some], stiffness=stiffness, mass=mass)[1][0]
            out[:, some] = a.T @ made
        return self.share.summed(out)

    def write_rows(self, path: Path, rows: Float) -> None:
        """Write its rows (own, k) of columns to a file (k, free) of all shares."""
        self._make(path, (rows.shape[1], self.size))
        write_columns(str(path), self.share.span(self.size)[0], rows.T)
        self.share.summed(np.zeros(1))  # all have written

    def _make(self, path: Path, shape: tuple[int, ...]) -> None:
        """A file that all shares write to."""
        if self.share.number == 0:
            make_file(str(path), shape)
        self.share.summed(np.zeros(1))

    def _adjoint(self, seen: sparse.csr_array, m: int) -> Path:
        """(K − λM) w = c in the complement of the modes, for each mode and channel: (m·channel,
        free), in a file.
        """
        channels = seen.shape[0]
        first = self.share.number == 0
        rows = np.unique(seen.indices).astype(np.int64)[: None if first else 0]
        loads = np.tile(seen[:, rows].toarray().T, m)
        path = self.folder / "adjoint.npy"
        self._asked(path, np.repeat(self.values[:m], channels), rows, loads)
        return path

    def _columns(self, forces: Float, lam: Float) -> Any_:
        """(K − λM) z = r in the complement of the modes, for forces (touched, k): (k, free)."""
        path = self.folder / "columns.npy"
        self._asked(path, lam, self.cols, self.moved.T.tocsr() @ forces)
        return read_npy(path)

    def _asked(self, path: Path, lam: Float, rows: Int, loads: Float) -> None:
        self.rank("columns", lam, rows, loads, tolerance=TOLERANCE, path=str(path))

    def _products(
        self, parameters: ParameterSet, m: int, left: Path | None
    ) -> tuple[Float, Float, Float]:
        """Φᵀ K' φ and Φᵀ M' φ (p, n, m) of the share, and the forces λM'φ − K'φ (touched, p, m), or
        their negative work on the adjoint motions (p, m, channel).
        """
        lam = self.values[:m]
        x = self.full(self._vectors)
        p = len(parameters)
        w = None
        if left is not None:
            w = self.full(left).reshape(len(x), m, -1)
        K, M = (np.zeros((p, self.values.size, m)) for _ in range(2))
        more = np.zeros((len(x), p, m) if w is None else (p, m, w.shape[2]))
        for piece in element_derivatives(self.model, parameters.parameters, self.share):
            for i, at in by_owner(piece):
                rows = self.where[piece.dofs[at]]
                there = x[rows]
                changed = [
                    applied(a[at], there[:, :, :m])
                    for a in (piece.stiffness, piece.mass)
                ]
                for total, c in zip((K, M), changed, strict=True):
                    total[i] += np.einsum("edn,edm->nm", there, c, optimize=True)
                force = changed[1] * lam - changed[0]
                if w is None:
                    np.add.at(more[:, i], rows, force)
                else:
                    more[i] -= np.einsum("edmc,edm->mc", w[rows], force, optimize=True)
        return K, M, more[:-1] if w is None else more

    def _write(self, path: Path, along: Float, rest: Any_ | None) -> None:
        """The part of this share of motions (k, full): modes times `along` (k, n), and further
        motions (k, free).
        """
        total = self.transform.shape[0]
        self._make(path, (len(along), total))
        first, last = self.share.span(total)
        rows = sparse.csr_array(self.transform[first:last])
        cols = np.unique(rows.indices)
        motions = along @ self.modes_found[:, cols]
        if rest is not None:
            motions += rest[:, cols]
        write_columns(str(path), first, (rows[:, cols] @ motions.T).T)


def _entries(A: sparse.csr_array) -> tuple[Float, Int, Int]:
    coo = A.tocoo()
    return coo.data, coo.row.astype(np.int64), coo.col.astype(np.int64)


def questions(folder: Path) -> Iterator[tuple[int, ShareQuestion]]:
    """What is asked, one after the other, until there is no more or the rank is gone."""
    rank = os.getppid()
    for number in count(1):
        path = place(folder, number, QUESTION)
        while not path.exists():
            if os.getppid() != rank:
                return
            time.sleep(POLL)
        asked = pickle.loads(path.read_bytes())
        if asked is None:
            return
        yield number, asked


def main() -> None:
    """Assemble, and answer until nothing more is asked for; the arguments are folder, rank and
    number of ranks.
    """
    folder = Path(sys.argv[1])
    number, size = (int(a) for a in sys.argv[2:])
    sink = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what anything prints goes to the log
    rank = Rank(sys.stdin.buffer, sink)
    share = Share(number, size, rank.summed, rank.gathered)
    try:
        model = pickle.loads((folder / "model.pickle").read_bytes())
        own = ShareOfModel(model, share, rank, folder)
        for k, asked in questions(folder):
            at = partial(place, folder, k)
            answer = asked.answer(own, at)
            share.summed(np.zeros(1))  # all have written
            if number == 0:
                put(at(ANSWER), json.dumps(answer).encode())
    except RingtrueError as e:
        put(folder / f"error-{number}.pickle", failure(e))
        raise
