"""Damage to a file: bytes, numbers, lines, cuts, pieces of other files; within the parts of a zip
archive, too.
"""

from __future__ import annotations

import io
import random
import re
import zipfile
import zlib
from collections.abc import Sequence

_INTEGERS = (
    b"\xff\xff\xff\xff",
    b"\0\0\0\x80",
    b"\xff\xff\xff\x7f",
    b"\0\0\0\0",
    b"\1\0\0\0",
    b"\0\0\0\1",
    b"\xfe\xff",
)
_DOUBLES = (
    b"\0\0\0\0\0\0\xf0\x7f",
    b"\xff" * 8,
    b"\xea\x75\x9c\xc7\xf0\x1c\xe1\x7f",
    b"\0\0\0\0\0\0\xf8\x7f",
)
_WORDS = (
    *(
        "1e308",
        "-1e308",
        "1e-300",
        "1e400",
        "nan",
        "inf",
        "-1",
        "0",
        "",
        "99999999999",
        "9" * 40,
        "2147483648",
        "1.+3",
    ),
    *(
        "THRU",
        "INCLUDE",
        "null",
        "true",
        "[[",
        "]]",
        "{",
        "}",
        '"',
        "'",
        ",",
        ";",
        "\t",
        "$",
        "#",
        "=",
        "*",
        "&",
        "<",
        "/",
    ),
    *(
        "é",
        "\x00",
        "\r",
        "\n",
        "%%",
        "    -1",
        "1+Z",
        "-5",
        "0x10",
        "1_000",
        "٣",
        "1e5",
        "-0",
        "3.7",
        "[",
        "]",
        "x",
    ),
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eEdD][-+]?\d+)?")
_MOST = 4  # changes of a file
_LARGEST = 1 << 16  # bytes: a mutation does not grow without end


def mutated(raw: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    """A file with one to `_MOST` changes."""
    if rng.random() < 0.7 and zipfile.is_zipfile(io.BytesIO(raw)):
        try:
            return _within_archive(raw, rng)
        except (
            ValueError,
            OSError,
            EOFError,
            RuntimeError,
            NotImplementedError,
            zipfile.BadZipFile,
            zlib.error,
        ):
            pass  # it is damaged already
    data = bytearray(raw)
    for _ in range(rng.randint(1, _MOST)):
        _change(data, rng, others)
    return bytes(data[:_LARGEST])


def _within_archive(raw: bytes, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    if not parts:
        return raw + b"\0"
    hit = rng.choice(sorted(parts))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            if name == hit and rng.random() < 0.05:
                continue
            archive.writestr(
                name, mutated(part, rng, list(parts.values())) if name == hit else part
            )
    return out.getvalue()


def _change(data: bytearray, rng: random.Random, others: Sequence[bytes]) -> None:
    if not data:
        data += rng.choice(_WORDS).encode()
        return
    at = rng.randrange(len(data))
    if rng.random() < 0.3:
        at = rng.randrange(min(len(data), 256))  # the head says what all the rest is
    text = b"\0" not in data[:512]
    choice = rng.choice(
        (
            "byte",
            "bit",
            "cut",
            "end",
            "double",
            "splice",
            "value",
            "value",
            "value",
            "line",
            "line",
        )
    )
    if choice == "byte":
        data[at] = rng.randrange(256)
    elif choice == "bit":
        data[at] ^= 1 << rng.randrange(8)
    elif choice == "cut":
        del data[at : at + rng.choice((1, 1, 2, 4, 8, 40))]
    elif choice == "end":
        if rng.random() < 0.3:
            del data[at:]
    elif choice == "double":
        piece = data[at : at + rng.choice((1, 4, 8, 80, 400))]
        data[at:at] = piece * rng.choice((1, 1, 1, 2, 20))
    elif choice == "splice":
        other = rng.choice(others)
        start = rng.randrange(len(other) + 1)
        data[at:at] = other[start : start + rng.choice((4, 20, 200))]
    elif choice == "value" and text:
        found = _NUMBER.search(data, at)
        word = rng.choice(_WORDS).encode("utf-8", "surrogateescape")
        start, end = found.span() if found else (at, at)
        data[start:end] = word
    elif choice == "value":
        value = rng.choice(_INTEGERS + _DOUBLES)
        at -= at % 4 if rng.random() < 0.7 else 0
        data[at : at + len(value)] = value
    elif text:
        _change_line(data, rng)


def _change_line(data: bytearray, rng: random.Random) -> None:
    lines = bytes(data).split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.randrange(4)
    if how == 0:
        del lines[i]
    elif how == 1:
        lines.insert(i, lines[j])
    elif how == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = (
            rng.choice(_WORDS)
            .encode()
            .join(lines[i].split(rng.choice((b",", b" ", b"="))))
        )
    data[:] = b"\n".join(lines)
