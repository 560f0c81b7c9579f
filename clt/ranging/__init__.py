"""From the time stamps of a UWB broadcast network to clocks, ranges and odometry. Pure arrays."""
