"""MCAP logs in and out, as columns; nothing about estimation."""
