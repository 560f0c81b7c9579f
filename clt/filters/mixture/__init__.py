"""Gaussian sums: split where the model bends, reduced by moments."""
