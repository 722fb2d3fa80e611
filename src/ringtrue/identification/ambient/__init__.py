"""Modes from ambient records: `pipeline.identify_ambient`, and other methods beside it."""
