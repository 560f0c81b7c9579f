"""Samples into the bytes of devices: an encoder beside every decoder."""
