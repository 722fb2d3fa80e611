"""Kernels, arrays (e, k, 3) to (e, d, d): nodes of all elements of a kind to their matrices.

Lines: `rod`, `bar`, `bend`. Springs and dashpots: `spring`, `bush`, `damper`, `gap`. Masses:
`mass`.

Shells: `shell` what they share; `shell3` and `shell4`, `shell8` with `shell_curved`, `shell_rule`
and `shell_normals`; `shell_section`, `shell_material` and `laminate` their sections; `shear`
panels.

Solids: `solid` what they share, with `solid_rule` and `solid_material`; `tetra`, `penta`,
`pyramid`, `hexa`.

Welds and fasteners: `weld`, `fast`, their ends `patch`. Given as matrices: `general`, `dmig`.
"""
