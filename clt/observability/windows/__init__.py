"""Observability along a log: Gramians of windows."""
