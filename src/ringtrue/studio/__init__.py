"""The studio: a study in the browser, on the machine of its user.

`launch` opens it, behind `guard`; `shell` is the frame around the screens, `theme` its colours.
`documents` are the texts that are its only state, `edits` and `sheet_edits` what a click does to
one; `session` is what is open, `work` what runs in a process of its own (`worker`).
`viewer_element` is the 3D viewer on a page, `shapes` what it shows of modes, `decks` the deck that
it draws and `space` the view of it; `identified` is what screens ask of an identification.
"""
