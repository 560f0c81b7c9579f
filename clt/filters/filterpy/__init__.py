"""The same filters by filterpy: an independent oracle."""
