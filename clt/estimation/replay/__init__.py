"""Filters as a robot would run them: messages late, lost and out of order."""
