"""Families of filters: a `Problem` in, a `Solution` out."""
