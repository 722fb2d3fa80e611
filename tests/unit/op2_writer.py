"""OP2 files of given tables, in any byte order and word size: for tests of readers and stand-in
programs.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


@dataclass
class Op2Writer:
    """Build a file piece by piece; a word is an int, a float or four characters."""

    order: str = "<"
    word: int = 4
    enhanced: bool = (
        # six words after label and names, as PARAM,POST,1 of MSC Nastran writes them
        False
    )
    out: bytearray = field(default_factory=bytearray)

    def record(self, data: bytes) -> None:
        n = struct.pack(f"{self.order}i", len(data))
        self.out += n + data + n

    def key(self, value: int) -> None:
        self.record(self.pack([value]))

    def pack(self, words: Sequence[Any]) -> bytes:
        i, f = ("i", "f") if self.word == 4 else ("q", "d")
        kinds = "".join(
            f"{self.word}s"
            if isinstance(w, bytes)
            else f
            if isinstance(w, float)
            else i
            for w in words
        )
        padded = [w.ljust(self.word) if isinstance(w, bytes) else w for w in words]
        return struct.pack(self.order + kinds, *padded)

    def block(self, words: Sequence[Any]) -> None:
        self.key(len(words))
        self.record(self.pack(words))

    def head(self) -> None:
        self.block([1, 2, 3])
        self.block([b"NAST", b"RAN ", b"FORT", b" TAP", b"E ID", b" COD", b"E - "])
        self.block([b"XXXX", b"XXXX"])
        self.qualifiers()
        self.key(-1)
        self.key(0)

    def double(self, *values: float) -> list[bytes]:
        """Numbers of double precision, of two words each where these have four bytes."""
        data = struct.pack(f"{self.order}{len(values)}d", *values)
        return [data[i : i + self.word] for i in range(0, len(data), self.word)]

    def begin(self, name: str, trailer: Sequence[int]) -> None:
        text = name.ljust(8).encode()
        self.block([text[:4], text[4:]])
        self.qualifiers()
        self.key(-1)
        self.block(list(trailer))

    def qualifiers(self) -> None:
        if self.enhanced:
            self.block([1, 0, 20190000, 0, 0, 0])

    def row(self, number: int, *blocks: Sequence[Any], flag: int = 0) -> None:
        for k in (-number, 1, flag):
            self.key(k)
        for words in blocks:
            self.block(words)

    def end(self, number: int) -> None:
        for k in (-number, 1, 0, 0):
            self.key(k)

    def table(self, name: str, records: Sequence[Sequence[Any]]) -> None:
        self.begin(name, (101, 0, 0, 0, 0, 0, 0))
        text = name.ljust(8).encode()
        self.row(2, [text[:4], text[4:]])
        for k, words in enumerate(records):
            # a logical record may stand in several blocks
            half = max(len(words) // 2, 1)
            self.row(
                k + 3, *(part for part in (words[:half], words[half:]) if len(part))
            )
        self.end(len(records) + 3)

    def matrix(self, name: str, values: np.ndarray) -> None:
        """Double precision, by columns."""
        self.begin(name, (101, values.shape[1], values.shape[0], 2, 2, 0, 0))
        text = name.ljust(8).encode()
        self.row(2, [text[:4], text[4:]])
        for j, column in enumerate(values.T):
            for k in (-(j + 3), 1, 1):
                self.key(k)
            data = self.pack([1]) + column.astype(f"{self.order}f8").tobytes()
            self.key(len(data) // self.word)
            self.record(data)
        self.end(values.shape[1] + 3)

    def modes(
        self,
        eigenvalues: np.ndarray,
        nodes: np.ndarray,
        motion: np.ndarray,
        mass: np.ndarray,
        name: str = "OUGV1",
    ) -> None:
        """LAMA and eigenvectors (n, 6, m)."""
        rows: list[Any] = []
        for k, (lam, m) in enumerate(zip(eigenvalues, mass, strict=True)):
            w = float(np.sqrt(abs(lam)))
            rows += [
                k + 1,
                k + 1,
                float(lam),
                w,
                w / (2 * np.pi),
                float(m),
                float(lam * m),
            ]
        self.table("LAMA", [[21, 6, *[0] * 144], rows])
        records: list[list[Any]] = []
        for k, lam in enumerate(eigenvalues):
            ident: list[Any] = [21, 7, 0, 1, k + 1, float(lam), 0.0, 0, 1, 8]
            records.append(ident + [0] * (146 - len(ident)))
            body: list[Any] = []
            for node, values in zip(
                nodes.tolist(), motion[:, :, k].tolist(), strict=True
            ):
                body += [10 * node + 1, 1, *values]
            records.append(body)
        self.table(name, records)

    def motions(
        self,
        name: str,
        identity: Sequence[int],
        keys: Sequence[float],
        nodes: np.ndarray,
        motion: np.ndarray,
        *,
        polar: bool = False,
        sort2: bool = False,
    ) -> None:
        """Motions (n, 6, k) of nodes by keys (k,), real or complex; `identity` is approach and
        table code.
        """
        approach, code = identity
        values = motion.astype(np.complex128)
        parts = [values.real, values.imag]
        if polar:
            parts = [np.abs(values), np.rad2deg(np.angle(values)) % 360]
        width = 8
        if np.iscomplexobj(motion):
            width = 14
            code += 1000
        numbers = np.concatenate(parts[: (width - 2) // 6], axis=1)
        form = 1 if width == 8 else 2 + polar
        own = [10 * node + 1 for node in nodes.tolist()]
        outer, inner = (own, list(keys)) if sort2 else (list(keys), own)
        if sort2:
            code += 2000
            numbers = numbers.transpose(2, 1, 0)
        records: list[list[Any]] = []
        for k, first in enumerate(outer):
            ident: list[Any] = [
                10 * approach + 1,
                code,
                0,
                1,
                first,
                0.0,
                0.0,
                0,
                form,
                width,
            ]
            # title, subtitle and label
            records.append([*ident, *[0] * 40, *[b"    "] * 96])
            rows = zip(inner, numbers[:, :, k].tolist(), strict=True)
            records.append([word for second, six in rows for word in (second, 1, *six)])
        self.table(name, records)

    def write(self, path: Path) -> None:
        self.key(0)
        path.write_bytes(bytes(self.out))
