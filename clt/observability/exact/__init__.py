"""Ranks of the observability codistribution, exact modulo a prime."""
