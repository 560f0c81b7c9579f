"""Particle filters: points, and Gaussians per particle."""
