"""Reads sources in threads and writes one log until it is ended."""
