"""What is estimated and measured: motion, ranges, state space, noise, problem, solution."""
