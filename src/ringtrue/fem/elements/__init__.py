"""Kernels, arrays (e, k, 3) to (e, d, d): nodes of all elements of a kind to their matrices.

Lines: `rod`, `bar`, `bend`. Springs, dashpots and masses, and what is given as matrices: `lumped`.

Shells: `shell3` and `shell4`, of second order `curved_shell`; `shell_section` what they share and
`shell_material` its layers; `shear` panels.

Solids: `solid` with `elasticity` and `shape_functions`.

Welds and fasteners: `fasteners`.
"""
