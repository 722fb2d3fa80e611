"""Modes from frequency response functions: `pipeline.identify_hammer`, and CMIF peaks beside it."""
