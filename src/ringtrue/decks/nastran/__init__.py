"""Decks to tables and back, and edited in place.

Reading: `reader` is the call; `deck` its lines, `case` control, `gather` logical cards from `free`
and fixed fields, `replicate`, `lexer` and `fields` their values, `tables` one a card; `foreign`
decks of other programs and `magnitudes` beyond doubles are refused.

Cards with a pattern of their own: `special`, `lists`, `beams`, `welds`, `added_mass`, `loads`,
`damping`; `defaults` what they leave blank, `constraint_sets` which hold, `orientations` what they
leave open.

Writing: `edit` in place, `places` where a field stands; `writer` cards, `bulk` and `bulk_special`
whole models. `results` of Nastran-like programs.
"""
