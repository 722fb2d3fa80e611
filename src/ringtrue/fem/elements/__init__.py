"""Kernels, arrays (e, k, 3) to (e, d, d): nodes of all elements of a kind to their matrices.

Lines: `rod`, `bar`, `bend`. Springs, dashpots and masses: `lumped`.

Shells: `shell3` and `shell4`, `shell8` with `curved_shell`; `shell_section` what they share and
`shell_material` its layers; `shear` panels.

Solids: `solid` what they share, `solid_shapes` tetrahedron, wedge, pyramid and hexahedron;
`elasticity` and `shape_functions`.

Welds and fasteners: `fasteners`, their ends `fastener_attachment`. As matrices: `given_matrices`.
"""
