"""Poles of all model orders, stabilisation, uncertainty, selection by hand, merging, tracking."""
