"""Decks of other programs, known by the first line that is no comment."""

from __future__ import annotations

import re

_KEYWORD = re.compile(rb"\*([A-Z][A-Z0-9_ ]*)")
_ABAQUS = frozenset(
    b"AMPLITUDE ASSEMBLY BEAM BOUNDARY DENSITY ELASTIC ELEMENT ELSET END HEADING INCLUDE "
    b"INSTANCE MATERIAL NODE NSET "
    b"ORIENTATION PARAMETER PART PREPRINT RESTART SHELL SOLID STEP SURFACE SYSTEM".split()
)
_ANSYS = re.compile(
    rb"(/(BATCH|CLEAR|CLE|COM|CONFIG|FILNAME|FILNAM|GO|GOPR|INPUT|NERR|NOPR|OUTPUT|PREP7|SOLU|TITLE|UIS|UNITS)\b"
    rb"|FINI(SH)?\b|(ANTYPE|ET|EBLOCK|MP|MPTEMP|NBLOCK|SECTYPE)\s*,)"
)
BEGINNING = 65_536  # bytes that tell the program


def other_program(data: bytes) -> str:
    """The program that a deck, of which these are the first bytes, is of; "" where it may be
    Nastran's.

    A line that begins with an asterisk continues a card of Nastran, so that none can come first.

    >>> other_program(b"** a frame\\n*Heading\\n*Node\\n1, 0., 0., 0.\\n")
    'Abaqus or CalculiX'
    >>> other_program(b"*KEYWORD\\n*NODE\\n")
    'LS-Dyna'
    >>> other_program(b"! a frame\\n/PREP7\\nET,1,SHELL181\\n")
    'Ansys'
    >>> other_program(b"SOL 103\\nCEND\\nBEGIN BULK\\n")
    ''
    """
    lines = [line.strip() for line in data.upper().splitlines()]
    lines = [line for line in lines if line and not line.startswith((b"$", b"**", b"!"))]
    if not lines:
        return ""
    keywords = [found[1].strip() for line in lines if (found := _KEYWORD.match(line))]
    if lines[0].startswith(b"*") and keywords:
        if b"KEYWORD" in keywords or any(b"_" in k for k in keywords):
            return "LS-Dyna"
        return "Abaqus or CalculiX" if keywords[0].split()[0] in _ABAQUS else ""
    return "Ansys" if _ANSYS.match(lines[0]) else ""
