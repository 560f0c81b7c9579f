"""How noisy the sensors of a log are, from the log itself."""
