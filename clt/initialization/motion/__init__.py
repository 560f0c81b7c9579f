"""Shi: multidimensional scaling at standstill and headings from straight drives."""
