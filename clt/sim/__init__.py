"""Scenarios, trajectories, sensors: a scenario in, a recording out."""
