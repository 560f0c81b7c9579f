"""Kalman filters of one Gaussian, EKF and UKF, and the search for lost robots."""
