"""Li: the relative pose of each pair from its ranges and odometry, by branch and bound."""
