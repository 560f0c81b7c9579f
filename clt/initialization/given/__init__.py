"""Starts that are known: from truth, a file of poses, an earlier result, surveyed robots."""
