"""What can be known of a team from ranges and odometry, before and along a run."""
