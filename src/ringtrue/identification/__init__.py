"""Signals and FRFs to modes with their standard deviations.

`ambient` identifies responses of a structure in operation, `frf` frequency response functions of
hammer and shaker tests. `common` holds what both need: poles, stabilisation, uncertainty, selection
by hand, merging of records and tracking through time.
"""
