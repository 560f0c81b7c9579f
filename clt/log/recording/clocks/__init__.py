"""Clocks of a log: jumps, pauses, and the parts that hold together."""
