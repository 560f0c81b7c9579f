"""Figures of a recording and its evaluation; files only, never a window."""
