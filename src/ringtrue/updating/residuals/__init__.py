"""Kinds of residuals, one module a family: what a model is compared with a test in."""
