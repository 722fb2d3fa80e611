"""Modes from ambient records: `pipeline.identify_ambient`, one method a module."""
