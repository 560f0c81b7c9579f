"""Li's consensus-based particle filter: every robot its own estimator, and what they send."""
