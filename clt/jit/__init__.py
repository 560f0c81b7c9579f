"""Numba decorators and the cache of their machine code."""
