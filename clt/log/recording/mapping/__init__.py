"""Streams files: which topics of somebody else's log hold what."""
