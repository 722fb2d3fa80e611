"""The studio: a study in the browser, on the machine of its user.

`launch` opens it, behind its guard; `shell` is the frame around the screens, `theme` its colours.
`documents` are the texts that are its only state, `edits` what a click does to one; `session` is
what is open, `work` what runs in a process of its own. `viewer_element` is the 3D
viewer on a page, `views` what it shows of decks and modes; `shown` is what screens show: the deck,
its records, what was identified.
"""
