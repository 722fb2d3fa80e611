"""Modes from frequency response functions: `pipeline.identify_hammer`, with one step a module."""
