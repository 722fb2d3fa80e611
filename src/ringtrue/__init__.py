"""Finite element model validation: from a deck and vibration signals to a model that rings true."""

__version__ = "0.1.0"
