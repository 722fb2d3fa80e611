"""Decks of finite element programs: a folder each."""
