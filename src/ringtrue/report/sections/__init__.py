"""The sections of the report: stored results in, blocks out."""
