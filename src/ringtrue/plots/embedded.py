"""JSON inside a script element of a page, whatever the user's texts hold."""

from __future__ import annotations

# "<" could end the element or begin a comment; the two separators end a line in older scripts. JSON
# has all of them in its strings alone, where their escapes are the same text.
_ESCAPES = str.maketrans({"<": "\\u003c", "\u2028": "\\u2028", "\u2029": "\\u2029"})


def script_json(text: str) -> str:
    r"""The same JSON without what HTML reads.

    >>> script_json('["<!--", "</script>"]')
    '["\\u003c!--", "\\u003c/script>"]'
    """
    return text.translate(_ESCAPES)
