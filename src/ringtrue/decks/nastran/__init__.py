"""Decks to tables and back, and edited in place.

Reading: `reader` is the call; `deck` its lines, `case` control, `cards` logical cards, `lexer` the
values of their fields, `tables` one a card, and what they leave open. Cards with a pattern of their
own: `special`, `beams`, `loads`.

Writing: `editor` in place, `writer` cards and whole models. `results` of Nastran-like programs.
"""
